"""Changes of a scenario other than messages, from onset to end: parameters of nodes, and QoS.

They use what any node in the domain can do: a node's service ``set_parameters``, and a publisher
that restarts with another profile.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from rosbags.interfaces import QosDurability, QosReliability

from oracle_pipeline.bags.errors import OracleError
from sim.fuzzing.execution import Execution
from sim.fuzzing.ground_truth import GroundTruth
from sim.fuzzing.scenario import SET_PARAMETERS
from sim.middleware.domain import Domain
from sim.middleware.node_parameters import NodeParameter

OFFER_QOS = "offer_qos"  # the operation, in the ground truth
_SILENT = ("passthrough", "shadow")  # controls, which compute changes without applying them
_LOST = 1.0  # magnitude of a subscriber that no longer receives anything


class _Change(NamedTuple):
    """One change."""

    topic: str
    operation: str
    apply: Callable[[], tuple[float, str]]  # returns magnitude and description
    undo: Callable[[], None]


class SystemChanges:
    """Changes of a scenario other than messages.

    Parameters
    ----------
    domain
        Domain of the nodes.
    execution
        One run of a program.

    Raises
    ------
    ScenarioError
        There is no such node or parameter, or it cannot have that value.
    """

    def __init__(self, domain: Domain, execution: Execution) -> None:
        self._executor = domain.executor
        altered = execution.program.scenario.altered.values()
        offers = (_offer(domain, spec["input"], spec["qos"]) for spec in altered if "qos" in spec)
        self._changes = [*_parameters(domain, execution), *offers]
        if execution.program.scenario.control in _SILENT:
            self._changes.clear()
        self._are_applied = False

    def __bool__(self) -> bool:
        """Return whether there is anything to change."""
        return bool(self._changes)

    def apply(self) -> Iterator[GroundTruth]:
        """Apply all changes; yield their ground truth."""
        if self._are_applied:
            return
        self._are_applied = True
        now_ns = self._executor.now_ns
        for number, change in enumerate(self._changes):
            magnitude, text = change.apply()
            yield GroundTruth(now_ns, change.topic, number, change.operation, magnitude, text)

    def undo(self) -> None:
        """Undo all changes."""
        if self._are_applied:
            for change in reversed(self._changes):
                change.undo()
        self._are_applied = False


def _parameters(domain: Domain, execution: Execution) -> Iterator[_Change]:
    program = execution.program
    for number, wanted in enumerate(program.node_parameters):
        key: tuple[Any, ...] = (SET_PARAMETERS, number)
        nodes = sorted({node for node, _ in domain.parameters})
        if wanted.node not in nodes:
            raise program.scenario.error(
                (*key, "node"),
                f"expected a node whose parameters may be set ({', '.join(nodes) or 'none'}), "
                f"found {wanted.node}",
            )
        parameter = domain.parameters.get((wanted.node, wanted.name))
        if parameter is None:
            names = ", ".join(name for node, name in domain.parameters if node == wanted.node)
            raise program.scenario.error(
                (*key, "name"), f"expected one of {names}, found {wanted.name}"
            )
        try:
            value = parameter.checked(execution.constant(wanted.value))
        except OracleError as error:
            raise program.scenario.error((*key, "value"), str(error).removesuffix(".")) from error
        yield _setting(parameter, value)


def _setting(parameter: NodeParameter, value: float) -> _Change:
    before: list[float] = []

    def apply() -> tuple[float, str]:
        old = parameter.value
        before.append(old)
        parameter.set(value)
        return abs(value - old), f"{parameter.node} {parameter.name}: {old:g} to {value:g}"

    return _Change(
        parameter.events.topic, SET_PARAMETERS, apply, lambda: parameter.set(before.pop())
    )


def _offer(domain: Domain, topic: str, wanted: dict[str, str]) -> _Change:
    policies: dict[str, Any] = {}
    if "reliability" in wanted:
        policies["reliability"] = QosReliability[wanted["reliability"].upper()]
    if "durability" in wanted:
        policies["durability"] = QosDurability[wanted["durability"].upper()]
    before = {publisher: publisher.qos for publisher in domain.publishers(topic)}

    def apply() -> tuple[float, str]:
        lost = [
            node for publisher, qos in before.items()
            for node in publisher.offer(qos._replace(**policies))
        ]  # fmt: skip
        words = ", ".join(wanted.values())
        unheard = f"; unheard by {', '.join(sorted(set(lost)))}" if lost else ""
        return _LOST * bool(lost), f"{topic} offered as {words}{unheard}"

    def undo() -> None:
        for publisher, qos in before.items():
            publisher.offer(qos)

    return _Change(topic, OFFER_QOS, apply, undo)
