"""How often ``oracle score`` exits 1 for harmless changes that no normal recording shows.

A card of 29 normal recordings judges altered copies of four others. No constant was chosen with
these kinds. Chosen with were: lost messages, one or five in a row; scans and positions in mm; noise
of 2 mm; delays of 10 ms; jitter of 1 ms, and exchanged neighbours; a limit and a median on a relay
of scans; and commands in cm/s.
``ORACLE_BENCH_RUNS`` names a folder to keep recordings and copies in.
"""

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from oracle_pipeline import learn, score
from oracle_pipeline.bags.reader import BagReader, RawMessage
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.types import serialize
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.scoring.output import exit_code
from sim.campaigns import Campaign
from sim.experiments import recipe_for, record_run
from tools.bench.figures import Row

MODE, GOALS, NORMAL, JUDGED = "lidar_passthrough_odom", 4, 29, 4
CARD_SEED, SEED, GOAL = 411, 4711, 0.2
#: Takes the messages of a topic, and returns them changed.
Change: TypeAlias = Callable[[BagReader, list[RawMessage], np.random.Generator], list[RawMessage]]


def recorded(when: Callable[..., Any], keep: Callable[..., Any] = lambda t, _: t >= 0) -> Change:
    """Record messages at other times [ns], and keep some, by functions of draws and times."""

    def change(_: BagReader, messages: list[RawMessage], rng: np.random.Generator) -> Any:
        times = np.array([each.stamp_ns for each in messages])
        all_of = zip(messages, when(times, rng), keep(times, rng), strict=True)
        return [m._replace(stamp_ns=int(t)) for m, t, kept in all_of if kept]

    return change


def edited(field: str, value: Callable[..., Any]) -> Change:
    """Replace a field by a function of its value and of the value written before."""
    *owners, name = field.split(".")

    def change(bag: BagReader, messages: list[RawMessage], _: np.random.Generator) -> Any:
        last, written = None, []
        for raw in messages:
            message = owner = bag.deserialize(raw)
            for each in owners:
                owner = getattr(owner, each)
            now = getattr(owner, name)
            last = value(now, now if last is None else last)
            setattr(owner, name, last)
            written.append(raw._replace(data=serialize(message, bag.topics[raw.topic].msgtype)))
        return written

    return change


def lost(share: float, in_a_row: int = 1) -> Change:
    """Lose a share of the messages, some in a row."""

    def keep(times: Any, rng: np.random.Generator) -> Any:
        first = rng.random(len(times)) < share / in_a_row
        return np.convolve(first, np.ones(in_a_row))[: len(times)] == 0

    return recorded(lambda times, _: times, keep)


def slower(_: BagReader, messages: list[RawMessage], __: np.random.Generator) -> list[RawMessage]:
    """Return 3 % fewer messages, evenly."""
    places = np.arange(0, len(messages) - 1, 1.03)
    times = np.interp(places, np.arange(len(messages)), [each.stamp_ns for each in messages])
    pairs = zip(np.rint(places).astype(int).tolist(), times.tolist(), strict=True)
    return [messages[place]._replace(stamp_ns=int(time)) for place, time in pairs]


def unspeckled(ranges: Any, _: Any) -> Any:
    """Return ranges without rays that are farther than 0.3 m from both neighbours."""
    with np.errstate(invalid="ignore"):
        before, after = (np.abs(ranges - np.roll(ranges, by)) for by in (1, -1))
    return np.where(np.minimum(before, after) > 0.3, np.inf, ranges).astype(np.float32)


def mean_of_three(ranges: Any, _: Any) -> Any:
    """Return each range's mean with those of the rays beside it."""
    return np.mean([np.roll(ranges, by) for by in (-1, 0, 1)], axis=0, dtype=np.float32)


def in_2_mm(ranges: Any, _: Any) -> Any:
    """Return ranges in steps of 2 mm."""
    return (np.round(ranges / 0.002) * 0.002).astype(np.float32)


_TURN, _GYRO = "twist.twist.angular.z", "angular_velocity.z"
_SCANS, _LATE_NS = "/scan /scan_tom /scan_fakeobject", 20_000_000
KINDS: dict[str, tuple[str, Change]] = {  # topics, all without any
    "/range_ella loses 3 in a row": ("/range_ella", lost(0.03, 3)),
    "every fourth of /joint_states left out": (
        "/joint_states", recorded(lambda t, _: t, lambda t, _: np.arange(len(t)) % 4 != 3),
    ),
    "turn rate of /odom in single precision": (
        "/odom", edited(_TURN, lambda now, _: float(np.float32(now))),
    ),
    "turn rate of /odom smoothed": ("/odom", edited(_TURN, lambda now, last: (now + last) / 2)),
    "position of /odom in cm": (
        "/odom", edited("pose.pose.position.x", lambda now, _: round(now, 2)),
    ),
    "/scan_tom in 2 mm": ("/scan_tom", edited("ranges", in_2_mm)),
    "scans 20 ms late": (_SCANS, recorded(lambda t, _: t + _LATE_NS)),
    "gyroscope in 0.01 rad/s": ("/imu", edited(_GYRO, lambda now, _: round(now, 2))),
    "low-pass filter on the gyroscope": ("/imu", edited(_GYRO, lambda now, last: (now + last) / 2)),
    "/imu 3 % slower": ("/imu", slower),
    "jitter of 5 ms on scans": (_SCANS, recorded(lambda t, rng: t + rng.uniform(0, 5e6, len(t)))),
    "recorder writes every 20 ms": ("", recorded(lambda t, _: -(-t // _LATE_NS) * _LATE_NS)),
    "/scan through a mean of 3 rays": ("/scan", edited("ranges", mean_of_three)),
    "speckles removed from /scan": ("/scan", edited("ranges", unspeckled)),
}  # fmt: skip


def rows() -> Iterator[Row]:
    """Yield how many copies have exit code 1, by kind, and the share of all copies."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(os.environ.get("ORACLE_BENCH_RUNS", folder))
        card = learn([record(root / "card", CARD_SEED, n).path for n in range(NORMAL)])
        judged = [record(root / "judged", SEED, number) for number in range(JUDGED)]
        exits = []
        for number, (name, (topics, change)) in enumerate(KINDS.items()):
            copies = [
                _copy(e, root / f"kind{number}" / e.path.name, topics, change) for e in judged
            ]
            exits += [exit_code(score(copy, card).verdicts) == 1 for copy in copies]
            yield Row(name, sum(exits[-JUDGED:]), f"of {JUDGED}")
        yield Row("all kinds", sum(exits) / len(exits), "", GOAL)


def record(
    root: Path, seed: int, number: int, goals: int = GOALS, mode: str = MODE
) -> RunDirectory:
    """Record a run, if it is not there yet."""
    directory = RunDirectory(root, mode, number)
    if not directory.path.exists():
        record_run(recipe_for(mode, number, Campaign(seed=seed, goals_per_run=goals)), directory)
    return directory


def _copy(run: RunDirectory, path: Path, topics: str, change: Change) -> Path:
    """Return the path of a changed copy of a run's bag."""
    if path.exists():
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    rng, found = np.random.default_rng(SEED), []
    with BagReader(run.path / "bag") as bag, BagWriter(path) as writer:
        by_topic: dict[str, list[RawMessage]] = {name: [] for name in bag.topics}
        for message in bag.messages():
            by_topic[message.topic].append(message)
        for name, messages in by_topic.items():
            writer.add_topic(name, bag.topics[name].msgtype, bag.topics[name].qos)
            is_chosen = messages and name in (topics.split() or by_topic)
            found += change(bag, messages, rng) if is_chosen else messages
        for message in sorted(found, key=lambda each: each.stamp_ns):
            writer.write(*message)
    return path
