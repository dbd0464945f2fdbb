"""Retargets a scenario to topics other than those in its file, of the same types.

Its main topic is then altered in place: the altered message replaces the recorded one, as if the
driver that publishes it were compromised.
"""

import dataclasses
from collections.abc import Mapping

from sim.fuzzing.actuation import moves_something
from sim.fuzzing.program import Program
from sim.fuzzing.scenario import ScenarioError
from sim.fuzzing.topics import MAIN


def retargeted(
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
