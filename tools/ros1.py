"""Judges a ROS 1 system of nodes by other people, with faults: ``python -m tools.ros1``.

It needs Debian's ``ros-base ros-robot-state-publisher joint-state-publisher topic-tools
libfaketime``. An arm's joints move, its states are published, relayed and throttled, and the real
``rosbag record`` records them. A card is learned from normal recordings; further normal ones and
faulty ones are scored by exit code. It prints a table.
"""

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import xmlrpc.client
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

LENGTH_S = 12.0
FAULT_S = 4.0  # of a recording, when most faults begin
_SETTLING_S = 2.0
_LONGEST_S, _STEP_S = 60.0, 0.1  # of waiting for nodes
_TOPICS = {"/chatter", "/wanted", "/joint_states", "/tf", "/copied", "/tf_slow"}
_RATE_HZ = 20
_PORT = 11413
_LINK_M, _OFF_M = 0.3, 0.05
_FAKETIME = "/usr/lib/x86_64-linux-gnu/faketime/libfaketime.so.1"
_RECORD = "/usr/lib/rosbag/record", "-a", "-x", "/rosout.*", f"--duration={LENGTH_S:g}", "-O"
_SYSTEM_PATH = "/usr/bin:/bin"  # ROS 1's scripts need the system's Python

Nodes: TypeAlias = Mapping[str, "subprocess.Popen[bytes]"]
Fault: TypeAlias = Callable[[Nodes, Path], None]


def main() -> None:
    """Record, learn, score, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m tools.ros1", description=main.__doc__)
    parser.add_argument("--good", type=int, default=20, help="recordings to learn from")
    parser.add_argument("--normal", type=int, default=8, help="further normal recordings")
    parser.add_argument("--each", type=int, default=3, help="recordings of each fault")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="ros1-") as folder:
        work, seeds = Path(folder), iter(range(10**6))
        good = [_recorded(work, "normal", next(seeds)) for _ in range(options.good)]
        card = work / "ros1.card"
        _oracle("learn", *good, "--output", card)
        print("| recordings | called anomalous | first sentence |\n| --- | --- | --- |")
        for name in FAULTS:
            count = options.normal if name == "normal" else options.each
            bags = [_recorded(work, name, next(seeds)) for _ in range(count)]
            told = [_oracle("score", bag, "--reference", card, "--format", "json") for bag in bags]
            codes = [each.returncode for each in told]
            first = json.loads(told[0].stdout)["recordings"][0]["summary"]
            print(f"| {name} | {codes.count(1)} of {count} | {first} |", flush=True)


def _oracle(*arguments: object) -> "subprocess.CompletedProcess[str]":
    command = [str(Path(sys.executable).with_name("oracle")), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode > 1:
        raise SystemExit(done.stderr or done.stdout)
    return done


def _environment(work: Path) -> dict[str, str]:
    return {
        "PATH": _SYSTEM_PATH, "HOME": str(work), "ROS_LOG_DIR": str(work / "log"),
        "ROS_MASTER_URI": f"http://127.0.0.1:{_PORT}", "ROS_IP": "127.0.0.1",
        "ROS_PACKAGE_PATH": "/usr/share", "ROS_ETC_DIR": "/etc/ros", "ROS_ROOT": "/usr/share/ros",
    }  # fmt: skip


def _started(
    work: Path, *command: str, stdin: Path | None = None, more: Mapping[str, str] | None = None
) -> "subprocess.Popen[bytes]":
    """Start a program; a file may be its standard input."""
    with Path(stdin or os.devnull).open("rb") as source:
        return subprocess.Popen(
            command, env=_environment(work) | dict(more or {}), stdin=source,
            start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip


def _ended(processes: Sequence["subprocess.Popen[bytes]"]) -> None:
    for process in processes:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _recorded(work: Path, name: str, seed: int) -> Path:
    """Record the system, normal or with a fault, under a master of its own."""
    bag = work / f"{name}_{seed:03d}.bag"
    off_m = _OFF_M if name == "a link 5 cm off" else 0.0
    (work / "arm.urdf").write_text(_urdf(_LINK_M + off_m))
    (work / "wanted.yaml").write_text("---\n".join(_wanted(np.random.default_rng(seed))))
    (work / "clock").write_text("+0")
    nodes = {"master": _started(work, "roscore", "-p", str(_PORT))}
    try:
        _awaited(lambda: _published() is not None)
        for parameter, values in (
            ("robot_description", ["-t", str(work / "arm.urdf")]),
            ("joint_state_publisher/source_list", ["[wanted]"]),
            ("joint_state_publisher/rate", [str(_RATE_HZ)]),
        ):
            _started(work, "rosparam", "set", parameter, *values).wait()
        nodes |= _nodes(work)
        _awaited(lambda: (_published() or set()) >= _TOPICS)
        time.sleep(_SETTLING_S)
        recorder = _started(work, *_RECORD, str(bag), more=_clock(work))
        _awaited(bag.with_suffix(".bag.active").exists)
        time.sleep(FAULT_S)
        FAULTS[name](nodes, work)
        recorder.wait()
    finally:
        master = nodes.pop("master")
        _ended(list(nodes.values()))
        master.terminate()  # it ends what it started
        master.wait()
    return bag


def _awaited(is_so: Callable[[], object]) -> None:
    """Wait until something is so."""
    for _ in range(round(_LONGEST_S / _STEP_S)):
        if is_so():
            return
        time.sleep(_STEP_S)
    print(_published())
    raise SystemExit(f"The nodes did not start in {_LONGEST_S:g} s; are all packages installed?")


def _published() -> set[str] | None:
    """Return the topics that have a publisher; None while there is no master."""
    with contextlib.suppress(OSError):
        master: Any = xmlrpc.client.ServerProxy(f"http://127.0.0.1:{_PORT}")
        return {topic for topic, _ in master.getPublishedTopics("/bench", "")[2]}
    return None


def _clock(work: Path) -> dict[str, str]:
    """Return the environment of a program whose clock a file sets."""
    return {
        "LD_PRELOAD": _FAKETIME, "FAKETIME_TIMESTAMP_FILE": str(work / "clock"),
        "FAKETIME_NO_CACHE": "1", "DONT_FAKE_MONOTONIC": "1",
    }  # fmt: skip


def _nodes(work: Path) -> Iterator[tuple[str, "subprocess.Popen[bytes]"]]:
    """Start the nodes."""
    of_tools, wanted = "/usr/lib/topic_tools", work / "wanted.yaml"
    pub = "rostopic", "pub", "-r", str(_RATE_HZ)
    yield "talker", _started(work, *pub, "/chatter", "std_msgs/String", "data: hello")
    yield "wanted", _started(work, *pub, "/wanted", "sensor_msgs/JointState", stdin=wanted)
    yield "joints", _started(work, "/usr/lib/joint_state_publisher/joint_state_publisher")
    yield "state", _started(work, "/usr/lib/robot_state_publisher/robot_state_publisher")
    yield "relay", _started(work, f"{of_tools}/relay", "/joint_states", "/copied")
    yield "throttle", _started(work, f"{of_tools}/throttle", "messages", "/tf", "5", "/tf_slow")


def _urdf(link_m: float) -> str:
    """Return an arm of three links."""
    links = "".join(f'<link name="link{i}"/>' for i in range(4))
    joints = "".join(
        f'<joint name="joint{i}" type="continuous"><parent link="link{i}"/>'
        f'<child link="link{i + 1}"/><origin xyz="0 0 {link_m if i == 1 else _LINK_M}"/>'
        '<axis xyz="0 1 0"/></joint>'
        for i in range(3)
    )
    return f'<robot name="arm">{links}{joints}</robot>'


def _wanted(rng: np.random.Generator) -> Iterator[str]:
    """Yield positions of the joints for longer than a recording, other ones for each."""
    size, rate_hz, phase = rng.uniform((0.3, 0.1, 0.0), (0.6, 0.3, 1.0), (3, 3)).T
    for time_s in np.arange(0.0, LENGTH_S + _LONGEST_S, 1.0 / _RATE_HZ):
        angles = size * np.sin(2.0 * np.pi * (rate_hz * time_s + phase))
        yield f"{{name: [joint0, joint1, joint2], position: {angles.round(4).tolist()}}}\n"


def _stopped_for(node: str, seconds: float, times: int = 1) -> Fault:
    """Return the fault that a node stops for some time, once or again and again."""

    def fault(nodes: Nodes, _: Path) -> None:
        for _time in range(times):
            os.killpg(nodes[node].pid, signal.SIGSTOP)
            time.sleep(seconds)
            os.killpg(nodes[node].pid, signal.SIGCONT)
            time.sleep(seconds / 2)

    return fault


def _second_publisher(_: Nodes, work: Path) -> None:
    joints = "{name: [joint0, joint1, joint2], position: [0.0, 0.0, 0.0]}"
    rate = "rostopic", "pub", "-r", str(_RATE_HZ)
    second = _started(work, *rate, "/joint_states", "sensor_msgs/JointState", joints)
    time.sleep(LENGTH_S - FAULT_S)
    _ended([second])


def _clock_step(_: Nodes, work: Path) -> None:
    """Set the recorder's clock back."""
    (work / "clock").write_text("-2")


def _nothing(_: Nodes, __: Path) -> None:
    """Leave the system as it is."""


FAULTS: Mapping[str, Fault] = {
    "normal": _nothing,
    "a killed node": lambda nodes, _: os.killpg(nodes["relay"].pid, signal.SIGKILL),
    "a stopped node": lambda nodes, _: os.killpg(nodes["throttle"].pid, signal.SIGSTOP),
    "a slow node": _stopped_for("joints", 0.3, times=16),
    "a second publisher": _second_publisher,
    "a full queue": _stopped_for("relay", 3.0),
    "a clock step": _clock_step,
    "a link 5 cm off": _nothing,  # in the parameter that nodes are started with
}


if __name__ == "__main__":
    main()
