"""A real run, recorded once: its complete bag, and one with the topics of scenarios."""

import shutil

import pytest

from oracle_pipeline.bags.integrity import hashes_of_files
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.run_directory import BAG_FOLDER, RunDirectory
from oracle_pipeline.bags.writer import BagWriter
from tests.dds_domains import domain, eventually
from tests.manifests import rewrite

__all__ = ["domain", "eventually"]


@pytest.fixture(scope="session")
def recorded(recorded_run):
    """The bag of a real run: one goal, every scan forwarded."""
    directory = recorded_run("lidar_passthrough_odom")
    return directory.bag, directory.manifest()


@pytest.fixture(scope="session")
def run_bag(recorded, tmp_path_factory):
    """The same with the topics of scenarios and of goals only."""
    bag, manifest = recorded
    topics = ["/scan_tom", "/odom", "/scan_fakeobject", "/behavior_tree_log", "/clock"]
    path = tmp_path_factory.mktemp("trimmed") / "bag"
    with BagReader(bag) as reader, BagWriter(path) as writer:
        for topic in topics:
            writer.add_topic(topic, reader.topics[topic].msgtype, reader.topics[topic].qos)
        for message in reader.messages(topics):
            writer.write(*message)
    return path, manifest


@pytest.fixture(scope="session")
def controls(recorded, run_bag, tmp_path_factory):
    """The folder of a mode's runs; run000 has the smaller bag, to compute mutants fast."""
    folder = tmp_path_factory.mktemp("data") / "runs" / "lidar_passthrough_odom"
    shutil.copytree(recorded[0].parent, folder / "run000", ignore=lambda *_: [BAG_FOLDER])
    shutil.copytree(run_bag[0], folder / "run000" / BAG_FOLDER)
    run = RunDirectory.at(folder / "run000")
    files = hashes_of_files(run.path)  # as if it had been recorded
    rewrite(run, lambda document: document["measured"].update(files=files))
    return folder
