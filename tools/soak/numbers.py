"""Write odd numbers into recorded messages: no feature and no check may fail, or read elsewhere.

``python -m tools.soak.numbers`` records a run of each testbed, and a few messages of every known
type. In copies of the first 10 s it overwrites some bytes of some topics with numbers such as NaN,
1e300 and the largest integer: lengths, angles and text, too. Features and checks of each copy are
computed by loops that are compiled with bounds checks. The test suite does the same with fewer
copies, without bounds checks.
"""

import argparse
import logging
import math
import multiprocessing
import os
import shutil
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from assets.worker.run import process_run
from assets.worker.run_job import OF_A_RUN, RunJob
from oracle_pipeline.bags.cdr import DTYPES, ENCAPSULATION, is_number
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.reader import BagReader, RawMessage
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.types import message_class, serialize, typestore
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.checks.run import check_recording
from oracle_pipeline.features import FeatureManager, build_manager, measure
from oracle_pipeline.opened_run import open_run
from sim.campaigns import Campaign

MODES = ("lidar_passthrough_odom", "atc_normal", "cf_normal", "arm_normal")
LENGTH_NS = 10_000_000_000
_TOPICS_IN_A_BAG, _MESSAGES = 40, 60
_FLOATS = (
    0.0, -1.0, 7.3, 1e6, 1e18, -1e18, 1e30, 1e-30, -1e-30, 2.0**31, math.inf, -math.inf, math.nan
)  # fmt: skip
NUMBERS = [
    *(struct.pack("<d", each) for each in (*_FLOATS, 1e300, -1e300, 5e-324, 2.0**63)),
    *(struct.pack("<f", each) for each in _FLOATS),
    *(struct.pack("<I", each) for each in (0, 1, 1_000, 100_000, 2**31 - 1, 2**31, 2**32 - 1)),
    *(struct.pack("B", each) for each in (0, 1, 127, 128, 255)),
]
"""What is written over bytes of a message."""


class Recording:
    """The first messages of a recording."""

    def __init__(self, path: Path) -> None:
        with BagReader(path) as bag:
            end_ns = bag.start_ns + LENGTH_NS
            self.types = {topic.name: topic.msgtype for topic in bag.topics.values()}
            self.messages = [each for each in bag.messages() if each.stamp_ns < end_ns]
        self.sizes = Counter[str]()
        for each in self.messages:
            self.sizes[each.topic] = max(self.sizes[each.topic], len(each.data))

    def altered(self, rng: np.random.Generator) -> list[RawMessage]:
        """Return the messages with a number written over a few places of a few topics."""
        places = [self._place(rng) for _ in range(rng.integers(1, 6))]
        messages = []
        for topic, stamp_ns, data in self.messages:
            changed = bytearray(data)
            for name, start, number, share in places:
                end = start + len(number)
                if name == topic and end <= len(changed) and rng.random() < share:
                    changed[start:end] = number
            messages.append(RawMessage(topic, stamp_ns, bytes(changed)))
        return messages

    def _place(self, rng: np.random.Generator) -> tuple[str, int, bytes, float]:
        """Draw topic, byte, number, and in which share of the topic's messages it is written."""
        topic = str(rng.choice(sorted(self.sizes)))
        number = NUMBERS[rng.integers(len(NUMBERS))]
        step = len(number) if rng.random() < 0.5 else min(len(number), 4)
        size = min(self.sizes[topic], int(rng.choice([64, 256, 4096]))) - len(ENCAPSULATION)
        start = len(ENCAPSULATION) + step * int(rng.integers(max(1, size // step)))
        return topic, start, number, float(rng.choice([1.0, 0.5, 0.05]))


class _Failures(logging.Handler):
    """Keeps what features report as their own failures."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.records: list[logging.LogRecord] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record."""
        self.records.append(record)


def failures(paths: Sequence[Path], copies: int, seed: int, folder: Path) -> list[str]:
    """Alter copies of recordings, and return what failed."""
    rng, manager, log = np.random.default_rng(seed), build_manager(), _Failures()
    logging.getLogger("oracle_pipeline").addHandler(log)
    recordings, found = [Recording(path) for path in paths], list[str]()
    for copy in range(copies):
        recording, path = recordings[copy % len(recordings)], folder / f"{seed}_{copy}"
        with BagWriter(path) as bag:
            for topic, stamp_ns, data in recording.altered(rng):
                bag.add_topic(topic, recording.types[topic], [])
                bag.write(topic, stamp_ns, data)
        if failed := _failures_of(path, manager, log.records):
            found += failed
        else:
            shutil.rmtree(path)
    logging.getLogger("oracle_pipeline").removeHandler(log)
    return found


def _failures_of(path: Path, manager: FeatureManager, logged: list[logging.LogRecord]) -> list[str]:
    logged.clear()
    raised = []
    try:
        with suppress(OracleError):
            with open_run(path) as run:
                measure(run, manager)
            check_recording(path)
    except Exception as error:  # what no user should see
        raised.append(repr(error))
    return [f"{path}: {text}" for text in (*raised, *(each.getMessage() for each in logged))]


def write_every_type(folder: Path) -> Iterator[Path]:
    """Write bags with messages of all known types, and yield them."""
    names = [name for name in sorted(typestore().fielddefs) if "/msg/" in name]
    for first in range(0, len(names), _TOPICS_IN_A_BAG):
        path = folder / f"types{first}"
        with BagWriter(path) as bag:
            for number in range(_MESSAGES):
                for name in names[first : first + _TOPICS_IN_A_BAG]:
                    topic = f"/{name.replace('/', '_').lower()}"
                    bag.add_topic(topic, name, [])
                    message = _filled((Nodetype.NAME, name), math.sin(number / 10))
                    bag.write(topic, number * LENGTH_NS // _MESSAGES, serialize(message, name))
        yield path


def _filled(desc: Any, number: float) -> Any:
    """Return a value for a field, by its description in a type store."""
    kind, detail = desc
    if kind == Nodetype.NAME:
        fields = typestore().fielddefs[detail][1]
        return message_class(detail)(**{name: _filled(each, number) for name, each in fields})
    if kind == Nodetype.BASE:
        if detail[0] not in DTYPES:
            return "map"
        return DTYPES[detail[0]].type(number if DTYPES[detail[0]].kind == "f" else number > 0.0)
    element, length = detail
    values = [_filled(element, number)] * (length if kind == Nodetype.ARRAY else 3)
    return np.array(values, DTYPES[element[1][0]]) if is_number(element) else values


def recorded(folder: Path) -> Iterator[Path]:
    """Record a run of each testbed, and yield the bags."""
    for mode in MODES:
        run = RunDirectory(folder, mode, 0)
        process_run(RunJob(run, Campaign(timeout_s=20.0), OF_A_RUN, refresh=False))
        yield run.bag


def main() -> None:
    """Alter messages in recordings, and print which features and checks failed."""
    parser = argparse.ArgumentParser(prog="python -m tools.soak.numbers", description=main.__doc__)
    parser.add_argument("--copies", type=int, default=2_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="numbers"))
    paths = [*recorded(folder), *write_every_type(folder)]
    # Loops that were compiled without checks are not used.
    os.environ |= {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(folder / "numba")}
    processes = os.cpu_count() or 1
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        jobs = [
            pool.submit(
                failures, paths, arguments.copies // processes, arguments.seed + number, folder
            )
            for number in range(processes)
        ]
        found = [line for job in jobs for line in job.result()]
    print("\n".join(found) or f"No feature and no check of {arguments.copies} copies failed.")
    if not found:
        shutil.rmtree(folder)
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
