"""A bag in memory reads like the bag that its messages come from."""

import numpy as np

from oracle_pipeline.bags.memory_bag import MemoryBag
from oracle_pipeline.bags.reader import BagReader


def test_messages_and_topics_are_those_of_the_recording(recorded_run):
    with BagReader(recorded_run("lidar_passthrough").path / "bag") as bag:
        messages = list(bag.messages())
        memory = MemoryBag(bag.path, bag.topics, messages, bag.start_ns, bag.end_ns)
        assert list(memory.messages()) == messages
        assert memory.topics == bag.topics
        (scans,) = memory.batches(["/scan"])
        assert len(scans.topics) == bag.topics["/scan"].count
        scan = next(memory.messages(["/scan"]))
        np.testing.assert_array_equal(memory.deserialize(scan).ranges, bag.deserialize(scan).ranges)


def test_renamed_topics_have_the_same_messages(recorded_run):
    with BagReader(recorded_run("lidar_passthrough").path / "bag") as bag:
        memory = MemoryBag(bag.path, bag.topics, list(bag.messages()), bag.start_ns, bag.end_ns)
        view = memory.renamed({"/scan": "/front"})
        assert [m[1:] for m in view.messages()] == [m[1:] for m in bag.messages(["/scan"])]
        assert set(view.topics) == {"/front"}
