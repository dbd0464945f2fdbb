"""``oracle-sim mutate``: a scenario over a recorded bag."""

import dataclasses
import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import click

from oracle_pipeline.bags.errors import RunDirectoryError
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import MANIFEST_FILE
from oracle_pipeline.bags.terminal import progress_bar
from sim.campaigns import DEFAULT_SEED
from sim.commands.batch import allow_actuation_option, short_errors
from sim.commands.parameter_values import typed
from sim.experiments import recipe_of
from sim.fuzzing.actuation import moves_something
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.offline import mutate_bag
from sim.fuzzing.program import Program
from sim.fuzzing.scenario import NO_FILE, Scenario, ScenarioError
from sim.fuzzing.topics import MAIN
from sim.modes import find_mode


@click.command("mutate")
@click.argument("bag_in", type=click.Path(path_type=Path))
@click.argument("bag_out", type=click.Path(path_type=Path))
@click.argument("scenario", metavar="[SCENARIO]", required=False)
@click.option(
    "--like", metavar="RUN", type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Repeat the attack of a recorded run: its scenario (unless SCENARIO is another), its "
    "parameters, seed, onset and end.")  # fmt: skip
@click.option(
    "--at", "at_s", type=click.FloatRange(min=0), metavar="SECONDS",
    help="Onset in seconds of the recording.  [default: what the scenario says]")  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(min=0),
    help=f"Seed of all randomness.  [default: that of --like, or {DEFAULT_SEED}]")  # fmt: skip
@click.option(
    "-p", "--parameter", "words", multiple=True, metavar="NAME=VALUE",
    help="A parameter's value in place of its default; may be given more than once.")  # fmt: skip
@click.option(
    "--topic", "topics", multiple=True, metavar="[NAME=]TOPIC",
    help="Alter this topic, of the scenario's type, in place. With NAME: the topic of the "
    "scenario's source NAME. May be given more than once.")  # fmt: skip
@allow_actuation_option
def mutate(
    bag_in: Path, bag_out: Path, scenario: str | None, like: Path | None, at_s: float | None,
    seed: int | None, words: tuple[str, ...], topics: tuple[str, ...], allow_actuation: bool,
) -> None:  # fmt: skip
    """Apply a scenario to a recorded bag, without a simulator.

    BAG_IN is any rosbag2; a ROS 1 bag must be converted first. BAG_OUT gets all of its topics that
    are encoded as CDR, the scenario's output and its ground truth; with --topic, that topic as the
    scenario alters it. SCENARIO is the name of a built-in scenario or a file (FILE#NAME if it holds
    several); with --like it is that of the recorded run.

    \b
    Examples:
        oracle-sim mutate data/runs/lidar_passthrough/run000/bag noisy random_noise -p level=0.02
        oracle-sim mutate my_robot_bag spoofed my_scenario.yaml --at 12.5
        oracle-sim mutate my_robot_bag spoofed --like data/runs/fake_object/run000
        oracle-sim mutate my_robot_bag noisy random_noise --topic /robot1/scan
        oracle-sim mutate my_robot_bag fooled fake_object --at 9 \\
            --topic /front/scan --topic odom=/wheel/odom
    """  # noqa: D301 -- click reads the control character
    with short_errors():
        attack = _Attack() if like is None else _Attack.of(like)
        chosen = attack.scenario
        if scenario is not None:
            chosen = find_mode(scenario, allow_actuation=allow_actuation).scenario
        if chosen is None:
            raise click.UsageError("Give a SCENARIO or --like RUN.")
        program = compile_scenario(chosen, allow_actuation=allow_actuation)
        program = _retargeted(program, _by_name(topics), allow_actuation=allow_actuation)
        known = {name: v for name, v in attack.parameters.items() if name in program.parameters}
        summary = mutate_bag(
            bag_in, bag_out, program, attack.seed if seed is None else seed,
            attack.onset_s if at_s is None else at_s, {**known, **typed(program, words)},
            functools.partial(progress_bar, unit=" messages", leave=False), attack.goals_s,
        )  # fmt: skip
    for note in summary.notes:
        click.echo(note, err=True)
    click.echo(
        f"{bag_out}: attack from {summary.onset_s:.1f} s on; of {summary.received} messages of "
        f"{program.input_topic}, {summary.touched} affected; {summary.published} published on "
        f"{program.output_topic}"
    )


def _by_name(words: Iterable[str]) -> dict[str, str]:
    """Return topics by the name of the source in the scenario."""
    pairs = [word.rpartition("=") for word in words]
    return {name or MAIN: topic for name, _, topic in pairs}


def _retargeted(
    program: Program, topics: Mapping[str, str], *, allow_actuation: bool = False
) -> Program:
    """Return a program that reads other topics, and alters the main one in place.

    Parameters
    ----------
    program : Program
        The program to retarget.
    topics : mapping of str to str
        Topics by their name in the scenario: `MAIN`, or the name of a source.
    allow_actuation : bool
        Also alter topics that may move a robot.

    Raises
    ------
    ScenarioError
        There is no such source, or the main topic may move a robot.
    """
    identifier = program.scenario.id
    if unknown := sorted(topics.keys() - {MAIN, *program.sources}):
        raise ScenarioError(
            f"{identifier} does not subscribe to {', '.join(unknown)}; it subscribes to "
            f"{', '.join([MAIN, *program.sources])}."
        )
    main = topics.get(MAIN)
    if main is not None:
        if moves_something(main, program.type.name) and not allow_actuation:
            raise ScenarioError(
                f"{identifier} would alter {main}, which may move the robot; allow it with "
                "--allow-actuation."
            )
        program = dataclasses.replace(program, input_topic=main, output_topic=main)
    sources = {
        name: dataclasses.replace(source, topic=topics.get(name, source.topic))
        for name, source in program.sources.items()
    }
    return dataclasses.replace(program, sources=sources)


@dataclass(frozen=True, slots=True)
class _Attack:
    """The parts of a recorded run from which its attack is repeated."""

    scenario: Scenario | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    seed: int = DEFAULT_SEED
    onset_s: float | None = None
    goals_s: tuple[float, ...] | None = None

    @classmethod
    def of(cls, run: Path) -> Self:
        """Return the attack of a run directory.

        Raises
        ------
        OracleError
            If there is no manifest, it holds no recipe, or the attack never began.
        """
        manifest = Manifest.load(run / MANIFEST_FILE)
        recipe = recipe_of(manifest)
        if manifest.onset_s is None:
            raise RunDirectoryError(
                f"In {run}, {manifest.scenario} never began, so there is no attack to repeat; "
                "name another run, or a SCENARIO and --at."
            )
        document = manifest.recipe["scenario"]
        return cls(
            Scenario(f"recipe of {manifest.key}", document, NO_FILE),
            recipe.parameters,
            recipe.attack_seed(),
            manifest.onset_s,
            tuple(result.accepted_s for result in manifest.goal_results),
        )
