"""Shared parts of tests of the nodes: a domain, a listener, and messages of sensors."""

import math

from oracle_pipeline.bags.types import message_class
from sim.atc.geodesy import slant_range, to_geodetic
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND, Executor
from sim.middleware.node import Node
from sim.middleware.stamps import header

AdsbReport = message_class("atc_msgs/msg/AdsbReport")
RadarPlot = message_class("atc_msgs/msg/RadarPlot")
SecondaryReply = message_class("atc_msgs/msg/SecondaryReply")
Track = message_class("atc_msgs/msg/Track")
TrackArray = message_class("atc_msgs/msg/TrackArray")


class Tower(Node):
    """Publishes on the inputs of a node under test, and records its outputs."""

    def __init__(self, on_advance=lambda _: None):
        super().__init__(Domain(Executor(on_advance)), "/tower")
        self._publishers = {}

    def record(self, topic, msgtype):
        """Return the list to which all messages of a topic are appended."""
        heard = []
        self.create_subscription(f"atc_msgs/msg/{msgtype}", topic, heard.append, qos.SENSOR_DATA)
        return heard

    def publish(self, topic, message):
        if topic not in self._publishers:
            self._publishers[topic] = self.create_publisher(message.__msgtype__, topic)
        self._publishers[topic].publish(message)

    def run_until(self, seconds):
        self.domain.executor.run_until(round(seconds * SECOND))

    @property
    def seconds(self):
        return self.now_ns / SECOND


def adsb(seconds, x, y, altitude_m=5_000.0, speed=0.0, track=0.0, icao24="C07AB1", who="ACA123"):
    """A report of an aircraft at x, y of the plane; near the airport its two norths agree."""
    stamp = header(round(seconds * SECOND), "wgs84")
    return AdsbReport(stamp, icao24, who, *to_geodetic(x, y), altitude_m, speed, track)


def polar(x, y, altitude_m):
    return slant_range(math.hypot(x, y), altitude_m), math.degrees(math.atan2(x, y)) % 360.0


def plot(seconds, x, y, altitude_m=5_000.0):
    return RadarPlot(header(round(seconds * SECOND), "radar"), *polar(x, y, altitude_m))


def reply(seconds, x, y, altitude_m=5_000.0, icao24="C07AB1", squawk="2001"):
    stamp = header(round(seconds * SECOND), "radar")
    return SecondaryReply(stamp, *polar(x, y, altitude_m), icao24, squawk, altitude_m)


def track(x, y, altitude_m, speed, track_deg, icao24, vertical_rate=0.0, sources=7):
    latitude, longitude = to_geodetic(x, y)
    return Track(
        1, icao24, icao24, "2001", latitude, longitude, altitude_m, speed, track_deg,
        vertical_rate, sources,
    )  # fmt: skip


def tracks(seconds, *all_tracks):
    return TrackArray(header(round(seconds * SECOND), "wgs84"), list(all_tracks))
