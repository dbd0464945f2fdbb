"""Events of a watch during a short drive: messages, a graph, verdicts, an alarm, a note."""

from collections.abc import Iterator

from oracle_pipeline.bags.types import serialize
from oracle_pipeline.live.events import (
    ContractAlarm,
    Event,
    GraphTaken,
    MessageReceived,
    Note,
    WindowAlarm,
    WindowVerdict,
)
from oracle_pipeline.scoring.contract import Breach
from oracle_pipeline.scoring.verdict import Evidence
from oracle_pipeline.windows import HOP_S, WINDOW_S
from tests.oracle_pipeline.features.conftest import START_NS, drive, ros_graph

HOSTILE = '/<img src=x onerror="document.title=1">\x1b[2J'  # as a topic may be called
EVIDENCE = Evidence("redundancy.<b>scan</b>", 12.5, False, 0.7, "m", 0.0, 0.1, "/scan", 10.0)


def messages() -> Iterator[MessageReceived]:
    for seconds, topic, message in drive():
        kind = message.__msgtype__
        stamp_ns = START_NS + round(seconds * 1e9)
        yield MessageReceived(topic, kind, stamp_ns, serialize(message, kind))


def verdict(number: int, *, alarm: bool = False) -> WindowVerdict:
    start_s = HOP_S * number
    evidence = (EVIDENCE,) if alarm else ()
    score, p = (9.0, 0.01) if alarm else (0.1 * number, 0.6)
    return WindowVerdict(
        start_s=start_s, end_s=start_s + WINDOW_S, score=score, p_value=p, is_usual=not alarm,
        alarm=alarm, evidence=evidence, alarm_score=4.0,
    )  # fmt: skip


def contract_alarm() -> ContractAlarm:
    return ContractAlarm(26.0, (Breach(HOSTILE, f"Topic {HOSTILE} is new."),))


def graph() -> GraphTaken:
    return GraphTaken(0, ros_graph(("node:/spy", f"topic:{HOSTILE}")))


def events() -> Iterator[Event]:
    """Yield what happens in the order in which it does."""
    yield from messages()
    yield graph()
    for number in range(3):
        yield verdict(number)
    last = verdict(3, alarm=True)
    yield last
    yield WindowAlarm(last)
    yield Note("3 messages were dropped: they came too fast (/scan 3).")
