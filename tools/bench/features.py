"""Time from a bag to both feature tables, compared with only reading and only decoding it.

One run is recorded. Each round does three things, one right after the other, in processor time:
read the bag with rosbags; read it with our reader and decode the messages that plugins request;
extract all features.
"""

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import ParamSpec

from rosbags.rosbag2 import Reader

from oracle_pipeline import features
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.features.engine.kept_messages import decoded_topics
from oracle_pipeline.opened_run import open_run
from sim.campaigns import Campaign
from sim.experiments import recipe_for, record_run
from tools.bench.figures import Row, median, spread

P = ParamSpec("P")

ROUNDS = 5
GOALS = 8  # of the run
MODE = "lidar_passthrough_odom"


def rows() -> Iterator[Row]:
    """Yield the figures."""
    with tempfile.TemporaryDirectory() as folder:
        directory = RunDirectory(Path(folder), MODE, 0)
        record_run(recipe_for(MODE, 0, Campaign(goals_per_run=GOALS)), directory)
        manager = features.build_manager()
        _extract(directory.path, manager)  # compiles the hot loops, unless they are cached
        wanted = _decoded_topics(directory.path, manager)
        read, decode, extract = [], [], []
        for _ in range(ROUNDS):
            read.append(_seconds(_read, directory.bag))
            decode.append(_seconds(_decode, directory.path, wanted))
            extract.append(_seconds(_extract, directory.path, manager))
    over_read = [all_s / read_s for all_s, read_s in zip(extract, read, strict=True)]
    over_decode = [all_s / decode_s for all_s, decode_s in zip(extract, decode, strict=True)]
    yield Row("bag to both tables, over reading it with rosbags", median(over_read), "x", 2, True,
              spread(over_read))  # fmt: skip
    yield Row("bag to both tables, over decoding the requested topics", median(over_decode), "x",
              remark=spread(over_decode))  # fmt: skip
    yield Row("reading the bag with rosbags", median(read), "s")
    yield Row("bag to both tables", median(extract), "s")


def _seconds(work: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> float:
    begin = time.process_time()
    work(*args, **kwargs)
    return time.process_time() - begin


def _read(bag: Path) -> None:
    with Reader(bag) as reader:
        for _ in reader.messages():
            pass


def _decode(path: Path, decoded: frozenset[str]) -> None:
    with open_run(path) as run:
        for message in run.bag.messages():
            if message.topic in decoded:
                run.bag.deserialize(message)


def _decoded_topics(path: Path, manager: features.FeatureManager) -> frozenset[str]:
    with open_run(path) as run:
        return decoded_topics(run.bag, manager.plugins)


def _extract(path: Path, manager: features.FeatureManager) -> None:
    with open_run(path) as run:
        features.extract(run, manager)
