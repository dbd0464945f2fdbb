"""Runs many recordings from a command: common options, and the loop over runs."""

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import click

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import Manifest
from sim import campaigns
from sim.commands.progress import RunProgress, pace
from sim.fan_out import fan_out, process_pool
from sim.modes import modes

if TYPE_CHECKING:
    from sim.experiments import Job

Command = Callable[..., None]


def home() -> Path:
    """Return the default root of runs."""
    return Path(os.environ.get("ORACLE_HOME", "data"))


seed_option = click.option(
    "--seed", default=campaigns.DEFAULT_SEED, show_default=True, type=click.IntRange(min=0),
    help="Seed of all randomness; the same seed gives the same messages.")  # fmt: skip
allow_actuation_option = click.option(
    "--allow-actuation", is_flag=True, help="Allow a scenario that sends commands to motors."
)


def mode_option(default: str | None = None) -> Callable[[Command], Command]:
    """Return the option that chooses a mode, or some if none is the default; its help has all."""
    names, more = list(modes()), "" if default else " May be given more than once."
    return click.option(
        "-m", "--mode", type=click.Choice(names), metavar="MODE", default=default,
        show_default=bool(default), multiple=not default,
        help=f"Which experiment: {', '.join(names)}.{more}",
    )  # fmt: skip


number_option = click.option(
    "-n", "--number", default=1, show_default=True, type=click.IntRange(min=1),
    help="How many runs: run000, run001, ...")  # fmt: skip
out_option = click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), default=home,
    help="Root of the run directories.  [default: $ORACLE_HOME or ./data]")  # fmt: skip
workers_option = click.option(
    "--workers", default=lambda: os.cpu_count() or 1, type=click.IntRange(min=1),
    help="Number of runs at the same time.  [default: one for each core]")  # fmt: skip
refresh_option = click.option("--refresh", is_flag=True, help="Simulate existing runs again.")


def _nav2_params(
    _context: click.Context, _option: click.Parameter, words: tuple[str, ...]
) -> dict[str, float]:
    from sim.nav2.parameters import named_values

    try:
        return named_values(words)
    except campaigns.RecipeError as error:
        raise click.BadParameter(str(error)) from error


_CAMPAIGN_OPTIONS = (
    seed_option,
    click.option("--goals", default=lambda: campaigns.Campaign.from_environment().goals_per_run,
        type=click.IntRange(min=1),
        help="Goals of each run; the thesis used 1.  [default: $ORACLE_GOALS_PER_RUN or 8]"),
    click.option("--storage", default="mcap", show_default=True,
        type=click.Choice(["mcap", "sqlite3"]), help="Storage of the bag."),
    click.option("--sessions", default=lambda: campaigns.Campaign.from_environment().sessions,
        type=click.IntRange(min=1),
        help="Number of sessions (days in the laboratory) in which blocks take turns.  [default: "
        "$ORACLE_SESSIONS or a session for each block]"),
    click.option("--noise-per-run", is_flag=True,
        default=lambda: campaigns.Campaign.from_environment().noise_per_run,
        help="Draw sensor noise and latencies for each run instead of each block; an attack and "
        "its shadow control still share them.  [default: $ORACLE_NOISE_PER_RUN or no]"),
    click.option("--wiring", default="additive", show_default=True,
        type=click.Choice(get_args(campaigns.Wiring)),
        help="How the collision monitor receives the mode's topic: as one more LiDAR (additive), "
        "in place of the original LiDAR (replace), or not at all, without the node (absent)."),
    click.option("--odometry-source", default="world", show_default=True,
        type=click.Choice(get_args(campaigns.OdometrySource)),
        help="Source of /odom: ground truth, as on Humble, or the wheel encoders."),
    click.option("--arena", default=lambda: campaigns.Campaign.from_environment().options.arena,
        type=click.Choice(get_args(campaigns.ArenaChoice)),
        help="World of the runs; drawn: hexagon, house and random arenas take turns, block by "
        "block.  [default: $ORACLE_ARENA or drawn]"),
    click.option("--nav2", default=lambda: campaigns.Campaign.from_environment().options.nav2,
        type=click.Choice(get_args(campaigns.Navigation)),
        help="Settings of Nav2: tuned to the narrow gaps of the hexagon; stock, with which the "
        "collision monitor slows the robot down near walls; or drawn, which is stock in houses "
        "and tuned elsewhere.  [default: $ORACLE_NAV2 or tuned]"),
    click.option(
        "--nav2-param", "nav2_params", multiple=True, metavar="NAME=VALUE", callback=_nav2_params,
        help="A parameter of Nav2, as inflation_radius=0.7 (of both costmaps) or "
        "FollowPath.PathDist.scale=20; may be given more than once.",
    ),
    click.option("--relation", default="same", show_default=True,
        type=click.Choice(get_args(campaigns.Relation)),
        help="The task of the runs, compared with that of their blocks: the same; in a mirrored "
        "world; with start and goals in reverse order; or from a start up to 0.3 m away. `oracle "
        "kinds` expects the same behaviour in all of them."),
    click.option("--include-hidden-topics", "hidden_topics", is_flag=True,
        help="Record feedback and status of actions."),
    click.option("--receive-stamps", is_flag=True,
        help="Bag stamps are the recorder's wall clock, as without --use-sim-time."),
)  # fmt: skip


@contextmanager
def short_errors() -> Iterator[None]:
    """Show an error of this project in one line, and exit with code 1."""
    try:
        yield
    except (OracleError, OSError) as error:
        raise click.ClickException(str(error)) from error


def campaign_options(command: Command) -> Command:
    """Add the options that ``campaign`` takes to a command."""
    for option in reversed(_CAMPAIGN_OPTIONS):
        command = option(command)
    return command


def campaign(options: Mapping[str, Any]) -> campaigns.Campaign:
    """Return the campaign that the options of ``campaign_options`` describe."""
    names = {item.name for item in fields(campaigns.Options)}
    return campaigns.Campaign(
        seed=options["seed"], goals_per_run=options["goals"], storage=options["storage"],
        options=campaigns.Options(**{name: options[name] for name in names}),
        sessions=options["sessions"], session=options.get("session"),
        noise_per_run=options["noise_per_run"],
    )  # fmt: skip


def make_runs(make: "Callable[[Job], Manifest]", jobs: "Sequence[Job]", workers: int) -> None:
    """Make all runs, several at a time, and print a line on each; exit with 1 if any failed.

    Parameters
    ----------
    make
        Makes one run, or returns the manifest of an existing one; it must be picklable.
    jobs
        One for each run.
    workers
        Number of runs at the same time.
    """
    failed = 0
    with closing(RunProgress(len(jobs))) as progress:
        for outcome in fan_out(make, jobs, lambda: process_pool(min(workers, len(jobs)))):
            directory = outcome.job.directory
            if outcome.result is None:
                failed += 1
                click.echo(f"{directory.key}: {outcome.error}", err=True)
                continue
            progress.done(outcome.result.recording_s)
            progress.write_line(f"{directory.path}: {_summary(outcome.result)}")
    if failed:
        click.echo(f"{failed} of {len(jobs)} runs failed; call again to complete them.", err=True)
        sys.exit(1)


def _summary(manifest: Manifest) -> str:
    result = str(manifest.outcome)
    if manifest.goals:
        reached = sum(result.outcome == "succeeded" for result in manifest.goal_results)
        result += f", {reached} of {len(manifest.goals)} goals"
    speed = pace(manifest.recording_s, manifest.measured.wall_s)
    megabytes = sum(manifest.measured.bytes.values()) / 1e6
    return (
        f"{result}, {manifest.recording_s:.0f} s at {speed}, "
        f"{megabytes:.1f} MB ({megabytes / manifest.recording_s * 60:.1f} MB per minute)"
    )
