"""The conflict detection node: fused tracks in, advisories to pairs of aircraft out."""

import math
from typing import Any

import numpy as np

from oracle_pipeline.bags.types import message_class
from sim.atc.fusion import TRACKS_TYPE
from sim.atc.geodesy import convergence, to_plane
from sim.atc.tcas import CLEAR, RESOLUTION, advisories
from sim.middleware.domain import Domain
from sim.middleware.node import Node

ADVISORY_TYPE = "atc_msgs/msg/Advisory"

_Advisory = message_class(ADVISORY_TYPE)


class ConflictDetection(Node):
    """Subscribes to ``/tracks``; publishes ``/advisories``, one for each pair in conflict.

    It repeats each at every check. One more advisory reports that a conflict has ended.
    """

    def __init__(self, domain: Domain, *, latency_ns: int = 0) -> None:
        super().__init__(domain, "/conflict_detection", latency_ns=latency_ns)
        self._in_force: dict[tuple[str, str], Any] = {}  # own and intruder
        self._publisher = self.create_publisher(ADVISORY_TYPE, "/advisories")
        self.create_subscription(TRACKS_TYPE, "/tracks", self._on_tracks)

    def _on_tracks(self, message: Any) -> None:
        tracks = [track for track in message.tracks if track.icao24]
        states = np.array([_state(track) for track in tracks]).reshape(-1, 6)
        warned = {}
        for own, intruder, level, tau_s in advisories(states):
            dx, dy, dz = (states[intruder] - states[own])[:3].tolist()
            pair = tracks[own].icao24, tracks[intruder].icao24
            # Of two at the same altitude, the later in the list climbs.
            climbs = dz < 0.0 or (dz == 0.0 and own > intruder)
            sense = 0 if level != RESOLUTION else 1 if climbs else -1
            warned[pair] = _Advisory(
                message.header, level, *pair, math.hypot(dx, dy), dz, tau_s, sense
            )
        over = {
            pair: _Advisory(message.header, CLEAR, *pair, math.nan, math.nan, math.inf, 0)
            for pair in self._in_force
            if pair not in warned
        }
        self._in_force = warned
        for advisory in (*warned.values(), *over.values()):
            self._publisher.publish(advisory)


def _state(track: Any) -> tuple[float, ...]:
    """Return position and velocity of a track in the plane, columns as in `tcas.advisories`."""
    bearing = math.radians(track.track_deg) - convergence(track.latitude, track.longitude)
    vx, vy = track.ground_speed * math.sin(bearing), track.ground_speed * math.cos(bearing)
    x, y = to_plane(track.latitude, track.longitude)
    return x, y, track.altitude_m, vx, vy, track.vertical_rate
