"""The controller's display: a label for each track, and the tracks that need attention."""

import math
from typing import Any

from oracle_pipeline.bags.types import message_class
from sim.atc.conflict_detection import ADVISORY_TYPE
from sim.atc.fusion import ADSB, TRACKS_TYPE
from sim.atc.tcas import CLEAR, RESOLUTION, TRAFFIC
from sim.middleware.domain import Domain
from sim.middleware.node import Node

DISPLAY_TYPE = "atc_msgs/msg/DisplayState"

_DisplayState = message_class(DISPLAY_TYPE)

_FLIGHT_LEVEL_M = 30.48
_TEN_KNOTS = 5.1444


class ControllerDisplay(Node):
    """Subscribes to ``/tracks`` and ``/advisories``; publishes ``/display_state``."""

    def __init__(self, domain: Domain, *, latency_ns: int = 0) -> None:
        super().__init__(domain, "/controller_display", latency_ns=latency_ns)
        self._in_force: dict[tuple[str, str], int] = {}  # level by own and intruder
        self._publisher = self.create_publisher(DISPLAY_TYPE, "/display_state")
        self.create_subscription(TRACKS_TYPE, "/tracks", self._on_tracks)
        self.create_subscription(ADVISORY_TYPE, "/advisories", self._on_advisory)

    def _on_advisory(self, advisory: Any) -> None:
        pair = advisory.icao24, advisory.intruder
        self._in_force.pop(pair, None)
        if advisory.level != CLEAR:
            self._in_force[pair] = advisory.level

    def _on_tracks(self, message: Any) -> None:
        sources = [track.sources for track in message.tracks]
        levels = list(self._in_force.values())
        self._publisher.publish(
            _DisplayState(
                message.header,
                [label(track) for track in message.tracks],
                sources.count(ADSB),
                sum(not source & ADSB for source in sources),
                levels.count(TRAFFIC),
                levels.count(RESOLUTION),
            )
        )


def label(track: Any) -> str:
    """Return a track's data block: callsign, flight level, ground speed in tens of knots.

    >>> label(track)
    'ACA123 180 41'
    """
    name = track.callsign or track.icao24 or "------"
    level = "---" if math.isnan(track.altitude_m) else f"{track.altitude_m / _FLIGHT_LEVEL_M:03.0f}"
    return f"{name} {level} {track.ground_speed / _TEN_KNOTS:02.0f}"
