"""Small run directories, with all inputs of features."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest

from oracle_pipeline.bags.graph_files import write_gexf, write_graphml
from oracle_pipeline.bags.integrity import hashes_of_files
from oracle_pipeline.bags.manifest import Manifest, Measured, Pose, Software, TopicCount
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.types import (
    GROUND_TRUTH_TOPIC,
    GROUND_TRUTH_TYPE,
    message_class,
    serialize,
)
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.graphs.intervals import compose

START_NS = 1_700_000_000_000_000_000  # recordings of real robots begin at the time of day
DURATION_S = 27.0

_FOREIGN = os.environ.get("ORACLE_FOREIGN_BAGS")
FOREIGN_BAGS = sorted(Path(_FOREIGN).glob("*/metadata.yaml")) if _FOREIGN else []


def time_message(seconds: float) -> Any:
    return message_class("builtin_interfaces/msg/Time")(int(seconds), 0)


def header(seconds: float, frame: str) -> Any:
    return message_class("std_msgs/msg/Header")(time_message(seconds), frame)


def pose_message(x: float, y: float, yaw: float) -> Any:
    point = message_class("geometry_msgs/msg/Point")(x, y, 0.0)
    turn = message_class("geometry_msgs/msg/Quaternion")(
        0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
    )
    return message_class("geometry_msgs/msg/Pose")(point, turn)


def odometry(seconds: float, x: float, y: float, yaw: float, rate: float) -> Any:
    vector = message_class("geometry_msgs/msg/Vector3")
    twist = message_class("geometry_msgs/msg/Twist")(vector(0.2, 0, 0), vector(0, 0, rate))
    covariance = np.zeros(36)
    return message_class("nav_msgs/msg/Odometry")(
        header(seconds, "odom"), "base_footprint",
        message_class("geometry_msgs/msg/PoseWithCovariance")(pose_message(x, y, yaw), covariance),
        message_class("geometry_msgs/msg/TwistWithCovariance")(twist, covariance),
    )  # fmt: skip


def scan(seconds: float, ranges: Any) -> Any:
    return message_class("sensor_msgs/msg/LaserScan")(
        header(seconds, "base_scan"), 0.0, 6.28, 0.017, 0.0, 0.0, 0.12, 3.5,
        np.asarray(ranges, dtype=np.float32), np.zeros(0, dtype=np.float32),
    )  # fmt: skip


def plan(seconds: float, length_m: float) -> Any:
    stamped = message_class("geometry_msgs/msg/PoseStamped")
    poses = [
        stamped(header(seconds, "map"), pose_message(x, 0.0, 0.0))
        for x in np.linspace(0.0, length_m, 5)
    ]
    return message_class("nav_msgs/msg/Path")(header(seconds, "map"), poses)


def tree_log(seconds: float, *changes: tuple[str, str, str]) -> Any:
    change = message_class("nav2_msgs/msg/BehaviorTreeStatusChange")
    events = [change(time_message(seconds), *each) for each in changes]
    return message_class("nav2_msgs/msg/BehaviorTreeLog")(time_message(seconds), events)


def goal_status(seconds: float, *states: tuple[int, int]) -> Any:
    """States of goals, each (number of the goal, status)."""
    info, status = (message_class(f"action_msgs/msg/{n}") for n in ("GoalInfo", "GoalStatus"))
    uuid = message_class("unique_identifier_msgs/msg/UUID")
    goals = [
        status(info(uuid(np.full(16, goal, dtype=np.uint8)), time_message(seconds)), state)
        for goal, state in states
    ]
    return message_class("action_msgs/msg/GoalStatusArray")(goals)


def ground_truth(seconds: float) -> Any:
    return message_class(GROUND_TRUTH_TYPE)(
        time_message(seconds), "/scan_fakeobject", 0, "insert", 1.0, '{"label": "malicious"}'
    )


Recorded = tuple[float, str, Any]


def drive(nth: int = 0) -> list[Recorded]:
    """A robot that circles for 27 s, reaches one goal after 20 s and has another under way.

    Each starts elsewhere and in another direction, so that it is a block of its own.
    """
    root = "NavigateRecovery"
    recorded: list[Recorded] = [
        (2.0, "/behavior_tree_log", tree_log(2, (root, "IDLE", "RUNNING"))),
        (2.5, "/plan", plan(2, 4.0)),
        (3.5, "/plan", plan(3, 9.0)),
        (22.0, "/behavior_tree_log", tree_log(22, (root, "RUNNING", "SUCCESS"))),
        (22.0, "/behavior_tree_log", tree_log(22, (root, "SUCCESS", "IDLE"))),
        (24.0, "/behavior_tree_log", tree_log(24, ("Spin", "IDLE", "RUNNING"))),
        (24.0, "/behavior_tree_log", tree_log(24, (root, "IDLE", "RUNNING"))),
    ]
    for step in range(int(DURATION_S * 5) + 1):
        t = step / 5
        yaw = 0.4 * t + nth / 2
        x, y = 0.5 * np.sin(yaw), -0.5 * np.cos(yaw)
        recorded.append((t, "/odom", odometry(t, x, y, yaw, 0.4)))
        ranges = 1.0 + 0.5 * np.sin(np.arange(12) + step)
        recorded.append((t, "/scan", scan(t, [*ranges, np.inf, np.nan])))
        recorded.append((t, "/scan_fakeobject", scan(t, [*ranges, 2.0, 9.0])))
        recorded.append((t, GROUND_TRUTH_TOPIC, ground_truth(t)))
    return sorted(recorded, key=lambda each: each[0])


def write_bag(path: Path, recorded: list[Recorded], storage: str = "mcap") -> BagWriter:
    with BagWriter(path, storage) as bag:
        for seconds, topic, message in recorded:
            msgtype = message.__msgtype__
            bag.add_topic(topic, msgtype, [])
            bag.write(topic, START_NS + round(seconds * 1e9), serialize(message, msgtype))
    return bag


def ros_graph(*extra: tuple[str, str]) -> "nx.DiGraph[str]":
    graph: nx.DiGraph[str] = nx.DiGraph()
    edges = [
        ("node:/turtlebot3_laserscan", "topic:/scan"), ("topic:/scan", "node:/lidar_passthrough"),
        ("node:/lidar_passthrough", "topic:/scan_fakeobject"), ("topic:/scan", "node:/amcl"),
        ("topic:/scan", "node:/rosbag2_recorder"), *extra,
    ]  # fmt: skip
    for edge in edges:
        for vertex in edge:
            kind, _, name = vertex.partition(":")
            graph.add_node(vertex, label=name, kind=kind, type="T" if kind == "topic" else "")
        graph.add_edge(*edge, messages=5, bytes=50)
    return graph


def manifest_of(directory: RunDirectory, bag: BagWriter, **changes: Any) -> Manifest:
    topics = {name: TopicCount("any", count) for name, count in bag.counts.items()}
    fields: dict[str, Any] = {
        "mode": directory.mode, "label": "malicious", "run": directory.run, "block": 3,
        "session": 0, "seed": 1, "world": "hexagon-0",
        "start": Pose(0.0, 0.0, 0.0), "goals": (), "goal_results": (),
        "outcome": "timeout", "onset_s": 31.0, "attack": {"radius_m": 0.2}, "scenario": "s",
        "scenario_hash": "h", "task_effect": None, "recording_s": DURATION_S, "contacts": (),
        "topics": topics, "content_hash": bag.content_hash, "recipe": {"seed": 1},
        "software": Software("0", "0", "x86_64"), "measured": Measured(1.0, {"bag": 1}),
    }  # fmt: skip
    return Manifest(**{**fields, **changes})


@pytest.fixture
def make_run(tmp_path: Path) -> Callable[..., RunDirectory]:
    """Return a function that makes a complete run directory."""

    def make(mode: str = "fake_object", run: int = 3, storage: str = "mcap", **changes: Any):
        directory = RunDirectory(tmp_path / "data", mode, run)
        graphs = [ros_graph(), ros_graph(("node:/late", "topic:/tf")), ros_graph()]
        with directory.staged() as scratch:
            bag = write_bag(scratch / "bag", drive(), storage)
            (scratch / "graphs").mkdir()
            for number, graph in enumerate(graphs):
                write_gexf(graph, scratch / "graphs" / f"{10 * number:06d}.gexf")
            write_gexf(compose(graphs), scratch / "graphs" / "run.gexf")
            write_graphml(compose(graphs), scratch / "graphs" / "run.graphml")
            measured = Measured(1.0, {"bag": 1}, files=hashes_of_files(scratch))
            fields = {"measured": measured, **changes}
            manifest_of(directory, bag, **fields).save(scratch / "manifest.json")
        return directory

    return make


@pytest.fixture
def bag_of(tmp_path: Path) -> Callable[[list[Recorded]], Path]:
    """Return a function that writes a foreign bag of the messages given."""

    def make(recorded: list[Recorded]) -> Path:
        write_bag(tmp_path / "robot", recorded)
        return tmp_path / "robot"

    return make


@pytest.fixture(params=[*FOREIGN_BAGS, "own"], ids=lambda p: str(p)[-40:])
def foreign_bag(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Each available bag without manifest and graphs."""
    if isinstance(request.param, Path):
        return request.param.parent
    write_bag(tmp_path / "robot", drive())
    return tmp_path / "robot"


class Messages:
    """Makers of messages, for the tests."""

    odometry = staticmethod(odometry)
    scan = staticmethod(scan)
    plan = staticmethod(plan)
    tree_log = staticmethod(tree_log)
    goal_status = staticmethod(goal_status)


@pytest.fixture(scope="session")
def messages() -> type[Messages]:
    return Messages
