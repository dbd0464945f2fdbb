"""``oracle-sim``: record experiment runs without Dagster."""

import functools
import os
import sys
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, cast, get_args

import click

from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.experiments import record_run
from sim.fan_out import fan_out, process_pool
from sim.modes import modes
from sim.progress import RunProgress
from sim.recipes import DEFAULT_SEED, Campaign, Options, Storage, Wiring, recipe_for
from sim.turtlebot3.map import OdometrySource

COMMANDS = "oracle_sim.commands"  # entry points of commands that come from elsewhere


class _Group(click.Group):
    """Commands of this module, and those of other packages, loaded when they are asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*super().list_commands(ctx), *entry_points(group=COMMANDS).names})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if (ours := super().get_command(ctx, cmd_name)) is not None:
            return ours
        for found in entry_points(group=COMMANDS, name=cmd_name):
            return cast(click.Command, found.load())
        return None


@click.group(cls=_Group)
def main() -> None:
    """Record robot experiments in the simulated TurtleBot3 testbed, as rosbag2; look at them."""


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
    "--wiring", default="additive", show_default=True, type=click.Choice(get_args(Wiring)),
    help="Whether the collision monitor hears the mode's topic as one more LiDAR (additive), in "
    "place of the LiDAR it comes from (replace), or there is no such node (absent).",
)  # fmt: skip
@click.option(
    "--odometry-source", default="world", show_default=True,
    type=click.Choice(get_args(OdometrySource)),
    help="Where /odom comes from: ground truth, as on Humble, or the wheels' turns.",
)  # fmt: skip
@click.option("--cameras", is_flag=True, help="Depth camera on: 15 MB a second.")
@click.option(
    "--debug-topics", is_flag=True,
    help="Record the controller's /evaluation and /marker: 20 MB a second while it drives.",
)  # fmt: skip
@click.option(
    "--include-hidden-topics", "hidden_topics", is_flag=True,
    help="Record feedback and status of actions.",
)  # fmt: skip
@click.option(
    "--receive-stamps", is_flag=True,
    help="Bag stamps are the recorder's wall clock, as without --use-sim-time.",
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
    **options: Any,
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
    campaign = Campaign(seed=seed, goals_per_run=goals, storage=storage, options=Options(**options))
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
