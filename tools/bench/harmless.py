"""How often ``oracle score`` exits 1 for harmless changes that no normal recording shows.

A card of 29 normal recordings judges altered copies of others that it calls normal. No constant
was chosen with these kinds. Chosen with were: lost messages, one, three or five in a row, or every
fourth; scans in mm and 2 mm, positions in mm and cm, other numbers of odometry and gyroscope
rounded or smoothed; noise of 2 mm; delays of 10 and 20 ms; jitter of 1 and 5 ms, exchanged
neighbours, and a recorder that writes every 20 ms; a limit, a median, a mean and a filter of
speckles on scans; and commands in cm/s.
``ORACLE_BENCH_RUNS`` names a folder to keep recordings and copies in.
"""

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from oracle_pipeline import learn, score
from oracle_pipeline.bags.qos_profiles import is_latched
from oracle_pipeline.bags.reader import BagReader, RawMessage
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.types import serialize
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.scoring.output import exit_code
from sim.campaigns import Campaign
from sim.experiments import recipe_for, record_run
from tools.bench.figures import Row

MODE, GOALS, NORMAL, JUDGED = "lidar_passthrough_odom", 4, 29, 6
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


def lost(share: float) -> Change:
    """Lose a share of the messages of topics that have more than a few."""

    def keep(times: Any, rng: np.random.Generator) -> Any:
        return (rng.random(len(times)) >= share) | (len(times) < _FEW)

    return recorded(lambda times, _: times, keep)


def holed(ranges: Any, _: Any) -> Any:
    """Return ranges without the returns of some rays, others in each scan, as of dust."""
    first = int(np.nansum(ranges[np.isfinite(ranges)]) * 1e4)
    return np.where((np.arange(len(ranges)) * 97 + first) % 211 == 0, np.inf, ranges)


def further(ranges: Any, _: Any) -> Any:
    """Return ranges of a scanner that is 5 mm long."""
    return (ranges + 0.005).astype(np.float32)


def in_ticks(angles: Any, _: Any) -> Any:
    """Return angles of joints in the steps of an encoder."""
    return np.round(angles / _TICK) * _TICK


def later(bag: BagReader, messages: list[RawMessage], _: np.random.Generator) -> list[RawMessage]:
    """Leave out the first 5 s; what latched topics hold comes at the new start."""
    start_ns = bag.start_ns + 5_000_000_000
    qos = bag.topics[messages[0].topic].qos[0]
    before = [each._replace(stamp_ns=start_ns) for each in messages if each.stamp_ns < start_ns]
    held = before[-qos.depth :] if is_latched(qos) else []
    return held + [each for each in messages if each.stamp_ns >= start_ns]


_TURN, _GYRO, _FORCE = "twist.twist.angular.z", "angular_velocity.z", "linear_acceleration.x"
_TICK = 2.0 * np.pi / 4096
_FEW = 9  # messages of a topic that loses none
KINDS: dict[str, tuple[str, Change]] = {  # topics, all without any
    "/local_costmap/costmap 10 % slower": (
        "/local_costmap/costmap", recorded(lambda t, _: t, lambda t, _: np.arange(len(t)) % 10 > 0),
    ),
    "accelerations in 0.05 m/s^2": (
        "/imu", edited(_FORCE, lambda now, _: round(now / 0.05) * 0.05),
    ),
    "gyroscope through an exponential filter": (
        "/imu", edited(_GYRO, lambda now, last: 0.7 * now + 0.3 * last),
    ),
    "rays of /scan without return, as of dust": ("/scan", edited("ranges", holed)),
    "ranges of /scan_tom 5 mm longer": ("/scan_tom", edited("ranges", further)),
    "joints in ticks of an encoder": ("/joint_states", edited("position", in_ticks)),
    "turn rate of /odom in mrad/s": ("/odom", edited(_TURN, lambda now, _: round(now, 3))),
    "y of /odom in mm": ("/odom", edited("pose.pose.position.y", lambda now, _: round(now, 3))),
    "/odom 15 ms late": ("/odom", recorded(lambda t, _: t + 15_000_000)),
    "a loaded machine": ("", recorded(lambda t, rng: t + rng.exponential(3e6, len(t)))),
    "recorder's clock fast by 100 ppm": ("", recorded(lambda t, _: (t * 1.0001).astype(np.int64))),
    "all topics lose 1 %": ("", lost(0.01)),
    "/tf loses 2 %": ("/tf", lost(0.02)),
    "recorder started 5 s later": ("", later),
}  # fmt: skip


def rows() -> Iterator[Row]:
    """Yield how many copies have exit code 1, by kind, and the share of all copies."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(os.environ.get("ORACLE_BENCH_RUNS", folder))
        card = learn([record(root / "card", CARD_SEED, n).path for n in range(NORMAL)])
        judged = [record(root / "judged", SEED, number) for number in range(JUDGED)]
        passed = [e for e in judged if exit_code(score(e.path / "bag", card).verdicts) == 0]
        yield Row("normal without a change, so judged", len(passed), f"of {JUDGED}")
        exits = []
        for name, (topics, change) in KINDS.items():
            folder_of_kind = root / "".join(each if each.isalnum() else "_" for each in name)
            copies = [_copy(e, folder_of_kind / e.path.name, topics, change) for e in passed]
            called = [exit_code(score(copy, card).verdicts) == 1 for copy in copies]
            exits += called
            yield Row(name, sum(called), f"of {len(called)}")
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
