"""The attacks of trials: a scenario with varied parameters, or one operator on one topic.

In both cases a proposal is a complete scenario with the proposed values as defaults. So it can be
recorded, mutated and shared like any other scenario.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import optuna

from assets.search.space import Dimension, SearchError
from sim.fuzzing.actuation import moves_something
from sim.fuzzing.value_types import Array, Message, Number, message_type
from sim.testbed import Mode

COMPOSED = "composed"  # the name of a search without a template
_ONSET = Dimension("onset_s", 0.0, 15.0, "float")  # after the goal is accepted
_LASTS = Dimension("lasts_s", 0.5, 60.0, "float")
_LEFT_OUT = ("header", "covariance", "orientation")  # parts of fields that are not altered


@dataclass(frozen=True, slots=True)
class Attack:
    """The proposal of a trial.

    Attributes
    ----------
    document : mapping
        A scenario with the values as defaults.
    values : mapping of str to number or text
        The proposed values, by name.
    """

    document: Mapping[str, Any]
    values: Mapping[str, Any]


class Template(Protocol):
    """The search space of a search."""

    @property
    def id(self) -> str:
        """Name of its scenarios."""

    @property
    def conditions(self) -> Mapping[str, Any]:
        """Changes to the testbed."""

    @property
    def text(self) -> str:
        """A description of the search space."""

    def suggest(self, trial: optuna.Trial) -> Attack:
        """Return the proposal of a trial."""


@dataclass(frozen=True, slots=True)
class ScenarioTemplate:
    """A scenario whose parameters vary."""

    mode: Mode
    space: tuple[Dimension, ...]

    @property
    def id(self) -> str:
        """Name of the scenario."""
        return self.mode.id

    @property
    def conditions(self) -> Mapping[str, Any]:
        """Changes to the testbed."""
        return self.mode.conditions

    @property
    def text(self) -> str:
        """A description of the search space."""
        return ", ".join(f"{each.name} {each.low:g} to {each.high:g}" for each in self.space)

    def suggest(self, trial: optuna.Trial) -> Attack:
        """Return the scenario with the values of a trial."""
        values = {dimension.name: dimension.suggest(trial) for dimension in self.space}
        document = self.mode.scenario.document
        parameters = {
            name: _fixed(spec, values[name]) if name in values else spec
            for name, spec in document["parameters"].items()
        }
        return Attack({**document, "parameters": parameters}, values)


def _fixed(spec: Mapping[str, Any], value: Any) -> dict[str, Any]:
    """Return a parameter with a fixed value instead of a drawn one."""
    kept = {key: what for key, what in spec.items() if key not in ("drawn", "draw")}
    return {**kept, "default": value}


@dataclass(frozen=True, slots=True)
class Operator:
    """An operator of the scenario language, and the parameters that set its strength."""

    amount: Dimension | None
    has_field: bool = False

    def action(self, name: str, field: str | None, amount: Any) -> dict[str, Any]:
        """Return the operator as an action of a scenario."""
        place = {} if field is None else {"field": field}
        match name:
            case "noise":
                return {"do": [{name: {**place, "dist": "gauss", "relative": "p.amount"}}]}
            case "drift":
                return {"do": [{name: {**place, "rate": "p.amount"}}]}
            case "drop":
                return {"when": "bernoulli(p.amount)", "do": [{name: {}}]}
            case "delay":
                return {"do": [{name: {"seconds": "p.amount"}}]}
            case "reorder":
                return {"do": [{"delay": {"seconds": "uniform(0.0, p.amount)"}}]}
            case "duplicate":
                return {"do": [{name: {"copies": "p.amount", "spacing_s": 0.01}}]}
            case "replay":
                return {"do": [{name: {"messages": amount}}]}
            case "freeze":
                return {"do": [{name: {}}]}
            case "scale":
                return {"do": [{name: {**place, "by": "1.0 + p.amount"}}]}
            case _:
                return {"do": [{name: {**place, "by": "p.amount"}}]}


# Sizes are drawn on a logarithmic scale, since small sizes are the most likely to evade.
OPERATORS: Mapping[str, Operator] = {
    "add": Operator(Dimension("add amount", 0.001, 1.0, "signed"), has_field=True),
    "scale": Operator(Dimension("scale change", 0.005, 0.5, "signed"), has_field=True),
    "noise": Operator(Dimension("noise spread", 0.001, 0.5, "float"), has_field=True),
    "drift": Operator(Dimension("drift rate", 0.0005, 0.1, "signed"), has_field=True),
    "drop": Operator(Dimension("drop share", 0.005, 0.95, "float")),
    "delay": Operator(Dimension("delay s", 0.01, 3.0, "float")),
    "reorder": Operator(Dimension("reorder s", 0.01, 3.0, "float")),
    "freeze": Operator(None),
    "replay": Operator(Dimension("replay messages", 2, 50, "int")),
    "duplicate": Operator(Dimension("duplicate copies", 2, 20, "int")),
}


@dataclass(frozen=True, slots=True)
class ComposedTemplate:
    """One operator on one topic, altered in place; trials choose both, strength and times.

    Parameters
    ----------
    topics : mapping of str to str
        Topic -> type.
    operators : tuple of str
        Of `OPERATORS`.
    """

    topics: Mapping[str, str]
    operators: tuple[str, ...]

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        operators: Sequence[str],
        available: Mapping[str, str],
        *,
        allow_actuation: bool = False,
    ) -> "ComposedTemplate":
        """Check the requested topics and operators, and return the template.

        Parameters
        ----------
        names, operators : sequence of str
            Topics, and operators. Without operators, all of them.
        available : mapping of str to str
            The topics that exist, and their types.
        allow_actuation : bool
            Whether topics that move something may be altered.

        Raises
        ------
        SearchError
            A topic does not exist, may move something, or has no number to alter, or an operator
            does not exist.
        """
        if unknown := [name for name in operators if name not in OPERATORS]:
            raise SearchError(
                f"There is no operator {unknown[0]}; there are {', '.join(OPERATORS)}."
            )
        chosen = tuple(operators) or tuple(OPERATORS)
        needs_field = any(OPERATORS[name].has_field for name in chosen)
        topics = {}
        for name in names:
            if name not in available:
                raise SearchError(
                    f"There is no topic {name}; there are {', '.join(sorted(available))}."
                )
            if moves_something(name, available[name]) and not allow_actuation:
                raise SearchError(f"{name} may move the robot; allow it with --allow-actuation.")
            if needs_field and not _fields(available[name]):
                raise SearchError(
                    f"{name} ({available[name]}) has no number that could be altered."
                )
            topics[name] = available[name]
        return cls(topics, chosen)

    @property
    def id(self) -> str:
        """Name of its scenarios."""
        return COMPOSED

    @property
    def conditions(self) -> Mapping[str, Any]:
        """No changes to the testbed."""
        return {}

    @property
    def text(self) -> str:
        """A description of the search space."""
        return f"{', '.join(self.operators)} on {', '.join(self.topics)}"

    def suggest(self, trial: optuna.Trial) -> Attack:
        """Return the scenario that a trial proposes."""
        topic = trial.suggest_categorical("topic", list(self.topics))
        name = trial.suggest_categorical("operator", list(self.operators))
        kind, operator = self.topics[topic], OPERATORS[name]
        values: dict[str, Any] = {"topic": topic, "operator": name}
        field, amount = None, None
        if operator.has_field:
            field = trial.suggest_categorical(f"field of {kind}", list(_fields(kind)))
            values["field"] = field
        if operator.amount is not None:
            amount = operator.amount.suggest(trial)
            values[operator.amount.name] = amount
        onset, lasts = round(_ONSET.suggest(trial), 3), round(_LASTS.suggest(trial), 3)
        values |= {_ONSET.name: onset, _LASTS.name: lasts}
        document: dict[str, Any] = {
            "schema": "mutant/v1",
            "id": self.id,
            "title": f"{name} on {topic}{'' if field is None else f', {field}'}"[:100],
            "label": "malicious",
            "main": {"type": kind, "input": topic, "output": topic},
            "activation": {
                "onset": {"after": "goal_accepted", "seconds": onset},
                "duration_s": lasts,
            },
            "transform": {"actions": [{"name": name, **operator.action(name, field, amount)}]},
        }
        if operator.amount is not None and name != "replay":
            form = "int" if operator.amount.kind == "int" else "float"
            document["parameters"] = {"amount": {"type": form, "default": amount}}
        return Attack(document, values)


def _fields(msgtype: str) -> tuple[str, ...]:
    """Return the paths of floating-point fields in a message, and of arrays of these."""
    return tuple(_walk(message_type(msgtype), ""))


def _walk(kind: Message, place: str) -> Iterator[str]:
    for name, inner in kind.fields.items():
        path = f"{place}{name}"
        if name in _LEFT_OUT:
            continue
        if isinstance(inner, Message):
            yield from _walk(inner, f"{path}.")
        elif isinstance(inner, Array) and not inner.fixed:
            if isinstance(inner.element, Number) and not inner.element.is_integer:
                yield path
        elif isinstance(inner, Number) and not inner.is_integer:
            yield path
