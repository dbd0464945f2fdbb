"""Roles of topics: the meaning of a robot's topic, independent of its name.

Topics of a role are found by message type. If several have the type, the usual name decides, then
the frames in their messages, then the alphabet, which is reported as ambiguous. A roles file takes
precedence.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Final

from rosbags.interfaces import QosDurability

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.reader import BagReader, Topic
from oracle_pipeline.robots.first_messages import TRANSFORM_TYPES, FirstMessages

SCAN, ODOMETRY, IMU, JOINTS, COMMAND = "scan", "odometry", "imu", "joints", "command"
REQUESTED_COMMAND, POSE, MAP, LOCAL_COSTMAP = "requested_command", "pose", "map", "local_costmap"
PLAN, GOAL_STATUS, BEHAVIOR_TREE = "plan", "goal_status", "behavior_tree"
TRANSFORMS, STATIC_TRANSFORMS = "transforms", "static_transforms"

LASER_SCAN: Final = "sensor_msgs/msg/LaserScan"
POINT_CLOUD: Final = "sensor_msgs/msg/PointCloud2"

_TWISTS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
_MEASURED_TWISTS = (  # what a robot measured or estimated is no command
    "*gps*", "*local_position*", "*global_position*", "*wind*", "*odom*", "*estimat*", "*measured*",
)  # fmt: skip


class RolesError(OracleError):
    """A roles file cannot be read, or does not fit the recording."""


@dataclass(frozen=True, slots=True)
class Role:
    """A possible role of topics, and how these are found.

    Attributes
    ----------
    types : tuple of str
        Message types. If no topic has the first, the next is used.
    several : bool
        Whether a robot may have many topics of the role.
    usual : tuple of str
        Globs of usual names, the most common first.
    never : tuple of str
        Globs of names that never have the role.
    only_usual : bool
        Whether a topic must have a usual name, because its type is too general.
    accepts : callable
        A further condition for topics.
    """

    types: tuple[str, ...]
    several: bool = False
    usual: tuple[str, ...] = ()
    never: tuple[str, ...] = ()
    only_usual: bool = False
    accepts: Callable[[Topic], bool] = lambda _topic: True


def is_static(topic: Topic) -> bool:
    """Return whether transforms are static, by the topic's name or because they are latched."""
    latched = {profile.durability for profile in topic.qos} == {QosDurability.TRANSIENT_LOCAL}
    return "static" in topic.name or latched


#: All roles, in the order of the output.
ROLES: Final[Mapping[str, Role]] = {
    SCAN: Role((LASER_SCAN, POINT_CLOUD), several=True),
    ODOMETRY: Role(("nav_msgs/msg/Odometry",), usual=("/odom", "*/odom")),
    IMU: Role(("sensor_msgs/msg/Imu",), several=True),
    JOINTS: Role(("sensor_msgs/msg/JointState",), several=True),
    COMMAND: Role(
        _TWISTS, usual=("/cmd_vel", "*/cmd_vel"),
        never=("*/cmd_vel_raw", "*/cmd_vel_smoothed", *_MEASURED_TWISTS),
    ),
    REQUESTED_COMMAND: Role(
        _TWISTS, usual=("*/cmd_vel_raw", "*/cmd_vel_smoothed"), only_usual=True
    ),
    POSE: Role(
        ("geometry_msgs/msg/PoseWithCovarianceStamped",), usual=("/amcl_pose", "*/amcl_pose"),
        never=("*initialpose*", "*initial_pose*"),
    ),
    MAP: Role(
        ("nav_msgs/msg/OccupancyGrid",), usual=("/map", "*/map"), never=("*costmap*",),
    ),
    LOCAL_COSTMAP: Role(
        ("nav_msgs/msg/OccupancyGrid",), usual=("*/local_costmap/costmap",), never=("*global*",),
        only_usual=True,
    ),
    PLAN: Role(
        ("nav_msgs/msg/Path",), usual=("/plan", "*/plan"), never=("*local*", "*transformed*"),
    ),
    GOAL_STATUS: Role(
        ("action_msgs/msg/GoalStatusArray",), usual=("*/navigate_to_pose/_action/status",),
        only_usual=True,
    ),
    BEHAVIOR_TREE: Role(("nav2_msgs/msg/BehaviorTreeLog",)),
    TRANSFORMS: Role(TRANSFORM_TYPES, several=True, accepts=lambda topic: not is_static(topic)),
    STATIC_TRANSFORMS: Role(TRANSFORM_TYPES, several=True, accepts=is_static),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Found:
    """The topics of one role, and why they were chosen.

    Attributes
    ----------
    topics : tuple of str
        Empty if there is none.
    reason : str
        Why they were chosen, as text.
    others : tuple of str
        Other candidates; the choice is ambiguous if there are any.
    """

    topics: tuple[str, ...]
    reason: str
    others: tuple[str, ...] = ()

    def ambiguity(self, role: str) -> str:
        """Return a sentence on other candidates for the role; empty without any."""
        if not self.others:
            return ""
        return (
            f"{self.topics[0]} is used as {role} ({self.reason}, then by name), but "
            f"{', '.join(self.others)} would fit too; a roles file can select another."
        )


@dataclass(frozen=True, slots=True)
class Roles:
    """The roles of the topics of one robot.

    Attributes
    ----------
    found : mapping of str to Found
        By name of the role, for all of `ROLES`.
    notes : tuple of str
        Topics of the roles file that the recording lacks.
    """

    found: Mapping[str, Found] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def ambiguities(self) -> list[str]:
        """Return a sentence for each ambiguous role."""
        return [text for role, found in self.found.items() if (text := found.ambiguity(role))]

    def has(self, role: str, topic: str) -> bool:
        """Return whether a topic has a role."""
        return role in self.found and topic in self.found[role].topics


def find_roles(bag: BagReader, chosen: Mapping[str, tuple[str, ...]] | None = None) -> Roles:
    """Return the roles of the topics of one robot.

    Parameters
    ----------
    bag : BagReader
        The robot's topics; a few first messages are read if names and types are ambiguous.
    chosen : mapping of str to tuple of str, optional
        Topics by role, from a roles file.

    Raises
    ------
    RolesError
        The roles file has a topic whose type does not fit its role.
    """
    chosen = chosen or {}
    first = FirstMessages(bag)
    found: dict[str, Found] = {}
    notes: list[str] = []
    for name, role in ROLES.items():
        if name in chosen:
            found[name], absent = _named(name, role, chosen[name], bag)
            notes += absent
        else:
            found[name] = _searched(name, role, bag, first, found)
    return Roles(found, tuple(notes))


def _named(
    name: str, role: Role, topics: tuple[str, ...], bag: BagReader
) -> tuple[Found, list[str]]:
    """Return the topics that a roles file assigns to a role, and notes on missing ones."""
    shown = {recorded: topic for topic in bag.topics for recorded in (topic, bag.recorded(topic))}
    present = tuple(dict.fromkeys(shown[topic] for topic in topics if topic in shown))
    for topic in present:
        if (msgtype := bag.topics[topic].msgtype) not in role.types:
            raise RolesError(
                f"The roles file names {topic} as {name}, but its type is {msgtype}, not "
                f"{' or '.join(role.types)}. Use another topic."
            )
    absent = [
        f"The roles file names {topic} as {name}, but it is not recorded."
        for topic in topics
        if topic not in shown
    ]
    reason = "by the roles file" if present else "no topic of the roles file is recorded"
    return Found(present, reason), absent


def _searched(
    name: str, role: Role, bag: BagReader, first: FirstMessages, found: Mapping[str, Found]
) -> Found:
    topics = _candidates(role, bag)
    if not topics:
        return Found((), f"no topic of type {' or '.join(role.types)}")
    if role.several:
        return Found(tuple(sorted(topics)), "by message type")
    for glob in role.usual:
        if usual := [topic for topic in topics if fnmatchcase(topic, glob)]:
            return _one(usual, "by its usual name")
    if name == LOCAL_COSTMAP:  # a rolling grid is in the odometry frame
        topics = [t for t in topics if first.frame(t) in first.frames_of(found[ODOMETRY].topics)]
        if topics:
            return _one(topics, "by message type and frame")
    if role.only_usual:
        usual_names = " or ".join(role.usual)
        return Found((), f"only by name: no topic is called {usual_names}")
    if len(topics) == 1:
        return Found((topics[0],), "by message type")
    by_frame = _in_fitting_frames(name, topics, first, found)
    if len(by_frame) < len(topics):
        return _one(by_frame, "by message type and frame")
    return _one(topics, "by message type")


def _candidates(role: Role, bag: BagReader) -> list[str]:
    """Return the candidates for a role; topics without messages only if there is no other."""
    for msgtype in role.types:
        topics = [
            topic
            for topic in bag.topics.values()
            if topic.msgtype == msgtype
            and role.accepts(topic)
            and not any(fnmatchcase(topic.name, glob) for glob in role.never)
        ]
        if topics:
            recorded = [topic.name for topic in topics if topic.count]
            return recorded or [topic.name for topic in topics]
    return []


def _in_fitting_frames(
    name: str, topics: list[str], first: FirstMessages, found: Mapping[str, Found]
) -> list[str]:
    """Return the topics whose frames fit the robot's other topics best, or else all."""
    if name == ODOMETRY:  # its child frame is the body that carries the sensors
        imus = [t.name for t in first.bag.topics.values() if t.msgtype in ROLES[IMU].types]
        sensors = (*found[SCAN].topics, *imus)
        carried = {topic: first.carried(first.child_frame(topic), sensors) for topic in topics}
        return [topic for topic in topics if carried[topic] == max(carried.values())]
    if name == MAP:  # localisation is in the frame of the map
        frames = first.frames_of(found[POSE].topics)
        return [topic for topic in topics if first.frame(topic) in frames] or topics
    return topics


def _one(topics: list[str], reason: str) -> Found:
    """Choose the least nested topic, then the first by name; the others make it ambiguous."""
    first, *others = sorted(topics, key=lambda topic: (topic.count("/"), topic))
    return Found((first,), reason, tuple(others))
