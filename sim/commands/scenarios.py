"""``oracle-sim mutate``, ``scenario``, ``fuzz`` and ``grid``: the scenario language at work."""

import functools
import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import yaml
from tqdm import tqdm

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.reader import RawMessage
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign
from sim.commands.batch import (
    allow_actuation_option,
    campaign,
    campaign_options,
    home,
    make_runs,
    refresh_option,
    seed_option,
    workers_option,
)
from sim.commands.mutants import Cell, derive_mutant, grid, record_mutant, write_index
from sim.commands.parameter_grids import draw, ranges, sweep, typed
from sim.experiments import recipe_for, record_run
from sim.fuzzing.offline import mutate_bag
from sim.fuzzing.program import compile_scenario
from sim.fuzzing.scenario import Scenario, ScenarioError, load_scenarios
from sim.modes import broken_scenarios, find_mode, modes
from sim.scenarios import builtin_scenarios
from sim.seeds import node_generator
from sim.testbed import Mode

_PARAMETERS = 16  # branch of the seed on which parameters are drawn; recipes have those before

_SCENARIO = "NAME of a built-in scenario or mode, or FILE, or FILE#NAME if it holds several."


@contextmanager
def _errors_told() -> Iterator[None]:
    try:
        yield
    except (OracleError, OSError) as error:
        raise click.ClickException(str(error)) from error


@click.command("mutate")
@click.argument("bag_in", type=click.Path(path_type=Path))
@click.argument("bag_out", type=click.Path(path_type=Path))
@click.argument("scenario", metavar="SCENARIO")
@click.option(
    "--at", "at_s", type=click.FloatRange(min=0), metavar="SECONDS",
    help="Onset in seconds of the recording.  [default: what the scenario says]",
)  # fmt: skip
@seed_option
@click.option(
    "-p", "--parameter", "words", multiple=True, metavar="NAME=VALUE",
    help="A parameter's value in place of its default; may be given more than once.",
)  # fmt: skip
@allow_actuation_option
def mutate(
    bag_in: Path,
    bag_out: Path,
    scenario: str,
    at_s: float | None,
    seed: int,
    words: tuple[str, ...],
    allow_actuation: bool,
) -> None:
    """Do to a recorded bag what a scenario would have done, without a simulator.

    BAG_IN is any rosbag2, whoever recorded it; BAG_OUT gets all of its topics, the scenario's
    output and its ground truth. SCENARIO is the name of a built-in scenario or a file (FILE#NAME
    if that holds several).

    \b
    Examples:
        oracle-sim mutate data/runs/lidar_passthrough/run000/bag noisy random_noise -p level=0.02
        oracle-sim mutate my_robot_bag spoofed my_scenario.yaml --at 12.5
    """  # noqa: D301 -- click reads the control character
    with _errors_told():
        mode = find_mode(scenario, allow_actuation=allow_actuation)
        program = compile_scenario(mode.scenario, allow_actuation=allow_actuation)
        summary = mutate_bag(bag_in, bag_out, program, seed, at_s, typed(program, words), _bar)
    click.echo(
        f"{bag_out}: onset at {summary.onset_s:.1f} s, {summary.heard} messages of "
        f"{program.input_topic} heard, {summary.touched} touched, {summary.published} published "
        f"on {program.output_topic}"
    )


def _bar(messages: Iterable[RawMessage], total: int) -> Iterable[RawMessage]:
    """Show how many messages are done, on a terminal."""
    bar: Iterable[RawMessage] = tqdm(
        messages, total=total, unit=" messages", disable=None, dynamic_ncols=True, leave=False
    )
    return bar


@click.group("scenario")
def scenarios() -> None:
    """Check, list and show scenarios: what is done to the messages of a topic.

    \b
    Example:
        oracle-sim scenario list
        oracle-sim scenario show random_noise > my_attack.yaml
        oracle-sim scenario check my_attack.yaml
    """  # noqa: D301 -- click reads the control character


@scenarios.command()
@click.argument(
    "files", nargs=-1, required=True, metavar="FILE...", type=click.Path(path_type=Path)
)
@allow_actuation_option
def check(files: tuple[Path, ...], allow_actuation: bool) -> None:
    """Check scenario files: syntax, names, types, and how much they compute.

    Tells file, line, key and what was expected there, and exits with 1 if anything is wrong.

    \b
    Example:
        oracle-sim scenario check my_scenarios/*.yaml
    """  # noqa: D301 -- click reads the control character
    failed = False
    for file in files:
        for found in _checked(file, allow_actuation=allow_actuation):
            failed |= isinstance(found, ScenarioError)
            click.echo(found, err=isinstance(found, ScenarioError))
    if failed:
        sys.exit(1)


def _checked(file: Path, *, allow_actuation: bool) -> Iterator[str | ScenarioError]:
    """Yield a line about each scenario of a file, or what is wrong with it."""
    try:
        found = load_scenarios(file)
    except ScenarioError as error:
        yield error
        return
    for scenario in found:
        try:
            program = compile_scenario(scenario, allow_actuation=allow_actuation)
        except ScenarioError as error:
            yield error
        else:
            yield f"{file}: {scenario.id} is right; it computes {program.cost} numbers a message"


@scenarios.command("list")
@click.option(
    "--format", "form", default="table", show_default=True, type=click.Choice(["table", "json"]),
    help="For people or for programs.",
)  # fmt: skip
def list_(form: str) -> None:
    """List the built-in scenarios, and those of the folder ORACLE_SCENARIOS.

    \b
    Example:
        oracle-sim scenario list --format json
    """  # noqa: D301 -- click reads the control character
    for broken in broken_scenarios():
        click.echo(f"Left out: {broken}", err=True)
    rows = [_described(scenario) for scenario in _known().values()]
    if form == "json":
        click.echo(json.dumps(rows, indent=2))
        return
    for row in rows:
        click.echo(f"{row['id']:<28}{row['label']:<10} {row['title']}")
        click.echo(f"    {row['input']} -> {row['output']}  {row['type']}")
        for name, what in row["parameters"].items():
            click.echo(f"    {name} = {what}")


def _known() -> dict[str, Scenario]:
    """Return all scenarios that have a name; shadows go by that of their attack."""
    own = {mode.id: mode.scenario for mode in modes().values()}
    shadows = {scenario.as_shadow().id for scenario in builtin_scenarios().values()}
    return {
        **builtin_scenarios(),
        **{name: scenario for name, scenario in own.items() if name not in shadows},
    }


def _described(scenario: Scenario) -> dict[str, Any]:
    main = scenario.document["main"]
    return {
        "id": scenario.id,
        "title": scenario.title,
        "label": scenario.label,
        "type": main["type"],
        "input": main["input"],
        "output": main["output"],
        "parameters": ranges(scenario.document),
        "is_mode": scenario.id in modes(),
    }


@scenarios.command()
@click.argument("scenario", metavar="SCENARIO")
def show(scenario: str) -> None:
    """Print a scenario, as a file to begin one's own with.

    \b
    Example:
        oracle-sim scenario show random_noise > my_scenario.yaml
    """  # noqa: D301 -- click reads the control character
    with _errors_told():
        found = find_mode(scenario, allow_actuation=True).scenario
    click.echo(
        yaml.safe_dump(found.document, sort_keys=False, width=100, allow_unicode=True), nl=False
    )


@click.command()
@click.option("--scenario-template", "scenario", required=True, metavar="SCENARIO", help=_SCENARIO)
@click.option(
    "-n", "--number", default=1, show_default=True, type=click.IntRange(min=1),
    help="How many runs: run000, run001, ...",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), default=home,
    help="Root of the run directories.  [default: $ORACLE_HOME or ./data]",
)  # fmt: skip
@allow_actuation_option
@campaign_options
@workers_option
@refresh_option
def fuzz(
    scenario: str,
    number: int,
    out: Path,
    allow_actuation: bool,
    workers: int,
    refresh: bool,
    **options: Any,
) -> None:
    """Record N runs of a scenario whose parameters are drawn anew for each.

    Every number with a min and a max is drawn uniformly between them; what was drawn is in the
    run's manifest. Run i has start, goals and nuisance of block i. What is recorded already is
    left as it is.

    \b
    Example:
        oracle-sim fuzz --scenario-template my_scenario.yaml -n 20 --seed 1
    """  # noqa: D301 -- click reads the control character
    with _errors_told():
        mode = find_mode(scenario, allow_actuation=allow_actuation)
        draw(mode, node_generator(0, _PARAMETERS, 0, mode.id))  # is there anything to draw?
    job = functools.partial(_record_drawn, mode, campaign(options), out, refresh)
    make_runs(job, range(number), functools.partial(RunDirectory, out, mode.id), workers)


def _record_drawn(mode: Mode, settings: Campaign, out: Path, refresh: bool, run: int) -> Manifest:
    drawn = draw(mode, node_generator(settings.seed, _PARAMETERS, run, mode.id))
    recipe = recipe_for(mode, run, settings, drawn)
    return record_run(recipe, RunDirectory(out, mode.id, run), refresh=refresh)


@click.command("grid")
@click.argument("scenario", metavar="SCENARIO")
@click.option(
    "--over", "texts", required=True, multiple=True, metavar="NAME=LOW:HIGH:COUNT[:log]",
    help="A parameter and the values it takes, equal steps or (:log) equal ratios apart. Given "
    "more than once, each parameter is swept by itself.",
)  # fmt: skip
@click.option(
    "--blocks", default=5, show_default=True, type=click.IntRange(min=1),
    help="How many blocks; each has all values.",
)  # fmt: skip
@click.option(
    "--on", "controls", metavar="RUNS_DIR",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Mutate the bags of these runs (run000 is block 0) in place of recording: what the "
    "topics would have shown if the robot had done the same. Recording options count for nothing "
    "then.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False),
    help="Root of the run directories and place of grid.json.  [default: grids/SCENARIO below "
    "$ORACLE_HOME or ./data]",
)  # fmt: skip
@allow_actuation_option
@campaign_options
@workers_option
@refresh_option
def grid_(
    scenario: str,
    texts: tuple[str, ...],
    blocks: int,
    controls: Path | None,
    out: Path | None,
    allow_actuation: bool,
    workers: int,
    refresh: bool,
    **options: Any,
) -> None:
    """Make the runs of a kill matrix: a scenario at several magnitudes, over several blocks.

    Runs are recorded in closed loop, or with --on made from recorded ones. grid.json says of each
    which value it has and how many messages were changed; none means that the mutant is equivalent
    to the original.

    \b
    Examples:
        oracle-sim grid random_noise --over level=0.005:0.2:8:log --blocks 5
        oracle-sim grid random_noise --over level=0.005:0.2:8:log --on data/runs/lidar_passthrough
    """  # noqa: D301 -- click reads the control character
    with _errors_told():
        mode = find_mode(scenario, allow_actuation=allow_actuation)
        cells = grid([sweep(mode, text) for text in texts], blocks)
    root = out or home() / "grids" / mode.id
    make: Callable[[Cell], Manifest]
    if controls is None:
        make = functools.partial(record_mutant, mode, campaign(options), root, refresh)
    else:
        make = functools.partial(derive_mutant, mode, controls, root, refresh)
    try:
        make_runs(make, cells, lambda cell: RunDirectory(root, mode.id, cell.run), workers)
    finally:
        index = write_index(root, mode, cells)
    click.echo(f"{index}: {len(cells)} mutants")
