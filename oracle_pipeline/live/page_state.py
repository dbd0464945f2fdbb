"""The state that a live page shows: the newest messages and verdicts, in bounded memory.

The watch adds events, and a page requests the changes since the last ones. So a slow page does
not slow the watch.
"""

import math
import threading
from collections import deque
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.reader import Topic
from oracle_pipeline.bags.terminal import printable
from oracle_pipeline.bags.types import typestore
from oracle_pipeline.live import events
from oracle_pipeline.robots.robot import names_of_robots
from oracle_pipeline.scoring.output import HEADINGS, cells

MOST = {"verdicts": 720, "alarms": 50, "notes": 50}  # an hour of windows
MOST_POSES = 2000  # of the path; beyond that, every other one is dropped
MOST_RAYS = 720  # of a scan
MOST_SCANS = 4  # topics of scans
EVERY_NS = 200_000_000  # of the recording, between two scans or poses that are decoded
_SCAN, _ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"

Part = dict[str, Any] | list[Any]


class PageState:
    """The current state of a watch; the watch's thread writes, a server's threads read."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._changes = 0
        self._changed: dict[str, int] = {}  # number of the newest change of each part
        self._start_ns: int | None = None
        self._received = 0
        self._now_s = 0.0
        self._graph: Part = {"start_s": None, "nodes": [], "edges": []}
        self._newest = {part: deque[Part | str](maxlen=most) for part, most in MOST.items()}
        self._scans: dict[str, Part] = {}
        self._path: list[list[float]] = []  # x [m], y [m], yaw [rad]
        self._odometry = ""  # the topic that gives the path
        self._topics: dict[str, Topic] = {}  # of scans and odometry
        self._decoded_ns: dict[str, int] = {}  # by topic, stamp of the newest decoded message

    def update(self, event: events.Event) -> None:
        """Update the state with an event."""
        with self._lock:
            if isinstance(event, events.MessageReceived):
                self._message(event)
            elif isinstance(event, events.GraphTaken):
                self._graph = _graph(event)
                self._change("graph")
            elif isinstance(event, events.WindowVerdict):
                self._append("verdicts", _verdict(event))
            elif isinstance(event, events.WindowAlarm | events.ContractAlarm):
                self._append("alarms", _alarm(event))
            elif isinstance(event, events.Note):
                self._append("notes", printable(event.text))

    def since(self, change: int) -> tuple[int, dict[str, Part]]:
        """Return the number of the newest change, and all parts that changed after `change`."""
        with self._lock:
            if change >= self._changes:
                return self._changes, {}
            parts: dict[str, Part] = {
                "status": {"received": self._received, "now_s": self._now_s},
                "graph": self._graph,
                **{part: list(newest) for part, newest in self._newest.items()},
                "scans": self._own_scans(),
                "path": list(self._path),
            }
            return self._changes, {
                name: part for name, part in parts.items() if self._changed.get(name, 0) > change
            }

    def _own_scans(self) -> dict[str, Part]:
        """Return the scans of the robot that is drawn; there may be others."""
        robots = [names for _, _, names in names_of_robots(self._topics)]
        own = next((names for names in robots if self._odometry in names), self._topics)
        return {name: self._scans[name] for name in map(printable, own) if name in self._scans}

    def _append(self, part: str, what: Part | str) -> None:
        self._newest[part].append(what)
        self._change(part)

    def _change(self, part: str) -> None:
        self._changes += 1
        self._changed[part] = self._changes

    def _message(self, event: events.MessageReceived) -> None:
        if self._start_ns is None:
            self._start_ns = event.stamp_ns
        self._received += 1
        self._now_s = (event.stamp_ns - self._start_ns) * 1e-9
        if event.stamp_ns - self._decoded_ns.get("", -EVERY_NS) >= EVERY_NS:
            self._decoded_ns[""] = event.stamp_ns
            self._change("status")
        if event.msgtype not in (_SCAN, _ODOMETRY):
            return
        self._topics.setdefault(event.topic, Topic(event.topic, event.msgtype, 0, ()))
        if event.stamp_ns - self._decoded_ns.get(event.topic, -EVERY_NS) < EVERY_NS:
            return
        self._decoded_ns[event.topic] = event.stamp_ns
        message = typestore().deserialize_cdr(event.data, event.msgtype)
        if event.msgtype == _SCAN:
            topic = printable(event.topic)
            if topic in self._scans or len(self._scans) < MOST_SCANS:
                self._scans[topic] = points(message)
                self._change("scans")
        elif self._odometry in ("", event.topic):
            self._odometry = event.topic
            self._add(_pose(message))

    def _add(self, pose: list[float]) -> None:
        if not all(map(math.isfinite, pose)):
            return
        self._path.append(pose)
        if len(self._path) > MOST_POSES:
            self._path = self._path[::2]
        self._change("path")


def points(scan: Any) -> list[list[float]]:
    """Return the end points of the rays that hit something, in the sensor's frame [m]."""
    ranges: NDArray[np.float64] = np.asarray(scan.ranges, dtype=np.float64)
    step = max(1, math.ceil(len(ranges) / MOST_RAYS))
    bearings = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    hit = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
    hit[np.arange(len(ranges)) % step != 0] = False
    ends = ranges[hit, None] * np.stack([np.cos(bearings[hit]), np.sin(bearings[hit])], axis=1)
    return [[float(x), float(y)] for x, y in ends.round(3)]


def _pose(odometry: Any) -> list[float]:
    """Return x, y [m] and yaw [rad], to a millimetre."""
    position, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
    sine = 2.0 * (turn.w * turn.z + turn.x * turn.y)
    cosine = 1.0 - 2.0 * (turn.y * turn.y + turn.z * turn.z)
    return [round(float(v), 3) for v in (position.x, position.y, math.atan2(sine, cosine))]


def _graph(event: events.GraphTaken) -> Part:
    graph = event.graph
    number = {vertex: number for number, vertex in enumerate(sorted(graph))}
    return {
        "start_s": event.start_s,
        "nodes": [
            {"id": n, **{key: printable(graph.nodes[v][key]) for key in ("label", "kind", "type")}}
            for v, n in number.items()
        ],
        "edges": [
            {"source": number[u], "target": number[v], "messages": data["messages"]}
            for u, v, data in graph.edges(data=True)
        ],
    }


def _verdict(event: events.WindowVerdict) -> Part:
    return {
        "end_s": event.end_s,
        "score": event.score if event.judged and math.isfinite(event.score) else None,
        "p_value": event.p_value,
        "usual": event.is_usual,
        "alarm": event.alarm,
        "timed": event.timed,
        "robot": printable(event.robot),
        "alarm_score": event.alarm_score,
    }


def _alarm(event: events.WindowAlarm | events.ContractAlarm) -> Part:
    if isinstance(event, events.ContractAlarm):
        return {
            "end_s": event.at_s,
            "p_value": None,
            "headings": ["what normal recordings do not show"],
            "evidence": [[printable(breach.text)] for breach in event.breaches],
        }
    verdict = event.verdict
    return {
        **{k: v for k, v in asdict(verdict).items() if k in ("start_s", "end_s", "p_value")},
        "robot": printable(verdict.robot),
        "headings": list(HEADINGS),
        "evidence": [[printable(cell) for cell in cells(each)] for each in verdict.evidence],
    }
