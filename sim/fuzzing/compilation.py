"""Compiles scenarios, and checks them against the types of their messages."""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sim.fuzzing import value_types as vt
from sim.fuzzing.compile_context import CompileContext, Faults, OperationBudget, OperationNumbers
from sim.fuzzing.fields import as_sent
from sim.fuzzing.grammar import ExpressionError
from sim.fuzzing.lanes import check_names, compile_actions, playback, with_further_topics
from sim.fuzzing.operators import ON_TIMER, compile_operators
from sim.fuzzing.program import Action, Activation, Parameter, ParameterChange, Program, Source
from sim.fuzzing.scenario import (
    NO_FILE,
    SET_PARAMETERS,
    WORLD,
    Key,
    Scenario,
    ScenarioError,
    load_scenarios,
)
from sim.fuzzing.scopes import Function, Scope
from sim.fuzzing.step import ACTIVATION
from sim.fuzzing.topics import MAIN, check_topics, type_of
from sim.middleware.executor import SECOND

MAX_COST = 2**24  # elements that a scenario may compute for one message
LONGEST = 4096  # elements of an array, where the scenario sets no limit
OUTPUTS = 64  # messages published for one that came, where the scenario sets no limit

_SCALARS: Mapping[str, vt.Type] = {"float": vt.FLOAT, "int": vt.INTEGER, "bool": vt.BOOLEAN}


def compile_scenario(
    scenario: Scenario, *, allow_actuation: bool = False, budget: OperationBudget | None = None
) -> Program:
    """Check a scenario against the types of its messages, and compile it.

    Parameters
    ----------
    scenario
        A result of ``load_scenarios``.
    allow_actuation
        Whether it may publish commands to motors.
    budget
        Number of operations left for its file; by default the full budget.

    Raises
    ------
    ScenarioError
        Naming file, line, key and expected value of each fault that does not follow from another.
    """
    document = scenario.document
    main = document["main"]
    faults = Faults()
    with faults.gathered():
        kind = type_of(scenario, main["type"], ("main", "type"))
        outputs = {
            name: (spec["topic"], type_of(scenario, spec["type"], ("outputs", name, "type")))
            for name, spec in document.get("outputs", {}).items()
        }
    with faults.gathered():
        activation = _activation(scenario)
    limits = document.get("limits", {})
    parameters = _parameters(scenario, faults)
    constants = _constants(scenario, faults)
    state_types, state, lifetimes_ns = _state(scenario, faults)
    faults.end()  # later stages would only repeat them
    check_topics(scenario, faults, allow_actuation=allow_actuation)
    given: dict[str, vt.Type] = {
        "p": vt.Record("p", {name: parameter.type for name, parameter in parameters.items()}),
        "c": vt.Record("c", {name: type_ for name, (type_, _) in constants.items()}),
    }
    context = CompileContext(
        scenario, _scope(scenario, given), kind, {"": (main["output"], kind), **outputs},
        vt.Record("state", state_types), limits.get("array", LONGEST),
        OperationNumbers(ACTIVATION + 1), budget or OperationBudget(), faults,
    )  # fmt: skip
    sources = _sources(scenario, context)
    kept: dict[str, vt.Type] = {
        **given,
        "state": context.state,
        "src": vt.Record("src", {name: source.value for name, source in sources.items()}),
        "t": vt.FLOAT,
        "now": vt.FLOAT,
    }
    node_parameters = tuple(_node_parameters(scenario, context, allow_actuation=allow_actuation))
    on_timer = _rescoped(context, kept)
    on_message = _rescoped(context, {"msg": kind, **kept})
    transform = document.get("transform", {})
    always = None
    if transform.get("always"):
        do = compile_operators(transform["always"], ("transform", "always"), on_message)
        always = Action("always", None, (), do)
    check_names(on_message)
    actions, numbers = compile_actions(MAIN, on_message, {})
    timer, period = None, None
    if "timer" in transform:
        key = ("transform", "timer")
        spec = transform["timer"]
        with faults.gathered():
            period = context.term(spec["period_s"], (*key, "period_s"), vt.Number)
        do = compile_operators(spec["do"], (*key, "do"), on_timer, ON_TIMER)
        timer = Action(spec.get("name", "timer"), None, (), do)
    magnitude = None
    if "ground_truth" in document:
        text = document["ground_truth"]["magnitude"]
        scope = on_timer if timer else on_message
        with faults.gathered():
            magnitude = scope.term(text, ("ground_truth", "magnitude"), vt.Number)
    parts = [part for part in (always, *actions, timer) if part is not None]
    program = Program(
        scenario=scenario, type=kind, as_sent=as_sent(kind), input_topic=main["input"],
        output_topic=main["output"], further_outputs=dict(outputs.values()), sources=sources,
        parameters=parameters, activation=activation, cost=sum(part.cost for part in parts),
        constants={name: value for name, (_, value) in constants.items()}, state=state,
        lifetimes_ns=lifetimes_ns, always=always, actions=actions,
        first_match_only=transform.get("match", "first") == "first", period=period, timer=timer,
        magnitude=magnitude, outputs=limits.get("outputs", OUTPUTS), memory=playback(parts),
        to=tuple(main.get("to", ())), node_parameters=node_parameters,
    )  # fmt: skip
    with faults.gathered():
        program = with_further_topics(program, on_message, numbers)
    faults.end()
    if program.cost > MAX_COST:
        raise scenario.error(
            ("transform",),
            f"expected at most {MAX_COST:,} array elements computed for each message, found up to "
            f"{program.cost:,} with arrays of {context.longest}; set a smaller limits.array, or do "
            "less",
        )
    return program


def _node_parameters(
    scenario: Scenario, context: CompileContext, *, allow_actuation: bool
) -> Iterator[ParameterChange]:
    """Yield the parameters that are set at the onset; their nodes are checked at execution."""
    for number, spec in enumerate(scenario.document.get(SET_PARAMETERS, ())):
        key: Key = (SET_PARAMETERS, number)
        with context.faults.gathered():
            if not allow_actuation and spec["node"] != WORLD:
                raise scenario.error(
                    key,
                    "expected no parameter that is set: parameters decide how the robot moves; "
                    "allow it with --allow-actuation",
                )
            value = context.term(spec["value"], (*key, "value"), vt.Number)
            yield ParameterChange(spec["node"], spec["name"], value)


def _scope(scenario: Scenario, names: Mapping[str, vt.Type]) -> Scope:
    functions = {}
    key: Key = ("functions",)
    try:
        for name, function in scenario.document.get("functions", {}).items():
            key = ("functions", name)
            functions[name] = Function(tuple(function["params"]), str(function["expr"]))
        key = ("functions",)
        return Scope(names, functions)
    except ExpressionError as error:
        raise scenario.error(key, str(error).removesuffix(".")) from error


def _rescoped(context: CompileContext, names: Mapping[str, vt.Type]) -> CompileContext:
    return dataclasses.replace(context, scope=dataclasses.replace(context.scope, names=names))


def _activation(scenario: Scenario) -> Activation:
    spec = scenario.document.get("activation", {})
    rest = {key: value for key, value in spec.items() if key != "onset"}
    onset = dict(spec.get("onset", {}))
    if isinstance(seconds := onset.get("seconds"), list):
        onset["seconds"] = earliest, latest = float(seconds[0]), float(seconds[1])
        if earliest > latest:
            raise scenario.error(
                ("activation", "onset", "seconds"),
                f"expected the earliest onset before the latest, found {earliest} and {latest}",
            )
    activation = Activation(**onset, **rest)
    if "goal" in onset and activation.after != "goal_accepted":
        raise scenario.error(
            ("activation", "onset", "goal"), "expected after: goal_accepted beside the goal"
        )
    begins = activation.goal if activation.after == "goal_accepted" else 1
    if activation.until_goal is not None and activation.until_goal <= begins:
        raise scenario.error(
            ("activation", "until_goal"),
            f"expected a goal after the one at which it begins, {begins}, "
            f"found {activation.until_goal}",
        )
    return activation


def _scalar(spec: Mapping[str, Any]) -> vt.Type:
    return _SCALARS.get(spec["type"]) or vt.Text(spec.get("max_len", vt.MAX_TEXT))


def _parameters(scenario: Scenario, faults: Faults) -> dict[str, Parameter]:
    parameters = {}
    for name, spec in scenario.document.get("parameters", {}).items():
        key = ("parameters", name)
        with faults.gathered():
            _check_draw(scenario, spec, key)
        parameter = Parameter(
            name, _scalar(spec), spec["default"], spec.get("min"), spec.get("max"),
            spec.get("unit", ""),
        )  # fmt: skip
        with faults.gathered():
            default = _default(scenario, key, parameter)
            parameters[name] = dataclasses.replace(parameter, default=default)
    return parameters


def _check_draw(scenario: Scenario, spec: Mapping[str, Any], key: Key) -> None:
    """Refuse a drawn parameter without a valid range."""
    how = spec.get("draw")
    if how is None:
        return
    at = (*key, "draw")
    if spec["type"] not in ("float", "int"):
        raise scenario.error(at, f"expected a number to be drawn, found a {spec['type']}")
    if "drawn" in spec:
        raise scenario.error(at, "expected either draw or drawn: the block gives the value already")
    low, high = spec.get("min"), spec.get("max")
    if low is None or high is None or not low <= high:
        raise scenario.error(at, "expected a min and a max that is not below it")
    if how == "log" and low <= 0:
        raise scenario.error(at, f"expected a min above 0 for equal ratios, found {low}")
    if spec["type"] == "int" and math.ceil(low) > math.floor(high):
        raise scenario.error(at, f"expected a whole number from {low} to {high}, there is none")


def _default(scenario: Scenario, key: Key, parameter: Parameter) -> Any:
    try:
        return parameter.checked(parameter.default)
    except ValueError as error:
        raise scenario.error((*key, "default"), str(error)) from error


def _constants(scenario: Scenario, faults: Faults) -> dict[str, tuple[vt.Type, Any]]:
    constants: dict[str, tuple[vt.Type, Any]] = {}
    for name, value in scenario.document.get("constants", {}).items():
        match value:
            case bool():
                constants[name] = vt.BOOLEAN, value
            case int():
                constants[name] = vt.INTEGER, value
            case float():
                constants[name] = vt.FLOAT, value
            case str():
                constants[name] = vt.Text(len(value)), value
            case [*_] if all(isinstance(pair, list) for pair in value):
                corners = vt.Array(vt.Array(vt.FLOAT, 2, fixed=True), len(value), fixed=True)
                constants[name] = corners, np.array(value, np.float64)
            case _ if any(isinstance(number, list) for number in value):
                with faults.gathered():
                    raise scenario.error(("constants", name), "expected all numbers or all pairs")
            case _:
                numbers = vt.Array(vt.FLOAT, len(value), fixed=True)
                constants[name] = numbers, np.array(value, np.float64)
    return constants


def _state(
    scenario: Scenario, faults: Faults
) -> tuple[dict[str, vt.Type], dict[str, Any], dict[str, int]]:
    """Return types and initial values of the state, and the lifetimes of rows of tables."""
    types: dict[str, vt.Type] = {}
    values: dict[str, Any] = {}
    lifetimes_ns = {}
    for name, spec in scenario.document.get("state", {}).items():
        if spec["type"] == "map":
            columns = {column: _scalar({"type": kind}) for column, kind in spec["value"].items()}
            types[name], values[name] = vt.Table(vt.Record(name, columns), spec["max_size"]), {}
            if "ttl_s" in spec:
                lifetimes_ns[name] = round(spec["ttl_s"] * SECOND)
            continue
        types[name] = _scalar(spec)
        with faults.gathered():
            beginning = Parameter(name, types[name], spec["default"], None, None)
            values[name] = _default(scenario, ("state", name), beginning)
    return types, values, lifetimes_ns


def _sources(scenario: Scenario, context: CompileContext) -> dict[str, Source]:
    sources = {}
    for name, spec in scenario.document.get("sources", {}).items():
        key = ("sources", name)
        kind = type_of(scenario, spec["type"], (*key, "type"))
        names = {"msg": kind, **context.scope.names, "now": vt.FLOAT}
        _, let = _rescoped(context, names).let(spec, key)
        age = spec.get("max_age")
        sources[name] = Source(
            spec["topic"],
            kind,
            as_sent(kind),
            let,
            vt.Record(name, {key: term.type for key, term in let}) if let else kind,
            None if age is None else round(age * SECOND),
            spec.get("on_missing", "forward"),
        )
    return sources


def compile_file(path: Path, *, allow_actuation: bool = False) -> Iterator[Program]:
    """Compile the scenarios of a file one by one, as far as they are valid.

    Parameters
    ----------
    path
    allow_actuation
        Whether they may publish on topics that move something.

    Raises
    ------
    ScenarioError
        Naming the file, for any fault.
    """
    budget = OperationBudget()
    try:
        for scenario in load_scenarios(path):
            yield compile_scenario(scenario, allow_actuation=allow_actuation, budget=budget)
    except ScenarioError:
        raise
    except Exception as error:  # a defect here must not affect the user's other files
        raise ScenarioError(
            f"{path}: internal error; please report it: {type(error).__name__}: {error}"
        ) from error


def compile_document(mode: str, document: Mapping[str, Any]) -> Program:
    """Compile the scenario in a recipe; permission to move something was checked before.

    Raises
    ------
    ScenarioError
        If the language has changed since the recipe's release.
    """
    scenario = Scenario(f"recipe of {mode}", document, NO_FILE)
    return compile_scenario(scenario, allow_actuation=True)
