"""A robot that drives normally for an hour, watched all the time.

``python -m soak.watching --reference robot.card`` serves a long patrol on a DDS domain and watches
it. Nothing is dropped, the memory of the watch does not grow, and there is at most one alarm.
Without a card nothing is judged.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

DOMAIN = 230
SETTLED = 1 / 6  # of the time, after which memory must not grow
GROWTH = 1.1  # that it may
_GOAL_S = 15.0  # no goal takes less
_LOOK_S = 5.0
_BIN = Path(sys.executable).parent


def main() -> None:
    """Serve, watch, look, and exit with 1 if anything was not as it should be."""
    parser = argparse.ArgumentParser(prog="python -m soak.watching", description=main.__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--reference", type=Path)
    options = parser.parse_args()
    seconds = 60.0 * options.minutes
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "told.jsonl"
        reference = [] if options.reference is None else ["--reference", options.reference]
        with told.open("wb") as sink:
            watch = subprocess.Popen(
                [_BIN / "oracle", "watch", "--domain", str(DOMAIN), "--out", folder,
                 "--format", "json", *reference],
                stdout=sink, stderr=subprocess.PIPE, text=True,
            )  # fmt: skip
        serve = subprocess.Popen(
            [_BIN / "oracle-sim", "serve", "--domain", str(DOMAIN), "--speed", "1",
             "--goals", str(int(seconds / _GOAL_S) + 1)],
            stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        memory = []
        until = time.monotonic() + seconds
        while time.monotonic() < until and watch.poll() is None and serve.poll() is None:
            time.sleep(_LOOK_S)
            memory.append(_memory(watch.pid))
        serve.send_signal(signal.SIGINT)
        serve.wait()
        watch.send_signal(signal.SIGINT)
        said = watch.communicate()[1]
        alarms = sum("alarm" in json.loads(line) for line in told.read_text().splitlines())
    settled = memory[int(len(memory) * SETTLED) :]
    print(f"Watched {_LOOK_S * len(memory) / 60:.1f} minutes.", said.strip(), sep="\n")
    print(f"Memory: {settled[0] / 1e6:.0f} MB settled, at most {max(settled) / 1e6:.0f} MB.")
    print(f"Alarms: {alarms}.")
    is_right = " 0 dropped" in said and max(settled) <= GROWTH * settled[0] and alarms <= 1
    sys.exit(0 if is_right else 1)


def _memory(process: int) -> int:
    """Return what a process and its children hold [B]."""
    children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    page = os.sysconf("SC_PAGESIZE")
    return sum(
        page * int(Path(f"/proc/{each}/statm").read_text().split()[1])
        for each in (str(process), *children)
    )


if __name__ == "__main__":
    main()
