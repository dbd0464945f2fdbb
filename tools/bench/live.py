"""The oracle beside a running robot: alarm delay, false alarms, latency, processor share, losses.

`oracle-sim serve` and `oracle watch` run as separate processes on one DDS domain. A card is learned
from patrols that `oracle watch` recorded, each in a different session. Then patrols of other
sessions are watched, while many kinds of attack are switched on and off in random order. Times are
by the robot's clock. A delay is the time from switching an attack on to the verdict that raises the
alarm. It ignores the ten minutes of silence after an earlier alarm.
"""

import os
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oracle_pipeline.opened_run import open_run
from oracle_pipeline.scoring.alarms import RATE_PER_H, AlarmRule, Statistic
from oracle_pipeline.scoring.card import ReferenceCard
from tools.bench.figures import Row, median, spread
from tools.bench.side_by_side import (
    Watching,
    learn,
    processor_s,
    recorded,
    serving,
    switch,
    watching,
)

LEARNED = 45  # recordings that the card is learned from
GOALS = 8  # of each: about 150 s
SPEED = 3.0  # real-time factor, except where real time is measured
ATTACKS = (
    "random_noise", "fake_object", "held_object", "blinded_sector", "range_drift", "sensor_delay",
    "sensor_drop", "sensor_freeze", "sensor_replay", "topic_flood", "message_mutator",
    "random_noise_thesis",
)  # fmt: skip
RUNS = (100, 101)  # of the campaign: each is a session and an order of attacks
BEFORE_S, ON_S, OFF_S = 60.0, 35.0, 70.0  # before the first attack, on, and off
DOMAIN = 231


@dataclass(frozen=True)
class Patrol:
    """The result of a patrol with attacks."""

    delays: dict[str, float]  # by attack [s]; infinity if there was no alarm
    false_alarms: int
    quiet_s: float  # without an attack, and not just after one
    dropped: int


def rows() -> Iterator[Row]:
    """Yield the figures."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        recorded(root / "good", range(LEARNED), SPEED, GOALS, DOMAIN)
        card = root / "robot.card"
        learn(root / "good", card)
        patrols = [_attacked(card, root / str(run), run) for run in RUNS]
        yield from _of_attacks(patrols)
        yield from _at_real_time(card, root / "real")
    yield Row("load of the machine, at the end", os.getloadavg()[0])


def _of_attacks(patrols: Sequence[Patrol]) -> Iterator[Row]:
    delays = [delay for patrol in patrols for delay in patrol.delays.values()]
    quartiles = np.quantile(delays, [0.25, 0.75], method="nearest")
    yield Row(f"median delay of an alarm, {len(delays)} attacks", median(delays), "s", 10.0,
              remark="(quartiles: {:.3g} and {:.3g})".format(*quartiles))  # fmt: skip
    for attack in ATTACKS:
        of = [patrol.delays[attack] for patrol in patrols]
        yield Row(f"  {attack}", median(of), "s", remark=spread(of))
    hours = sum(patrol.quiet_s for patrol in patrols) / 3600.0
    count = sum(patrol.false_alarms for patrol in patrols)
    yield Row("false alarms per hour", count / hours, "", 1.0, remark=f"({count} in {hours:.2g} h)")
    yield Row("messages dropped", sum(patrol.dropped for patrol in patrols), "", 0.0)


def _attacked(card: Path, out: Path, run: int) -> Patrol:
    """Watch one patrol, and switch each attack on and off."""
    order = np.random.default_rng(run).permutation(ATTACKS).tolist()
    patrol = ("--run", str(run), "--speed", str(SPEED), "--goals", "100")
    phases = []
    with (
        watching(DOMAIN, "--reference", card, "--out", out) as watch,
        serving(DOMAIN, *patrol) as serve,
    ):
        time.sleep(BEFORE_S / SPEED)
        for attack in order:
            on_s = switch(serve, attack)
            time.sleep(ON_S / SPEED)
            phases.append((attack, on_s, switch(serve, "off")))
            # Not a multiple of the time between windows, so that onsets lie anywhere in them.
            time.sleep((OFF_S + np.random.default_rng(len(phases)).uniform(0.0, 5.0)) / SPEED)
    return _patrol(watch, phases, _rule(card))


def _patrol(watch: Watching, phases: list[tuple[str, float, float]], rule: AlarmRule) -> Patrol:
    """Return the delays. An alarm from an attack that has just ended does not count as false."""
    start_s, statistic = watch.start_s(), Statistic(rule)
    raised = [
        (start_s + verdict["end_s"], verdict["latency_s"])
        for verdict in watch.verdicts()
        if statistic.feed(verdict["score"]) > rule.threshold
    ]
    raised += [(start_s + each["end_s"], 0.0) for each in watch.alarms() if "contract" in each]
    delays = {
        attack: min(
            (at_s - on_s + late_s for at_s, late_s in raised if on_s < at_s < off_s + 10.0),
            default=np.inf,
        )
        for attack, on_s, off_s in phases
    }
    spans = [(on_s, off_s + OFF_S) for _, on_s, off_s in phases]
    false = [at_s for at_s, _ in raised if not any(on <= at_s <= end for on, end in spans)]
    end_s = watch.verdicts()[-1]["end_s"]
    return Patrol(delays, len(false), end_s - sum(end - on for on, end in spans), watch.dropped)


def _rule(card: Path) -> AlarmRule:
    normal = ReferenceCard.load(card).scorer.windows_
    if normal is None:
        raise RuntimeError(f"{card} has no rule for windows")
    return normal.rule(max(RATE_PER_H, normal.lowest_rate()))


def _at_real_time(card: Path, root: Path) -> Iterator[Row]:
    """Watch one patrol at real time, which the testbed records as well."""
    patrol = ("--run", "300", "--goals", "4", "--out", root / "own")
    with (
        watching(DOMAIN, "--reference", card, "--out", root / "live") as watch,
        serving(DOMAIN, *patrol) as serve,
    ):
        time.sleep(25.0)  # time to load everything
        before_s, began = processor_s(watch.process.pid), time.monotonic()
        serve.wait()
        used_s, wall_s = processor_s(watch.process.pid) - before_s, time.monotonic() - began
    latencies = [verdict["latency_s"] for verdict in watch.verdicts()]
    yield Row("from the end of a window to its verdict, at real time", median(latencies), "s", 0.5,
              remark=spread(latencies))  # fmt: skip
    yield Row("share of a core, at real time", 100 * used_s / wall_s, "%", 15.0)
    (own,) = (root / "own").glob("runs/*/*")
    assert watch.recording is not None  # noqa: S101 -- recording was on
    with open_run(own) as first, open_run(watch.recording) as second:
        sent, came = (Counter((m.topic, m.data) for m in each.bag.messages())
                      for each in (first, second))  # fmt: skip
    lost = (sent - came).total() / sent.total()
    yield Row("messages recorded, with the bytes that were sent", 100 * (1 - lost), "%", 99.9,
              at_most=False)  # fmt: skip
