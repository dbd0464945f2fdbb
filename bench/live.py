"""The oracle beside a running robot: delay of alarms, false ones, latency, share of a core, losses.

`oracle-sim serve` and `oracle watch` are processes of their own on one DDS domain. A card is
learned from recordings that `oracle watch` makes. Then other patrols are watched, some with an
attack that is switched on while they drive. Times are the robot's.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.figures import Row, median, spread

LEARNED = 10  # recordings that the card is learned from
ATTACKED = 3
NORMAL = 1
GOALS = 4  # of each patrol: about 80 s
SPEED = 3.0  # of the robot, for all that the card is of; the share of a core is taken at 1
ONSET_S = 45.0  # after the patrol began, by the robot's clock
LATER_S = 30.0  # that an attack is watched
ATTACK = "random_noise"
DOMAIN = 231
_BIN = Path(sys.executable).parent


@dataclass
class Watched:
    """What one watch printed, each with the time at which it came."""

    told: list[tuple[float, dict[str, Any]]] = field(default_factory=list)
    dropped: int = 0
    attacked_at: float | None = None
    share: float = 0.0  # of a core

    def verdicts(self) -> list[dict[str, Any]]:
        """Return the verdicts on windows."""
        return [told["window"] for _, told in self.told if "window" in told]

    def alarms(self) -> list[float]:
        """Return when alarms came."""
        return [at for at, told in self.told if "alarm" in told]


def rows() -> Iterator[Row]:
    """Yield the figures."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for number in range(LEARNED):
            _watched(root / "good", number, SPEED)
        card = root / "robot.card"
        subprocess.run([_BIN / "oracle", "learn", root / "good", "--output", card], check=True,
                       stdout=subprocess.DEVNULL)  # fmt: skip
        attacked = [
            _watched(root / "attacked", 100 + number, SPEED, card, attacked=True)
            for number in range(ATTACKED)
        ]
        normal = [_watched(root / "normal", 200 + number, SPEED, card) for number in range(NORMAL)]
        real_time = _watched(root / "real", 300, 1.0, card)
    yield from _figures(attacked, normal, real_time)


def _figures(attacked: list[Watched], normal: list[Watched], real_time: Watched) -> Iterator[Row]:
    delays = [
        min((at - watch.attacked_at for at in watch.alarms() if at > watch.attacked_at),
            default=float("inf")) * SPEED
        for watch in attacked
        if watch.attacked_at is not None
    ]  # fmt: skip
    yield Row(f"median delay of an alarm, {ATTACK}", median(delays), "s", 10.0,
              remark=spread(delays))  # fmt: skip
    before = sum(
        sum(at < (watch.attacked_at or 0.0) for at in watch.alarms()) for watch in attacked
    )
    hours = sum(watch.verdicts()[-1]["end_s"] for watch in normal) / 3600.0
    hours += ATTACKED * ONSET_S / 3600.0
    false_alarms = before + sum(len(watch.alarms()) for watch in normal)
    yield Row("false alarms an hour", false_alarms / hours, "", 1.0,
              remark=f"({false_alarms} in {hours:.2g} h)")  # fmt: skip
    latencies = [verdict["latency_s"] for verdict in real_time.verdicts()]
    yield Row("from the end of a window to its verdict, at real time", median(latencies), "s", 0.5,
              remark=spread(latencies))  # fmt: skip
    yield Row("share of a core, at real time", 100 * real_time.share, "%", 15.0)
    everything = [*attacked, *normal, real_time]
    yield Row("messages dropped", sum(watch.dropped for watch in everything), "", 0.0)


def _watched(
    out: Path, run: int, speed: float, card: Path | None = None, *, attacked: bool = False
) -> Watched:
    """Watch one patrol from before its beginning to after its end."""
    reference = [] if card is None else ["--reference", str(card)]
    watch: Any = subprocess.Popen(
        [_BIN / "oracle", "watch", "--domain", str(DOMAIN), "--out", str(out), "--format", "json",
         *reference],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    watched = Watched()
    reader = threading.Thread(target=_read, args=(watch.stdout, watched))
    reader.start()
    watch.stderr.readline()  # it is there
    serve: Any = subprocess.Popen(
        [_BIN / "oracle-sim", "serve", "--domain", str(DOMAIN), "--speed", str(speed),
         "--run", str(run), "--goals", str(GOALS)],
        stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    serve.stderr.readline()  # it is there
    if attacked:
        time.sleep(ONSET_S / speed)
        serve.stdin.write(f"attack {ATTACK}\n")
        serve.stdin.flush()
        watched.attacked_at = time.monotonic()
        time.sleep(LATER_S / speed)
        serve.send_signal(signal.SIGINT)
    elif speed == 1.0:
        time.sleep(25.0)  # everything is loaded then
        before, began = _processor_s(watch.pid), time.monotonic()
        time.sleep(40.0)
        watched.share = (_processor_s(watch.pid) - before) / (time.monotonic() - began)
    serve.wait()
    watch.send_signal(signal.SIGINT)
    reader.join()
    said = watch.stderr.read()
    watch.wait()
    heard = next(line for line in said.splitlines() if "dropped" in line)
    watched.dropped = int(heard.split()[3])
    return watched


def _read(lines: Any, watched: Watched) -> None:
    for line in lines:
        watched.told.append((time.monotonic(), json.loads(line)))


def _processor_s(process: int) -> float:
    """Return the processor time of a process and its children so far [s]."""
    children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    ticks = os.sysconf("SC_CLK_TCK")
    total = 0.0
    for each in (process, *map(int, children)):
        fields = Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split()
        total += (int(fields[11]) + int(fields[12])) / ticks
    return total
