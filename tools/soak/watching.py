"""Watch a robot that drives normally for an hour.

``python -m tools.soak.watching`` learns a card from patrols, each in a different session. Then it
serves a long patrol of another session on a DDS domain, and watches it. The watch must drop no
message, its memory must not grow, it may take only a share of a core, and it may raise at most one
alarm. It prints one line per minute.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from tools.bench.side_by_side import (
    Watching,
    learn,
    memory_bytes,
    processor_s,
    recorded,
    serving,
    watching,
)

DOMAIN = 230
RUN = 900  # run of the campaign, in a session that the card has not seen
RECORDINGS = 45  # recordings to learn a card from, if none is given
GOALS = 8  # goals of each recording: 150 s
SPEED = 4.0  # real-time factor while they are recorded
SETTLED = 1 / 6  # fraction of the time after which memory must not grow
GROWTH = 1.1  # largest allowed growth of memory
SHARE = 0.15  # largest share of a core, at real time
LATENCY_S = 0.5  # largest median latency of verdicts, at real time
_GOAL_S = 15.0  # shortest time of a goal
_PERIOD_S = 60.0


def main() -> None:
    """Serve and watch a patrol, and exit with 1 if a goal was missed."""
    parser = argparse.ArgumentParser(prog="python -m tools.soak.watching", description=main.__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="by the robot's clock")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--reference", type=Path, help="a card; by default one is learned")
    parser.add_argument("--domain", type=int, default=DOMAIN)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        card = options.reference
        if card is None:
            card = Path(folder, "robot.card")
            recorded(Path(folder, "good"), range(RECORDINGS), SPEED, GOALS, options.domain)
            learn(Path(folder, "good"), card)
        seconds = 60.0 * options.minutes
        patrol = ("--speed", str(options.speed), "--run", str(RUN),
                  "--goals", str(int(seconds / _GOAL_S) + 1))  # fmt: skip
        with (
            watching(options.domain, "--reference", card, "--out", folder) as watch,
            serving(options.domain, *patrol) as serve,
        ):
            minutes = _measurements(watch, serve, seconds / options.speed)
    sys.exit(0 if _meets_goals(watch, minutes, options.speed) else 1)


def _measurements(watch: Watching, serve: Any, wall_s: float) -> list[dict[str, float]]:
    """Wait, take a measurement each minute, and return them."""
    began = before_at = time.monotonic()
    before_s = processor_s(watch.process.pid)
    minutes: list[dict[str, float]] = []
    while before_at - began < wall_s and watch.process.poll() is None and serve.poll() is None:
        time.sleep(min(_PERIOD_S, max(1.0, wall_s - (before_at - began))))
        now, now_s = time.monotonic(), processor_s(watch.process.pid)
        minutes.append(
            {
                "minute": round((now - began) / 60.0, 1),
                "memory_mb": round(memory_bytes(watch.process.pid) / 1e6, 1),
                "share": round((now_s - before_s) / (now - before_at), 3),
                "verdicts": len(watch.verdicts()),
                "alarms": len(watch.alarms()),
                "load": round(os.getloadavg()[0], 1),
            }
        )
        before_at, before_s = now, now_s
        print(json.dumps(minutes[-1]), flush=True)
    return minutes


def _meets_goals(watch: Watching, minutes: list[dict[str, float]], speed: float) -> bool:
    """Print the results, and return whether all goals are met; some apply at real time only."""
    settled = [each["memory_mb"] for each in minutes[int(len(minutes) * SETTLED) :]]
    share = float(np.median([each["share"] for each in minutes]))
    latency = np.quantile([each["latency_s"] for each in watch.verdicts()], [0.5, 0.9, 1.0])
    print(f"Messages: {watch.received} received, {watch.dropped} dropped.")
    print(f"Memory: {settled[0]:.0f} MB settled, {max(settled):.0f} MB at most.")
    print(f"Share of a core: {share:.1%} (median of the minutes).")
    print("Latency of verdicts: median {:.2f} s, 90 % {:.2f} s, at most {:.2f} s.".format(*latency))
    print(f"Alarms: {len(watch.alarms())} in {watch.verdicts()[-1]['end_s'] / 60.0:.1f} minutes.")
    for alarm in watch.alarms():
        print(json.dumps(alarm))
    is_prompt = speed != 1.0 or (share <= SHARE and latency[0] <= LATENCY_S)
    is_flat = max(settled) <= GROWTH * settled[0]
    return watch.dropped == 0 and is_flat and is_prompt and len(watch.alarms()) <= 1


if __name__ == "__main__":
    main()
