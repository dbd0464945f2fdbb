"""Compiles the actions of a scenario on each topic that it alters.

An action on the main topic and on a further one has the same draws on both: a message of the
further topic uses the draws of the main message before it.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from sim.fuzzing.compile_context import CompileContext, OperationNumbers
from sim.fuzzing.fields import as_sent
from sim.fuzzing.operators import compile_operators
from sim.fuzzing.program import Action, Program
from sim.fuzzing.scenario import Key
from sim.fuzzing.topics import MAIN, type_of
from sim.middleware.executor import SECOND

WITHIN_S = (
    1.0  # default of ``within_s``: by how much a main message may precede that of a further topic
)
_OF_AN_ACTION = 2**20  # numbers of operations; more than a file can have


def compile_actions(
    topic: str, context: CompileContext, numbers: Mapping[int, int]
) -> tuple[tuple[Action, ...], dict[int, int]]:
    """Return the actions on a topic, and the number of the first operation of each by its place.

    Parameters
    ----------
    topic
        ``main``, or the name of a further topic.
    context
        The context of compilation; it gathers their faults.
    numbers
        Result of this function for the main topic; empty for the main topic itself.
    """
    actions, first = [], {}
    specs = context.scenario.document.get("transform", {}).get("actions", [])
    for place, spec in enumerate(specs):
        if topic not in spec.get("on", [topic]):
            continue
        numbered = context
        if topic != MAIN:
            alone = (place + 1) * _OF_AN_ACTION  # if it does nothing on the main topic
            numbered = dataclasses.replace(
                context, numbers=OperationNumbers(numbers.get(place, alone))
            )
        first[place] = numbered.numbers.upcoming
        with context.faults.gathered():
            actions.append(_action(spec, ("transform", "actions", place), numbered))
    return tuple(actions), first


def check_names(context: CompileContext) -> None:
    """Find actions on topics that the scenario does not alter."""
    document = context.scenario.document
    known = [MAIN, *document.get("also", {})]
    for place, action in enumerate(document.get("transform", {}).get("actions", [])):
        for number, name in enumerate(action.get("on", [])):
            with context.faults.gathered():
                if name not in known:
                    raise context.scenario.error(
                        ("transform", "actions", place, "on", number),
                        f"expected one of {', '.join(known)}, found {name}",
                    )


def with_further_topics(
    program: Program, on_main: CompileContext, numbers: Mapping[int, int]
) -> Program:
    """Return a program that alters its further topics as well.

    Parameters
    ----------
    program
        That of the main topic.
    on_main
        The context in which operators on the main topic were compiled.
    numbers
        Of the actions on the main topic (`compile_actions`).
    """
    scenario, lanes = program.scenario, []
    for name, spec in scenario.document.get("also", {}).items():
        kind = type_of(scenario, spec["type"], ("also", name, "type"))
        context = dataclasses.replace(
            on_main,
            root=kind,
            outputs={**on_main.outputs, "": (spec["output"], kind)},
            scope=dataclasses.replace(on_main.scope, names={**on_main.scope.names, "msg": kind}),
        )
        actions, _ = compile_actions(name, context, numbers)
        lane = dataclasses.replace(
            program, type=kind, as_sent=as_sent(kind), input_topic=spec["input"],
            output_topic=spec["output"], further_outputs={}, always=None, actions=actions,
            period=None, timer=None, magnitude=program.magnitude if kind == program.type else None,
            memory=playback(actions), to=tuple(spec.get("to", ())),
            within_ns=round(spec.get("within_s", WITHIN_S) * SECOND),
        )  # fmt: skip
        lanes.append(lane)
    cost = program.cost + sum(action.cost for lane in lanes for action in lane.actions)
    return dataclasses.replace(program, also=tuple(lanes), cost=cost)


def playback(parts: Sequence[Action]) -> int:
    """Return the number of messages to keep for playback."""
    return max((operator.messages for part in parts for operator in part.do), default=0)


def _action(spec: Mapping[str, Any], key: Key, context: CompileContext) -> Action:
    when = context.condition(spec, key)
    inner, let = context.let(spec, key)
    return Action(spec["name"], when, let, compile_operators(spec["do"], (*key, "do"), inner))
