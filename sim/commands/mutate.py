"""``oracle-sim mutate``: a scenario over a recorded bag."""

from collections.abc import Iterable
from pathlib import Path

import click

from oracle_pipeline.bags.reader import RawMessage
from oracle_pipeline.bags.terminal import progress_bar
from sim.commands.batch import (
    allow_actuation_option,
    errors_told,
    seed_option,
)
from sim.commands.parameter_values import typed
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.offline import mutate_bag
from sim.fuzzing.retargeting import MAIN, retargeted
from sim.modes import find_mode


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
@click.option(
    "--topic", "topics", multiple=True, metavar="[NAME=]TOPIC",
    help="Alter this topic, of the scenario's type, in place. With NAME: the topic of the "
    "scenario's source NAME. May be given more than once.",
)  # fmt: skip
@allow_actuation_option
def mutate(
    bag_in: Path,
    bag_out: Path,
    scenario: str,
    at_s: float | None,
    seed: int,
    words: tuple[str, ...],
    topics: tuple[str, ...],
    allow_actuation: bool,
) -> None:
    """Apply a scenario to a recorded bag, without a simulator.

    BAG_IN is any rosbag2. BAG_OUT gets all of its topics, the scenario's output and its ground
    truth; with --topic, that topic as the scenario alters it. SCENARIO is the name of a built-in
    scenario or a file (FILE#NAME if it holds several).

    \b
    Examples:
        oracle-sim mutate data/runs/lidar_passthrough/run000/bag noisy random_noise -p level=0.02
        oracle-sim mutate my_robot_bag spoofed my_scenario.yaml --at 12.5
        oracle-sim mutate my_robot_bag noisy random_noise --topic /robot1/scan
        oracle-sim mutate my_robot_bag fooled fake_object --at 9 \\
            --topic /front/scan --topic odom=/wheel/odom
    """  # noqa: D301 -- click reads the control character
    with errors_told():
        mode = find_mode(scenario, allow_actuation=allow_actuation)
        program = compile_scenario(mode.scenario, allow_actuation=allow_actuation)
        program = retargeted(program, _by_name(topics), allow_actuation=allow_actuation)
        summary = mutate_bag(bag_in, bag_out, program, seed, at_s, typed(program, words), _bar)
    click.echo(
        f"{bag_out}: onset at {summary.onset_s:.1f} s, {summary.heard} messages of "
        f"{program.input_topic} heard, {summary.touched} touched, {summary.published} published "
        f"on {program.output_topic}"
    )


def _by_name(words: Iterable[str]) -> dict[str, str]:
    """Return topics by what the scenario hears them as."""
    pairs = [word.rpartition("=") for word in words]
    return {name or MAIN: topic for name, _, topic in pairs}


def _bar(messages: Iterable[RawMessage], total: int) -> Iterable[RawMessage]:
    """Show how many messages are done, on a terminal."""
    bar: Iterable[RawMessage] = progress_bar(messages, total=total, unit=" messages", leave=False)
    return bar
