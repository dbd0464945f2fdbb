"""``oracle-sim``: record experiment runs without Dagster."""

import functools
import os
import sys
from pathlib import Path

import click

from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.experiments import record_run
from sim.fan_out import fan_out, process_pool
from sim.modes import modes
from sim.progress import RunProgress
from sim.recipes import DEFAULT_SEED, Campaign, Storage, recipe_for


@click.group()
def main() -> None:
    """Record robot experiments in the simulated TurtleBot3 testbed, as rosbag2."""


@main.command()
@click.option(
    "-m", "--mode", required=True, type=click.Choice(list(modes())), help="Which experiment."
)
@click.option(
    "-n", "--number", default=1, show_default=True, type=click.IntRange(min=1),
    help="How many runs: run000, run001, ...",
)  # fmt: skip
@click.option(
    "--seed", default=DEFAULT_SEED, show_default=True, type=click.IntRange(min=0),
    help="What all randomness comes from; the same seed gives the same messages.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False),
    default=lambda: Path(os.environ.get("ORACLE_HOME", "data")),
    help="Root of the run directories.  [default: $ORACLE_HOME or ./data]",
)  # fmt: skip
@click.option(
    "--goals", default=lambda: Campaign.from_environment().goals_per_run,
    type=click.IntRange(min=1),
    help="Goals a run; 1 is the thesis's protocol.  [default: $ORACLE_GOALS_PER_RUN or 8]",
)  # fmt: skip
@click.option(
    "--storage", default="mcap", show_default=True, type=click.Choice(["mcap", "sqlite3"]),
    help="Storage of the bag.",
)  # fmt: skip
@click.option(
    "--workers", default=lambda: os.cpu_count() or 1, type=click.IntRange(min=1),
    help="Runs at a time.  [default: one a processor]",
)  # fmt: skip
@click.option("--refresh", is_flag=True, help="Simulate again what is recorded already.")
def record(
    mode: str,
    number: int,
    seed: int,
    out: Path,
    goals: int,
    storage: Storage,
    workers: int,
    refresh: bool,
) -> None:
    """Record N runs of one mode.

    Run i of every mode has the same start, goals and nuisance (block i), so runs compare across
    modes. What is recorded already is left as it is; an interrupted call is completed by the
    next one.

    \b
    Example:
        oracle-sim record -m fake_object -n 3 --out data
        oracle features 'data/runs/fake_object/run000'
    """  # noqa: D301 -- click reads the control character
    campaign = Campaign(seed=seed, goals_per_run=goals, storage=storage)
    job = functools.partial(_record, mode, campaign, out, refresh)
    failed = 0
    with RunProgress(number) as progress:
        for outcome in fan_out(job, range(number), lambda: process_pool(min(workers, number))):
            directory = RunDirectory(out, mode, outcome.job)
            if outcome.result is None:
                failed += 1
                click.echo(f"{directory.key}: {outcome.error}", err=True)
                continue
            progress.done(outcome.result.recording_s)
            progress.say(f"{directory.path}: {_summary(outcome.result)}")
    if failed:
        click.echo(f"{failed} of {number} runs failed; call again to complete them.", err=True)
        sys.exit(1)


def _record(mode: str, campaign: Campaign, out: Path, refresh: bool, run: int) -> Manifest:
    return record_run(
        recipe_for(mode, run, campaign), RunDirectory(out, mode, run), refresh=refresh
    )


def _summary(manifest: Manifest) -> str:
    reached = sum(result.outcome == "succeeded" for result in manifest.goal_results)
    factor = manifest.recording_s / manifest.measured.wall_s
    megabytes = sum(manifest.measured.bytes.values()) / 1e6
    return (
        f"{manifest.outcome}, {reached} of {len(manifest.goals)} goals, "
        f"{manifest.recording_s:.0f} s at {factor:.0f}x real time, "
        f"{megabytes:.1f} MB ({megabytes / manifest.recording_s * 60:.1f} MB a minute)"
    )
