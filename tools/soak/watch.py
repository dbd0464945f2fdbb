"""Do to a watch what happens to one in the field, and account for every message.

``python -m tools.soak.watch`` starts `oracle watch` beside a sender that numbers its messages. It
kills the watch, stops it for 20 s, floods it, fills its disk, sets or silences ``/clock``, lets
another robot vanish, and sends it malformed RTPS packets. Each number between the first and the
last that was recorded must be in a recording, or in a time of which a recording says that it was
disturbed.
"""

import argparse
import contextlib
import itertools
import math
import multiprocessing
import random
import resource
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_names import dds_topic
from oracle_pipeline.bags.types import message_class, serialize, typestore
from oracle_pipeline.live.recovery import recover
from oracle_pipeline.opened_run import open_run
from sim.middleware.qos import CLOCK, DEFAULT
from tools.bench.side_by_side import memory_bytes

DOMAIN = 229
BEFORE_S, AFTER_S, STOPPED_S = 8.0, 6.0, 20.0  # around the event, and of a stopped watch
BEGUN = 3000  # bytes of a recording that has begun
HZ = 100.0  # of the sender
FLOOD = 50_000  # messages at once
_COLUMNS = (
    "times", "recordings", "recorded", "missing", "counted", "packets", "unsaid", "faults", "grown",
    "ended_s",
)  # fmt: skip
PACKETS = 100_000  # malformed ones
GROWTH = 1.1  # largest allowed growth of memory
_DISK = 300_000  # bytes of a file at which the disk is full
_STEP_S = 1.7e9
_SUBMESSAGES = 0x01, 0x06, 0x07, 0x08, 0x09, 0x0C, 0x0E, 0x15, 0x16  # PAD, ACKNACK, ... DATA
_TEXT, _CLOCK = "std_msgs/msg/String", "rosgraph_msgs/msg/Clock"


@dataclass
class Sender:
    """A robot in a process of its own.

    Attributes
    ----------
    process
        That process.
    burst
        How many messages it still has to send at once.
    clock_s : float
        Offset of its clock [s]; negative: it has one that does not tick; NaN: it has none.
    """

    domain: int
    clock_s: float = float("nan")
    topic: str = "/words"
    process: Any = None
    burst: "Synchronized[int]" = field(init=False)
    offset_s: "Synchronized[float]" = field(init=False)

    def start(self) -> None:
        """Begin to send."""
        context = multiprocessing.get_context("spawn")
        self.burst, self.offset_s = context.Value("q", 0), context.Value("d", self.clock_s)
        arguments = (self.domain, self.topic, self.burst, self.offset_s)
        self.process = context.Process(target=_send, args=arguments, daemon=True)
        self.process.start()


def _send(
    domain: int, topic: str, burst: "Synchronized[int]", offset_s: "Synchronized[float]"
) -> None:
    participant = dds.join(domain)
    words = dds.RawWriter(participant, dds_topic(topic), _TEXT, DEFAULT)
    has_clock = offset_s.value == offset_s.value
    clock = dds.RawWriter(participant, "rt/clock", _CLOCK, CLOCK) if has_clock else None
    text, tick, stamp = map(message_class, (_TEXT, _CLOCK, "builtin_interfaces/msg/Time"))
    tester = multiprocessing.parent_process()
    for number in itertools.count():
        if tester is None or not tester.is_alive():  # another watch would record this, too
            return
        words.write(serialize(text(str(number)), _TEXT))
        if burst.value:
            burst.value -= 1
            continue
        if clock is not None and offset_s.value >= 0.0:
            seconds = int(now_s := time.monotonic() + offset_s.value)
            now = stamp(seconds, int((now_s - seconds) * 1e9))
            clock.write(serialize(tick(now), _CLOCK))
        time.sleep(1.0 / HZ)


@dataclass
class Trial:
    """One event, and what became of the messages."""

    sender: Sender
    watch: Any
    folder: Path


def udp_ports(process: int) -> list[int]:
    """Return the UDP ports that a process listens at."""
    own = set()
    for entry in Path(f"/proc/{process}/fd").iterdir():
        with contextlib.suppress(OSError):
            own.add(str(entry.readlink()))
    lines = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return [int(f[1].split(":")[1], 16) for f in lines if f"socket:[{f[9]}]" in own]


def _nothing(_trial: Trial) -> None:
    """Let it run."""


def _kill(trial: Trial) -> None:
    """Kill the watch."""
    trial.watch.kill()


def _stop(trial: Trial) -> None:
    """Stop the watch for 20 s."""
    trial.watch.send_signal(signal.SIGSTOP)
    time.sleep(STOPPED_S)
    trial.watch.send_signal(signal.SIGCONT)


def _flood(trial: Trial) -> None:
    """Send many messages at once."""
    trial.sender.burst.value = FLOOD


def _set_clock(trial: Trial) -> None:
    """Set the clock forward by decades."""
    trial.sender.offset_s.value = _STEP_S


def _vanish(trial: Trial) -> None:
    """Kill another robot."""
    other = Sender(trial.sender.domain, topic="/other")
    other.start()
    time.sleep(BEFORE_S)
    other.process.kill()


def _malformed(trial: Trial) -> None:
    """Send malformed RTPS packets to all ports of the watch."""
    rng, ports = random.Random(0), udp_ports(trial.watch.pid)  # noqa: S311 -- no secret
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for _ in range(PACKETS):
            out.sendto(packet(rng), ("127.0.0.1", rng.choice(ports)))


def packet(rng: random.Random) -> bytes:
    """Return an RTPS packet that is wrong somewhere: its header, a submessage, or its content."""
    version, vendor, prefix = b"\2\1", b"\1\x10", rng.randbytes(12)
    data = b"RTPS" + version + vendor + prefix
    for _ in range(rng.randint(1, 4)):
        kind = rng.choice((*_SUBMESSAGES, rng.randrange(256)))
        entities = rng.choice((b"\0\1\0\xc7\0\1\0\xc2", b"\0\0\3\xc7\0\0\3\xc2", rng.randbytes(8)))
        body = b"\0\0\x10\0" + entities + rng.randbytes(rng.randint(0, 200))
        length = rng.choice((len(body), 0, rng.randrange(65536)))
        data += struct.pack("<BBH", kind, rng.randrange(256), length) + body
    flipped = bytearray(data)
    for _ in range(rng.randint(0, 3)):
        flipped[rng.randrange(len(flipped))] = rng.randrange(256)
    return bytes(flipped[: rng.randint(1, len(flipped))] if rng.random() < 0.2 else flipped)


#: Event, offset of the sender's clock, and limit of a file's size for the watch.
EVENTS: dict[str, tuple[Callable[[Trial], None], float, int]] = {
    "nothing": (_nothing, float("nan"), 0),
    "kill -9": (_kill, float("nan"), 0),
    "full disk": (_nothing, float("nan"), _DISK),
    "clock set by 54 years": (_set_clock, 0.0, 0),
    "silent clock": (_nothing, -1.0, 0),
    "flood of 50,000": (_flood, float("nan"), 0),
    "another robot vanishes": (_vanish, float("nan"), 0),
    "stopped for 20 s": (_stop, float("nan"), 0),
    "100,000 malformed packets": (_malformed, float("nan"), 0),
}


def trial(name: str, folder: Path, domain: int) -> Counter[str]:
    """Let an event happen to a watch, and return the account."""
    event, clock_s, largest = EVENTS[name]
    sender = Sender(domain, clock_s)
    sender.start()
    watch = _started(domain, folder, largest)
    each = Trial(sender, watch, folder)
    try:
        while not any(file.stat().st_size > BEGUN for file in folder.glob("*/bag/*.mcap")):
            time.sleep(0.2)
        time.sleep(BEFORE_S)
        before = memory_bytes(watch.pid)
        event(each)
        time.sleep(AFTER_S)
        grown = watch.poll() is None and memory_bytes(watch.pid) > GROWTH * before
    finally:
        sender.process.kill()
        interrupted_s = time.monotonic()
        watch.send_signal(signal.SIGINT)
        watch.communicate(timeout=600)
        ended_s = math.ceil(time.monotonic() - interrupted_s)
    return account(folder) + Counter(grown=int(grown), ended_s=ended_s)


def _started(domain: int, folder: Path, largest: int) -> Any:
    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))

    return subprocess.Popen(
        [Path(sys.executable).parent / "oracle", "watch", "--domain", str(domain), "--out", folder],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, preexec_fn=limit if largest else None,
    )  # fmt: skip


def account(folder: Path) -> Counter[str]:
    """Return what is in the recordings of a folder, and what they say that they lack."""
    told: Counter[str] = Counter()
    told["faults"] = sum(bool(each.fault) for each in recover(folder))
    last: int | None = None
    for path in sorted(folder.iterdir(), key=lambda each: each.stat().st_mtime_ns):
        with open_run(path) as run:
            before_s = 0.0
            for message in run.bag.messages(["/words"]):
                text: Any = typestore().deserialize_cdr(message.data, _TEXT)
                now_s = (message.stamp_ns - run.bag.start_ns) * 1e-9
                gap = 0 if last is None else int(text.data) - last - 1
                told["missing"] += gap
                told["unsaid"] += 0 if run.disturbances.cover(before_s, now_s) else abs(gap)
                last, before_s = int(text.data), now_s
                told["recorded"] += 1
            told["counted"] += run.disturbances.lost["/words"]
            told["packets"] += run.disturbances.packets
        told["recordings"] += 1
    return told


def main() -> None:
    """Print what became of the messages of each event, and exit with 1 if one is unaccounted."""
    parser = argparse.ArgumentParser(prog="python -m tools.soak.watch", description=main.__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--domain", type=int, default=DOMAIN)
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends watches and senders, too
    until = time.monotonic() + 60.0 * options.minutes
    print(f"| event | {' | '.join(_COLUMNS)} |\n|{' --- |' * (1 + len(_COLUMNS))}")
    totals: dict[str, Counter[str]] = {}
    for name in itertools.cycle(EVENTS):
        if time.monotonic() > until and len(totals) == len(EVENTS):
            break
        with tempfile.TemporaryDirectory() as folder:
            told = trial(name, Path(folder), options.domain)
        before = totals.get(name, Counter())
        longest_s = max(before["ended_s"], told["ended_s"])
        totals[name] = before + told + Counter(times=1)
        totals[name]["ended_s"] = longest_s
        print(_row(name, totals[name]), flush=True)
    sys.exit(any(told["unsaid"] + told["faults"] + told["grown"] for told in totals.values()))


def _row(name: str, told: Counter[str]) -> str:
    return f"| {name} | {' | '.join(f'{told[column]:,}' for column in _COLUMNS)} |"


if __name__ == "__main__":
    main()
