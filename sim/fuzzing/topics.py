"""The topics of a scenario: their types, and those that must not be published on."""

from collections.abc import Mapping
from typing import Any

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC
from sim.fuzzing.actuation import moves_something
from sim.fuzzing.compile_context import Faults
from sim.fuzzing.scenario import Key, Scenario
from sim.fuzzing.value_types import Message, message_type

MAIN = "main"  # the name of the main topic beside those of ``also``
_IN_PLACE_ONLY = {
    "to": "receivers can be chosen only for a topic that is altered in place",
    "qos": "what a publisher offers can be changed only without a node in between",
}


def type_of(scenario: Scenario, name: str, key: Key) -> Message:
    """Return a message type.

    Raises
    ------
    ScenarioError
        If there is no such type.
    """
    try:
        return message_type(name)
    except BagError as error:
        raise scenario.error(key, str(error).removesuffix(".")) from error


def check_topics(scenario: Scenario, faults: Faults, *, allow_actuation: bool) -> None:
    """Find topics that the scenario may not publish on, or cannot distinguish from others."""
    document = scenario.document
    lanes = scenario.altered
    sources = {spec["topic"] for spec in document.get("sources", {}).values()}
    spoken = [((*key, "output"), spec["output"], spec["type"]) for key, spec in lanes.items()]
    for name, spec in document.get("outputs", {}).items():
        spoken.append((("outputs", name, "topic"), spec["topic"], spec["type"]))
    topics = [topic for _, topic, _ in spoken]
    _check_altered(scenario, lanes, faults)
    inputs = sources | {spec["input"] for spec in lanes.values()}
    in_place = {(*key, "output"): s["input"] for key, s in lanes.items() if _is_in_place(s)}
    for place, (at, topic, kind) in enumerate(spoken):
        with faults.gathered():
            if topic in sources or (topic in inputs and topic != in_place.get(at)):
                raise scenario.error(
                    at, f"expected a topic to which the scenario does not subscribe, found {topic}"
                )
            if topic in topics[:place]:
                raise scenario.error(at, f"expected another topic: {topic} is named above already")
            if moves_something(topic, kind) and not allow_actuation:
                raise scenario.error(
                    at,
                    f"expected a topic that moves nothing, found {topic}: {kind} there may "
                    "move the robot; allow it with --allow-actuation",
                )
    with faults.gathered():
        if GROUND_TRUTH_TOPIC in inputs | set(topics):
            raise scenario.error((MAIN,), f"expected no use of {GROUND_TRUTH_TOPIC}")


def _check_altered(
    scenario: Scenario, lanes: Mapping[Key, Mapping[str, Any]], faults: Faults
) -> None:
    """Find topics that are altered twice, or in place beside others that are not."""
    main, inputs = lanes[MAIN,], list[str]()
    for key, spec in lanes.items():
        with faults.gathered():
            if key == ("also", MAIN):
                raise scenario.error(key, "expected another name: main is the main topic")
            if spec["input"] in inputs:
                raise scenario.error(
                    (*key, "input"), f"expected a different topic, found {spec['input']} again"
                )
            if _is_in_place(spec) != _is_in_place(main):
                raise scenario.error(
                    (*key, "output"), "expected all topics to be altered in place, or none"
                )
            for name, why in _IN_PLACE_ONLY.items():
                if name in spec and not _is_in_place(spec):
                    raise scenario.error(
                        (*key, name), f"expected the output to be the input, {spec['input']}: {why}"
                    )
        inputs.append(spec["input"])


def _is_in_place(spec: Mapping[str, Any]) -> bool:
    return bool(spec["input"] == spec["output"])
