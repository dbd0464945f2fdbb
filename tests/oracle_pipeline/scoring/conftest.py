from contextlib import ExitStack

import pytest

from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.robots.robot import find_robots
from oracle_pipeline.scoring.contract import Observer
from tests.oracle_pipeline.features.conftest import write_bag


@pytest.fixture
def observer_of(tmp_path):
    """Observe a bag of some messages; it stays open until the test ends."""
    with ExitStack() as bags:

        def read(recorded):
            write_bag(tmp_path / "robot", recorded)
            bag = bags.enter_context(BagReader(tmp_path / "robot"))
            observer = Observer(find_robots(bag)[0])
            for batch in bag.batches():
                observer.see(batch)
            return observer

        yield read
