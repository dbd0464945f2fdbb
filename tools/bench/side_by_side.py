"""`oracle-sim serve` and `oracle watch` as separate processes on one DDS domain.

`python -m tools.bench live` and `python -m tools.soak.watching` use this module.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

_BIN = Path(sys.executable).parent
_SECOND_NS = 1_000_000_000


@dataclass
class Watching:
    """A process of `oracle watch`, running or ended.

    Attributes
    ----------
    events : list of dict
        The objects that it printed.
    received, dropped : int
        Numbers of messages; known when it has ended.
    recording : Path or None
        Its recording, once it has ended.
    """

    process: Any
    events: list[dict[str, Any]] = field(default_factory=list)
    received: int = 0
    dropped: int = 0
    recording: Path | None = None

    def verdicts(self) -> list[dict[str, Any]]:
        """Return the verdicts on windows so far."""
        return [event["window"] for event in self.events if "window" in event]

    def alarms(self) -> list[dict[str, Any]]:
        """Return the alarms so far."""
        return [event["alarm"] for event in self.events if "alarm" in event]

    def start_s(self) -> float:
        """Return when the recording began, by the robot's clock [s]."""
        assert self.recording is not None  # noqa: S101 -- used only after its end
        facts = json.loads((self.recording / "recording.json").read_text())
        return float(facts["start_ns"]) / _SECOND_NS


@contextlib.contextmanager
def watching(domain: int, *words: str | Path) -> Iterator[Watching]:
    """Watch a domain; at the end, wait until the recording is complete."""
    process = _process("oracle", "watch", "--domain", str(domain), "--format", "json", *words)
    watch = Watching(process)
    reader = threading.Thread(target=_read, args=(process.stdout, watch.events))
    reader.start()
    try:
        process.stderr.readline()  # it has started
        yield watch
    finally:
        process.send_signal(signal.SIGINT)
        printed = process.stderr.read()
        process.wait()
        reader.join()
        for line in printed.splitlines():
            if "dropped." in line:
                watch.received, watch.dropped = int(line.split()[0]), int(line.split()[3])
            if line.startswith("Recording: "):
                watch.recording = Path(line.partition(" ")[2])


@contextlib.contextmanager
def serving(domain: int, *words: str | Path) -> Iterator[Any]:
    """Serve a patrol on a domain; its process ends with the ``with`` block at the latest."""
    process = _process("oracle-sim", "serve", "--domain", str(domain), *words)
    try:
        process.stderr.readline()  # it has started
        yield process
    finally:
        process.terminate()  # below nohup, it ignores Ctrl-C
        process.stderr.read()
        process.wait()


def switch(serve: Any, attack: str) -> float:
    """Switch an attack on, and return the time by the robot's clock [s]."""
    serve.stdin.write(f"attack {attack}\n")
    serve.stdin.flush()
    answer = serve.stderr.readline()
    if not answer.startswith("At "):
        raise RuntimeError(f"{attack} was not switched on: {answer}")
    return float(answer.split()[1])


def processor_s(process: int) -> float:
    """Return the processor time of a process and its children so far [s]."""
    total = 0.0
    for each in (process, *_children(process)):
        fields = Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split()
        total += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return total


def memory_bytes(process: int) -> int:
    """Return the memory of a process and its children."""
    return sum(
        os.sysconf("SC_PAGESIZE") * int(Path(f"/proc/{each}/statm").read_text().split()[1])
        for each in (process, *_children(process))
    )


def recorded(out: Path, runs: range, speed: float, goals: int, domain: int) -> None:
    """Let `oracle watch` record normal patrols, each in a different session."""
    for run in runs:
        patrol = "--speed", str(speed), "--run", str(run), "--goals", str(goals)
        with watching(domain, "--out", out / str(run)), serving(domain, *patrol) as serve:
            serve.wait()


def learn(recordings: Path, card: Path) -> None:
    """Learn a reference card from recordings."""
    subprocess.run(
        [_BIN / "oracle", "learn", recordings, "--output", card],
        check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip


def _process(program: str, *words: str | Path) -> Any:
    return subprocess.Popen(
        [_BIN / program, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1", "PYTHONWARNINGS": "ignore"},
    )  # fmt: skip


def _read(lines: Any, events: list[dict[str, Any]]) -> None:
    events.extend({**json.loads(line), "at": time.monotonic()} for line in lines)


def _children(process: int) -> list[int]:
    return [
        int(each) for each in Path(f"/proc/{process}/task/{process}/children").read_text().split()
    ]
