from dataclasses import replace

import pytest

from oracle_pipeline.bags.manifest import TopicCount
from oracle_pipeline.bags.types import serialize
from oracle_pipeline.bags.writer import BagWriter
from tests.oracle_pipeline.reporting.recordings import manifest

ATTACKED = manifest()


@pytest.fixture
def recorded(tmp_path):
    """Return a function that records messages, a tenth of a second apart, as a run directory."""

    def record(*messages, manifest_=ATTACKED):
        path = tmp_path / "run003"
        with BagWriter(path / "bag") as bag:
            for topic, msgtype in {topic: msgtype for topic, msgtype, _ in messages}.items():
                bag.add_topic(topic, msgtype, [])
            for number, (topic, msgtype, message) in enumerate(messages):
                bag.write(topic, number * 100_000_000, serialize(message, msgtype))
        types = {topic: msgtype for topic, msgtype, _ in messages}
        counts = {name: TopicCount(types[name], count) for name, count in bag.counts.items()}
        (path / "graphs").mkdir()
        replace(manifest_, topics=counts).save(path / "manifest.json")
        return path

    return record
