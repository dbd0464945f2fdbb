"""Processor time per message in each built-in scenario, and speed of the air traffic testbed.

The time of a message is the minimum over several rounds, which excludes other load on the machine.
The figure is the mean over the messages.
"""

import dataclasses
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign
from sim.experiments import recipe_for, record_run
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.execution import execute
from sim.fuzzing.program import Program
from sim.fuzzing.value_types import zero
from sim.middleware.executor import SECOND
from sim.middleware.stamps import header
from sim.scenarios import builtin_scenarios
from tools.bench.figures import Row, median, spread

MESSAGES, ROUNDS = 200, 15
RAYS = 360
PERIOD_NS = SECOND // 5
GOAL_US = 100.0
RUNS = 3
ATC_MODES = ("atc_normal", "atc_follow_closest")
ATC_GOAL = 200.0


def rows() -> Iterator[Row]:
    """Yield the figures."""
    for name, scenario in builtin_scenarios().items():
        program = compile_scenario(scenario, allow_actuation=True)
        yield Row(f"{name}: a {program.type.name}", _message_us(program), "us", GOAL_US)
    with tempfile.TemporaryDirectory() as folder:
        for mode in ATC_MODES:
            runs = [_record(Path(folder), mode, block) for block in range(RUNS)]
            factors = [run.recording_s / run.measured.wall_s for run in runs]
            yield Row(f"real-time factor of {mode}", median(factors), "x", ATC_GOAL, False,
                      spread(factors))  # fmt: skip


def _message_us(program: Program) -> float:
    """Return the processor time per message, long after the onset [us]."""
    messages = list(_messages(program))
    rounds = []
    for _ in range(ROUNDS):
        execution = execute(program, 1)
        for name, source in program.sources.items():
            execution.on_source(name, zero(source.type), 0)
        taken = []
        for number, message in enumerate(messages):
            started = time.perf_counter_ns()
            execution.on_message(message, number * PERIOD_NS, 100.0 + number * PERIOD_NS / SECOND)
            taken.append(time.perf_counter_ns() - started)
        rounds.append(taken)
    return float(np.min(rounds, axis=0).mean()) / 1e3


def _messages(program: Program) -> Iterator[Any]:
    """Yield messages of the program's type, as a recording holds them."""
    rng = np.random.default_rng(1)
    for number in range(MESSAGES):
        message = zero(program.type)
        if program.has_header:
            message = dataclasses.replace(message, header=header((number + 1) * PERIOD_NS, "there"))
        match program.type.name:
            case "sensor_msgs/msg/LaserScan":
                ranges = rng.uniform(0.2, 19.0, RAYS)
                ranges[rng.random(RAYS) < 0.2] = np.inf
                message = dataclasses.replace(
                    message,
                    angle_increment=2.0 * np.pi / RAYS,
                    range_min=0.12,
                    range_max=20.0,
                    ranges=ranges.astype(np.float32),
                )
            case "atc_msgs/msg/AdsbReport":
                aircraft = f"C07AB{number % 10}"
                message = dataclasses.replace(
                    message,
                    icao24=aircraft,
                    callsign="ACA123",
                    latitude=44.2 + 0.01 * (number % 10),
                    longitude=-76.6 + 0.001 * number,
                    altitude_m=3000.0,
                )
        yield message


def _record(root: Path, mode: str, block: int) -> Manifest:
    return record_run(recipe_for(mode, block, Campaign()), RunDirectory(root, mode, block))
