"""The testbed: a whole run against its bare physics, and where its time goes.

All on one core. A round is bare physics, then a run, one right after the other, so that what else
the machine does falls on both.
"""

import functools
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench.figures import Row, median, spread
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.writer import BagWriter
from sim import experiments
from sim.campaigns import Campaign
from sim.experiments import recipe_for
from sim.middleware.domain import Subscription
from sim.middleware.executor import SECOND, Executor
from sim.middleware.geometry import Pose2D
from sim.middleware.node import Node, Timer
from sim.turtlebot3 import run as turtlebot3_run
from sim.turtlebot3.nodes import SCAN_ANGLE_MAX, SCAN_NS, SCAN_RANGE_MAX_M, SCAN_RAYS
from sim.turtlebot3.world import World, WorldParameters

ROUNDS = 5
_SHOWN = 25  # of the shares, the largest
MODE = "lidar_passthrough_odom"
COLD_START = (
    "from sim.commands.main import main; main()",
    *("record", "-m", MODE, "--goals", "1", "--workers", "1"),
)


def rows() -> Iterator[Row]:
    """Yield the figures."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        warm_up = _record(root, 0)  # compiles, if nobody did
        runs, ratios = [], []
        for block in range(ROUNDS):
            manifest = _record(root, block, refresh=True)
            bare_s = bare_physics_s(manifest.recording_s)
            runs.append(manifest)
            ratios.append(manifest.measured.wall_s / bare_s)
        factors = [run.recording_s / run.measured.wall_s for run in runs]
        megabytes = [run.measured.bytes["bag"] / 1e6 / (run.recording_s / 60.0) for run in runs]
        intervals = [run.recording_s / 10.0 for run in runs]
        yield Row("whole run over bare physics and rays", median(ratios), "x", 10, True,
                  spread(ratios))  # fmt: skip
        yield Row("real-time factor, one core", median(factors), "x", 30, False, spread(factors))
        yield Row("bag, a simulated minute", median(megabytes), "MB", 7, True, spread(megabytes))
        yield Row("intervals of 10 s a run", median(intervals), "", 12, False, spread(intervals))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        yield Row("peak memory", peak, "MiB")
        cold = [_cold_start_s(root / f"cold{i}") for i in range(3)]
        yield Row("new process, one goal, compile cache warm", median(cold), "s", 5, True,
                  spread(cold))  # fmt: skip
        yield from _shares(root, warm_up.run)


def _record(root: Path, block: int, *, refresh: bool = False) -> Manifest:
    recipe = recipe_for(MODE, block, Campaign())
    return experiments.record_run(recipe, RunDirectory(root, MODE, block), refresh=refresh)


def bare_physics_s(seconds: float) -> float:
    """Return the wall time of physics at 5 ms and of two LiDARs at 5 Hz, with nothing around."""
    world = World(WorldParameters(Pose2D(-2.0, -0.5)))
    bearings = np.linspace(0.0, SCAN_ANGLE_MAX, SCAN_RAYS)
    started = time.perf_counter()
    for scan in range(int(seconds * SECOND / SCAN_NS)):
        world.advance_to(scan * SCAN_NS)
        for _ in range(2):
            world.scan(Pose2D(), 0.15, bearings, SCAN_RANGE_MAX_M)
    return time.perf_counter() - started


def _cold_start_s(out: Path) -> float:
    started = time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", *COLD_START, "--out", str(out)], check=True, capture_output=True
    )
    return time.perf_counter() - started


class _Shares:
    """Wall time by who spends it; what is called from within is not counted to the caller."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._running: list[tuple[str, float]] = []

    def call(self, name: str, function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        """Call ``function`` and count its time to ``name``."""
        now = time.perf_counter()
        if self._running:
            caller, since = self._running[-1]
            self.seconds[caller] += now - since
        self._running.append((name, now))
        try:
            return function(*arguments, **named)
        finally:
            now = time.perf_counter()
            name, since = self._running.pop()
            self.seconds[name] += now - since
            if self._running:
                self._running[-1] = (self._running[-1][0], now)


def _shares(root: Path, block: int) -> Iterator[Row]:
    """Yield what part of a run each node has; counting makes the run slower."""
    shares = _Shares()

    class Counting(Executor):
        def call_at(self, time_ns: int, callback: Callable[..., None], *arguments: Any) -> None:
            super().call_at(time_ns, shares.call, _owner(callback), callback, *arguments)

    patches: list[tuple[Any, str, Any]] = [(turtlebot3_run, "Executor", Counting)]
    for owner, name, method in (
        (World, "physics and rays", "advance_to"),
        (World, "physics and rays", "imu"),
        (World, "physics and rays", "scan"),
        (BagWriter, "bag writer", "write"),
    ):
        function = getattr(owner, method)
        patches.append((owner, method, _method(shares, name, function)))
    kept = [(owner, name, getattr(owner, name)) for owner, name, _ in patches]
    for owner, name, value in patches:
        setattr(owner, name, value)
    try:
        manifest = shares.call("everything else", _record, root, block, refresh=True)
    finally:
        for owner, name, value in kept:
            setattr(owner, name, value)
    total = sum(shares.seconds.values())
    for name, seconds in sorted(shares.seconds.items(), key=lambda share: -share[1])[:_SHOWN]:
        milliseconds = f"({1e3 * seconds / manifest.recording_s:.2f} ms a simulated second)"
        yield Row(f"share of {name}", 100.0 * seconds / total, "%", remark=milliseconds)


def _method(shares: _Shares, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(function)
    def counted(*arguments: Any, **named: Any) -> Any:
        return shares.call(name, function, *arguments, **named)

    return counted


def _owner(callback: Callable[..., None]) -> str:
    """Return whose callback it is."""
    if isinstance(callback, functools.partial):
        return _owner(callback.func)
    bound = getattr(callback, "__self__", None)
    if isinstance(bound, Timer):
        return _owner(bound._callback)
    if isinstance(bound, Subscription):
        return bound.node
    for holder in (bound, getattr(bound, "node", None), getattr(bound, "_node", None)):
        if isinstance(holder, Node):
            return holder.name
    return type(bound).__name__ if bound is not None else callback.__qualname__
