"""A DDS domain as a source of messages."""

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_discovery import DdsDiscovery
from oracle_pipeline.live.dds_intake import DdsIntake
from oracle_pipeline.live.intake import QUEUE_BYTES
from oracle_pipeline.live.source import Source
from oracle_pipeline.live.trigger_service import TriggerService


class Domain(Source):
    """Joins a domain, and only reads; its only writer there is that of a service.

    Parameters
    ----------
    number : int
        Of the domain.
    queue_bytes : int
        As for `Intake`.
    service : str
        Name of a `TriggerService`; empty for none.
    """

    def __init__(self, number: int, queue_bytes: int = QUEUE_BYTES, service: str = "") -> None:
        self._participant = dds.join(number)
        self._service = TriggerService(self._participant, service) if service else None
        intake = DdsIntake(self._participant, queue_bytes)
        super().__init__({"domain": number}, DdsDiscovery(self._participant), intake)

    def calls(self) -> int:
        """Answer the calls of the service since the last time, and return their number."""
        return self._service.calls() if self._service is not None else 0

    def close(self) -> None:
        """Stop receiving, and leave the domain."""
        self.intake.close()
        dds.leave(self._participant)
