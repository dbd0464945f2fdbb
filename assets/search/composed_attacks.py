"""Composed attacks: one operator on one topic, altered in place.

Each trial chooses topic, operator, field, strength, onset and duration.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import optuna
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution

from assets.search.attack_space import Attack, AttackSpace, SearchError, suggested
from sim.fuzzing.actuation import moves_something
from sim.fuzzing.value_types import Array, Message, Number, message_type

_AS_NUMBER = "amount"  # in place of the strength, for an operator that takes no expression
COMPOSED = "composed"  # the name of all composed scenarios
_ONSET_S = FloatDistribution(0.0, 15.0)  # after the goal is accepted
_LASTS_S = FloatDistribution(0.5, 60.0, log=True)
_LEFT_OUT = ("header", "covariance", "orientation")  # parts of fields that are not altered


@dataclass(frozen=True, slots=True)
class Alteration:
    """How a search uses an operator of the scenario language.

    Attributes
    ----------
    strength : str
        Name of the value that sets its strength; empty without one.
    values : distribution, optional
        Of the strength, or of its magnitude if it is signed.
    arguments : mapping
        Of the operator, as in a scenario; ``p.amount`` is the strength.
    """

    strength: str = ""
    values: BaseDistribution | None = None
    arguments: Mapping[str, Any] = field(default_factory=dict)
    has_field: bool = False
    signed: bool = False
    operator: str = ""  # if it has another name than the alteration
    when: str = ""  # condition for each message

    def suggest(self, trial: optuna.Trial) -> Any:
        """Return the strength that a trial proposes; None without one."""
        if self.values is None:
            return None
        value = suggested(trial, self.strength, self.values)
        if self.signed and trial.suggest_categorical(f"{self.strength} < 0", [False, True]):
            return -value
        return value


# Sizes are drawn on a logarithmic scale, since small sizes are the most likely to evade.
ALTERATIONS: Mapping[str, Alteration] = {
    "add": Alteration(
        "add amount", FloatDistribution(0.001, 1.0, log=True), {"by": "p.amount"},
        has_field=True, signed=True,
    ),
    "scale": Alteration(
        "scale change", FloatDistribution(0.005, 0.5, log=True), {"by": "1.0 + p.amount"},
        has_field=True, signed=True,
    ),
    "noise": Alteration(
        "noise spread", FloatDistribution(0.001, 0.5, log=True),
        {"dist": "gauss", "relative": "p.amount"}, has_field=True,
    ),
    "drift": Alteration(
        "drift rate", FloatDistribution(0.0005, 0.1, log=True), {"rate": "p.amount"},
        has_field=True, signed=True,
    ),
    "drop": Alteration(
        "drop share", FloatDistribution(0.005, 0.95, log=True), when="bernoulli(p.amount)"
    ),
    "delay": Alteration(
        "delay s", FloatDistribution(0.01, 3.0, log=True), {"seconds": "p.amount"}
    ),
    "reorder": Alteration(
        "reorder s", FloatDistribution(0.01, 3.0, log=True),
        {"seconds": "uniform(0.0, p.amount)"}, operator="delay",
    ),
    "freeze": Alteration(),
    "replay": Alteration("replay messages", IntDistribution(2, 50), {"messages": _AS_NUMBER}),
    "duplicate": Alteration(
        "duplicate copies", IntDistribution(2, 20), {"copies": "p.amount", "spacing_s": 0.01}
    ),
}  # fmt: skip


def composed_attacks(
    names: Sequence[str],
    operators: Sequence[str],
    available: Mapping[str, str],
    *,
    allow_actuation: bool = False,
) -> AttackSpace:
    """Check the requested topics and operators, and return the attacks with these.

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
    if unknown := [name for name in operators if name not in ALTERATIONS]:
        raise SearchError(f"There is no operator {unknown[0]}; there are {', '.join(ALTERATIONS)}.")
    chosen = tuple(operators) or tuple(ALTERATIONS)
    for name in names:
        if name not in available:
            raise SearchError(
                f"There is no topic {name}; there are {', '.join(sorted(available))}."
            )
        if moves_something(name, available[name]) and not allow_actuation:
            raise SearchError(f"{name} may move the robot; allow it with --allow-actuation.")
        if any(ALTERATIONS[each].has_field for each in chosen) and not _fields(available[name]):
            raise SearchError(f"{name} ({available[name]}) has no number that could be altered.")
    topics = {name: available[name] for name in names}
    text = f"{', '.join(chosen)} on {', '.join(topics)}"
    return AttackSpace(COMPOSED, text, lambda trial: _composed(trial, topics, chosen))


def _composed(trial: optuna.Trial, topics: Mapping[str, str], operators: Sequence[str]) -> Attack:
    """Return the attack that a trial proposes."""
    topic = trial.suggest_categorical("topic", list(topics))
    name = trial.suggest_categorical("operator", list(operators))
    kind, alteration = topics[topic], ALTERATIONS[name]
    values: dict[str, Any] = {"topic": topic, "operator": name}
    if alteration.has_field:
        fields = list(_fields(kind))
        values["field"] = trial.suggest_categorical(f"field of {kind}", fields)
    if (amount := alteration.suggest(trial)) is not None:
        values[alteration.strength] = amount
    onset_s = round(suggested(trial, "onset_s", _ONSET_S), 3)
    lasts_s = round(suggested(trial, "lasts_s", _LASTS_S), 3)
    values |= {"onset_s": onset_s, "lasts_s": lasts_s}
    place = values.get("field")
    document: dict[str, Any] = {
        "schema": "mutant/v1",
        "id": COMPOSED,
        "title": f"{name} on {topic}{'' if place is None else f', {place}'}"[:100],
        "label": "malicious",
        "main": {"type": kind, "input": topic, "output": topic},
        "activation": {
            "onset": {"after": "goal_accepted", "seconds": onset_s},
            "duration_s": lasts_s,
        },
        "transform": {"actions": [_action(name, alteration, place, amount)]},
    }
    if amount is not None and _AS_NUMBER not in alteration.arguments.values():
        form = "int" if isinstance(amount, int) else "float"
        document["parameters"] = {"amount": {"type": form, "default": amount}}
    return Attack(document, values)


def _action(name: str, alteration: Alteration, place: str | None, amount: Any) -> dict[str, Any]:
    """Return an alteration as an action of a scenario."""
    arguments = {
        key: amount if value == _AS_NUMBER else value for key, value in alteration.arguments.items()
    }
    where = {} if place is None else {"field": place}
    action = {"do": [{alteration.operator or name: where | arguments}]}
    return {"name": name, **({"when": alteration.when} if alteration.when else {}), **action}


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
