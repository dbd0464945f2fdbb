"""From which magnitude on ``oracle score`` exits 1, of each fault and attack on arm and drone.

Of each robot, a card of 29 normal runs of one seed judges runs of another: normal ones, and those
of each fault at the values of its sweep (`sim/commands/magnitudes.yaml`), in the same blocks. A
fault is found from the smallest value on from which at least nine tenths of the runs are called.
``ORACLE_BENCH_RUNS`` names a folder to keep recordings in, and ``magnitudes.csv``, of which
``docs/explanation`` has a copy.
"""

import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from oracle_pipeline import ReferenceCard, learn, score
from oracle_pipeline.scoring.output import exit_code
from sim.campaigns import Campaign
from sim.commands.kill_matrix import mutants
from sim.commands.parameter_values import BUILT_IN, sweeps_of
from sim.experiments import Job, record_job
from sim.fuzzing.compilation import compile_scenario
from sim.modes import find_mode
from sim.testbeds import TESTBEDS
from tools.bench.figures import Row

ROBOTS = ("arm", "crazyflie")  # testbeds
LEARNED, JUDGED, GOALS = 29, 10, 4  # normal runs, blocks of each value, goals of a run
CARD_SEED, SEED = 3811, 38_117
FAR, FOUND = 0.1, 0.9


class Called(NamedTuple):
    """How many of some runs have exit code 1."""

    testbed: str
    mode: str
    parameter: str  # empty for normal runs
    unit: str
    value: float
    called: int
    runs: int


def rows() -> Iterator[Row]:
    """Yield the share of normal runs that are called, and the values from which faults are."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(os.environ.get("ORACLE_BENCH_RUNS", folder))
        found: list[Called] = []
        for name in ROBOTS:
            for of_mode in _of_testbed(root / name, name):
                found += of_mode
                yield _row(of_mode)
        pd.DataFrame(found).to_csv(root / "magnitudes.csv", index=False)


def _of_testbed(root: Path, testbed: str) -> Iterator[list[Called]]:
    normal, *others = TESTBEDS[testbed].experiments
    mode = find_mode(normal)
    card = learn([_recorded(Job(mode, root / "card", n, n, {}), CARD_SEED) for n in range(LEARNED)])
    usual = [Job(mode, root / "normal", n, n, {}) for n in range(LEARNED)]
    called = sum(_is_called(job, card) for job in usual)
    yield [Called(testbed, normal, "", "", 0.0, called, LEARNED)]
    for name in others:
        if BUILT_IN.get(name):
            yield _of_mode(root / name, testbed, name, card)


def _of_mode(root: Path, testbed: str, name: str, card: ReferenceCard) -> list[Called]:
    mode = find_mode(name, allow_actuation=True)
    (sweep,) = sweeps_of(mode)
    program = compile_scenario(mode.scenario, allow_actuation=True)
    unit, counts = program.parameters[sweep.parameter].unit, dict.fromkeys(sweep.values, 0)
    for job in mutants(mode, root, [sweep], JUDGED):
        counts[job.given[sweep.parameter]] += _is_called(job, card)
    of_mode = (testbed, name, sweep.parameter, unit)
    return [Called(*of_mode, value, called, JUDGED) for value, called in counts.items()]


def _is_called(job: Job, card: ReferenceCard) -> bool:
    return exit_code(score(_recorded(job, SEED), card, far=FAR).verdicts) == 1


def _recorded(job: Job, seed: int) -> Path:
    record_job(Campaign(seed=seed, goals_per_run=GOALS), False, job)
    return job.directory.path


def _row(of_mode: Sequence[Called]) -> Row:
    first = of_mode[0]
    if not first.parameter:
        return Row(f"{first.mode}: called", first.called, f"of {first.runs}")
    least = float("inf")
    for each in reversed(of_mode):
        if each.called < FOUND * each.runs:
            break
        least = each.value
    seen = ", ".join(f"{each.value:.3g}: {each.called}" for each in of_mode)
    return Row(f"{first.mode}: found from {first.parameter}", least, first.unit, remark=f"({seen})")
