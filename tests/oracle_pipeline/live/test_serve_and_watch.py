"""`oracle-sim serve` and `oracle watch`, as separate processes on one domain."""

import signal
import subprocess
import sys
from collections import Counter, defaultdict, deque
from pathlib import Path

import numpy as np
import pytest

from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.datasets import feature_columns, field_metadata
from oracle_pipeline.features import build_manager, extract
from oracle_pipeline.opened_run import open_run
from tests.servers import end_with_parent

pytestmark = pytest.mark.slow(8)

BIN = Path(sys.executable).parent
SPEED = "2"
TOLERANCE = 0.05  # of a value, or the feature's own resolution


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """The same patrol, as the testbed recorded it and as it was watched."""
    from tests.dds_domains import a_free_domain

    root = tmp_path_factory.mktemp("both")
    with a_free_domain() as domain:
        watch = subprocess.Popen(
            [BIN / "oracle", "watch", "--domain", str(domain), "--out", root / "live"],
            stderr=subprocess.PIPE, text=True, preexec_fn=end_with_parent(),
        )  # fmt: skip
        assert "Watching" in watch.stderr.readline()
        subprocess.run(
            [BIN / "oracle-sim", "serve", "--domain", str(domain), "--speed", SPEED,
             "--goals", "1", "--out", root / "own"],
            check=True, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, timeout=120,
        )  # fmt: skip
        watch.send_signal(signal.SIGINT)
        _, said = watch.communicate(timeout=300)
    assert watch.returncode == 0, said
    assert " 0 dropped" in said
    (own,) = (root / "own").glob("runs/*/run000")
    *_, live = sorted((root / "live").iterdir())  # a slow start may be a recording of its own
    with open_run(own) as first, open_run(live, strict=True) as second:
        yield first, second


def test_the_graph_of_every_interval_is_the_testbeds_own(recordings):
    own, live = (
        [(set(each.graph.nodes(data="type")), set(each.graph.edges)) for each in run.intervals]
        for run in recordings
    )
    assert len(live) >= 2
    assert all(graph == own[-1] for graph in live)


def test_the_messages_are_there_with_the_bytes_that_were_sent(recordings):
    own, live = (Counter((m.topic, m.data) for m in run.bag.messages()) for run in recordings)
    missing = own - live
    assert missing.total() <= 0.001 * own.total()


def test_features_are_those_of_the_testbeds_own_recording(recordings, tmp_path):
    own, live = recordings
    _with_times_of(own.bag, live.bag, tmp_path / "retimed")
    manager = build_manager(None)
    with open_run(own.path / "bag") as run, open_run(tmp_path / "retimed") as retimed:
        first, second = extract(run, manager).run, extract(retimed, manager).run
    fields = field_metadata(first)
    known = [c for c in feature_columns(first) if np.isfinite(first[c].iloc[0])]
    differing = {
        column: (first[column].iloc[0], second[column].iloc[0])
        for column in known
        if not np.isclose(
            second[column].iloc[0], first[column].iloc[0], TOLERANCE, float(fields[column]["floor"])
        )
    }
    assert len(known) > 80
    assert not differing


def _with_times_of(own, live, path):
    """Copy a live recording, each message with its time in the testbed's own.

    How late a message arrives is a matter of the machine, so it says nothing about the recorder.
    """
    times = defaultdict(deque)
    for message in own.messages():
        times[message.topic, message.data].append(message.stamp_ns)
    arrived = [
        (times[message.topic, message.data].popleft(), message)
        for message in live.messages(own.topics)
        if times.get((message.topic, message.data))
    ]
    with BagWriter(path) as bag:
        for topic in own.topics.values():
            bag.add_topic(topic.name, topic.msgtype, topic.qos)
        for stamp_ns, message in sorted(arrived, key=lambda each: each[0]):
            bag.write(message.topic, stamp_ns, message.data)
