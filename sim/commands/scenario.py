"""``oracle-sim scenario``: scenario files checked, listed and shown."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import yaml

from sim.commands.batch import allow_actuation_option, short_errors
from sim.commands.parameter_values import ranges
from sim.fuzzing.compilation import MAX_COST, compile_file
from sim.fuzzing.scenario import Scenario, ScenarioError
from sim.modes import find_mode, left_out, modes
from sim.scenarios import builtin_scenarios


@click.group("scenario")
def scenario() -> None:
    """Check, list and show scenarios, which alter messages.

    \b
    Examples:
        oracle-sim scenario list
        oracle-sim scenario show random_noise > my_attack.yaml
        oracle-sim scenario check my_attack.yaml
    """  # noqa: D301 -- click reads the control character


@scenario.command()
@click.argument(
    "files", nargs=-1, required=True, metavar="FILE...", type=click.Path(path_type=Path)
)
@allow_actuation_option
def check(files: tuple[Path, ...], allow_actuation: bool) -> None:
    """Check syntax, names, types and cost of scenario files.

    Prints the file, line, key and expected value of each fault, and exits with 1 if there is one.
    Types and expressions are checked once the structure of the file is right.
    Of a correct scenario, it prints the parameters with their ranges and units, and the computation
    for one message in the worst case, as a share of the limit: 16.8 million array elements, about a
    tenth of a second.

    \b
    Example:
        oracle-sim scenario check my_scenarios/*.yaml
    """  # noqa: D301 -- click reads the control character
    failed = False
    for file in files:
        try:
            for program in compile_file(file, allow_actuation=allow_actuation):
                click.echo(
                    f"{file}: {program.scenario.id} is correct; a message takes at most "
                    f"{program.cost / MAX_COST:.2%} of the computation that is allowed"
                )
                _tell_parameters(ranges(program.scenario.document))
        except ScenarioError as error:
            failed = True
            click.echo(error, err=True)
    if failed:
        sys.exit(1)


@scenario.command("list")
@click.option(
    "--format", "form", default="table", show_default=True, type=click.Choice(["table", "json"]),
    help="For people or for programs.")  # fmt: skip
def list_(form: str) -> None:
    """List the built-in scenarios and your own (ORACLE_SCENARIOS).

    \b
    Example:
        oracle-sim scenario list --format json
    """  # noqa: D301 -- click reads the control character
    for broken in left_out():
        click.echo(f"Left out: {broken}", err=True)
    rows = [_described(scenario) for scenario in _known().values()]
    if form == "json":
        click.echo(json.dumps(rows, indent=2))
        return
    for row in rows:
        click.echo(f"{row['id']:<28}{row['label']:<10} {row['title']}")
        click.echo(f"    {row['input']} -> {row['output']}  {row['type']}")
        _tell_parameters(row["parameters"])


def _tell_parameters(parameters: Mapping[str, str]) -> None:
    for name, what in parameters.items():
        click.echo(f"    {name} = {what}")


def _known() -> dict[str, Scenario]:
    """Return all scenarios that have a name; shadows go by that of their attack."""
    own = {mode.id: mode.scenario for mode in modes().values()}
    shadows = {scenario.as_shadow().id for scenario in builtin_scenarios().values()}
    own = {name: scenario for name, scenario in own.items() if name not in shadows}
    return {**builtin_scenarios(), **own}


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


@scenario.command()
@click.argument("name", metavar="SCENARIO")
def show(name: str) -> None:
    """Print a scenario, as a starting point for your own.

    \b
    Example:
        oracle-sim scenario show random_noise > my_scenario.yaml
    """  # noqa: D301 -- click reads the control character
    with short_errors():
        found = find_mode(name, allow_actuation=True).scenario
    click.echo(
        yaml.safe_dump(found.document, sort_keys=False, width=100, allow_unicode=True), nl=False
    )
