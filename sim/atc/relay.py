"""The node between ``/adsb`` and ``/adsb_fuzzed``: it hands reports on, or lets an attack do so."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from oracle_pipeline.bags.template import Template
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE, message_class
from sim.atc.sensors import ADSB_TYPE
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import time_message

NAME = "/adsb_relay"
INPUT_TOPIC = "/adsb"
ATTACKED_TOPIC = "/adsb_fuzzed"

_GroundTruth = message_class(GROUND_TRUTH_TYPE)


@dataclass(frozen=True, slots=True)
class Attack:
    """What is sent instead of what was heard.

    Both callables return the messages to send, and get the time since the onset [ns]; the
    messages that they are given belong to others and are not written to.
    """

    operation: str
    on_report: Callable[[Any, int], Sequence[Any]] = lambda report, _: (report,)
    on_timer: Callable[[int], Sequence[Any]] = lambda _: ()
    period_s: float | None = None  # of ``on_timer``


PASSTHROUGH = Attack("passthrough")


class AdsbRelay(Node):
    """Hand ADS-B reports on.

    Parameters
    ----------
    domain
        Where the node lives.
    attack
        What it makes of them.
    onset_ns
        When the attack begins [ns]; before that every report is handed on unchanged.
    latency_ns
        From hearing a report to having handed it on.
    shadow
        Work the attack out and hand every report on unchanged.
    """

    def __init__(
        self,
        domain: Domain,
        attack: Attack = PASSTHROUGH,
        *,
        onset_ns: int = 0,
        latency_ns: int = 0,
        shadow: bool = False,
    ) -> None:
        super().__init__(domain, NAME, latency_ns=latency_ns)
        self._attack = attack
        self._shadow = shadow
        self._onset_ns = onset_ns
        self._sent = 0
        self._templates: dict[str, Template] = {}  # of the ground truth, by its detail
        self._output = self.create_publisher(ADSB_TYPE, ATTACKED_TOPIC, qos.SENSOR_DATA)
        self._truth = self.create_publisher(GROUND_TRUTH_TYPE, GROUND_TRUTH_TOPIC, qos.DEFAULT)
        self.create_subscription(ADSB_TYPE, INPUT_TOPIC, self._on_report, qos.SENSOR_DATA)
        if attack.period_s is not None:
            period_ns = round(attack.period_s * SECOND)
            self.create_timer(period_ns, self._on_timer, phase_ns=onset_ns - self.now_ns)

    def _on_report(self, report: Any) -> None:
        since_ns = self.now_ns - self._onset_ns
        wanted = self._attack.on_report(report, since_ns) if since_ns >= 0 else (report,)
        self._send((report,), wanted)

    def _on_timer(self) -> None:
        self._send((), self._attack.on_timer(self.now_ns - self._onset_ns))

    def _send(self, heard: Sequence[Any], wanted: Sequence[Any]) -> None:
        """Send what is wanted in place of what was heard, and tell what that changed."""
        sent = heard if self._shadow else wanted
        changed = len(sent) != len(heard) or any(
            ours is not theirs for ours, theirs in zip(sent, heard, strict=True)
        )
        for message in sent:
            self._output.publish(message)
        self._tell(float(changed), f"{len(heard)} in, {len(sent)} out")
        self._sent += len(sent)

    def _tell(self, magnitude: float, detail: str) -> None:
        """Write ground truth."""
        stamp, operation = time_message(self.now_ns), self._attack.operation
        truth = _GroundTruth(stamp, ATTACKED_TOPIC, self._sent, operation, magnitude, detail)
        if detail not in self._templates:
            numbers = ("stamp.sec", "stamp.nanosec", "index", "magnitude")
            self._templates[detail] = Template(truth, GROUND_TRUTH_TYPE, numbers)
        data = self._templates[detail].data(stamp.sec, stamp.nanosec, self._sent, magnitude)
        self._truth.publish(truth, data)
