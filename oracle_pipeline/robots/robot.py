"""The robots of a recording: which namespaces are robots, and the topics of each.

The topics of a robot are those of its namespace, without the namespace, and those that belong to no
robot, such as a shared ``/map`` or ``/tf``. So features do not depend on the namespace, and a
reference card that was learned on one robot can score another.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from oracle_pipeline.bags.reader import BagReader, Topic
from oracle_pipeline.robots.first_messages import TRANSFORM_TYPES
from oracle_pipeline.robots.known import Known
from oracle_pipeline.robots.roles import (
    COMMAND,
    JOINTS,
    LASER_SCAN,
    ODOMETRY,
    ROLES,
    Roles,
    RolesError,
    find_roles,
)
from oracle_pipeline.robots.roles_file import RoleChoices

#: Types of topics that nearly every ROS system has.
SHARED_TYPES = (
    *TRANSFORM_TYPES, "rosgraph_msgs/msg/Clock", "rcl_interfaces/msg/Log",
    "rcl_interfaces/msg/ParameterEvent",
)  # fmt: skip


_MOTION = {ODOMETRY, COMMAND}


@dataclass(frozen=True, slots=True)
class Robot:
    """One robot of a recording.

    Attributes
    ----------
    name : str
        Its namespace without the first slash, such as ``robot1``; empty if it is the only one.
    namespace : str
        Prefix removed from the names of its topics, such as ``/robot1``; may be empty.
    bag : BagReader
        Its topics and those that all robots share.
    roles : Roles
        Roles of these topics.
    used : frozenset of str
        Topics that features see.
    instead : mapping of str to tuple of str
        Topics that a reference does not know, and that may play a role whose topics are absent.
    """

    name: str
    namespace: str
    bag: BagReader
    roles: Roles
    used: frozenset[str]
    instead: Mapping[str, tuple[str, ...]]


def find_robots(
    bag: BagReader, choices: RoleChoices | None = None, known: Known | None = None
) -> list[Robot]:
    """Return the robots of a recording, by namespace; at least one.

    Parameters
    ----------
    bag : BagReader
    choices : RoleChoices, optional
        From a roles file.
    known : Known, optional
        Topics of a reference; features see no others but those that a roles file names.

    Raises
    ------
    RolesError
        The roles file has a robot without topics, or a topic whose type does not fit its role.
    """
    choices = choices or RoleChoices()
    for space in choices.robots or ():
        if space and not any(name.startswith(f"{space}/") for name in bag.topics):
            raise RolesError(
                f"The roles file names the robot {space}, but {bag.path} has no topic in that "
                "namespace. Use another, or omit `robots` to detect robots."
            )
    return [
        _robot(name, space, bag.renamed(names), choices.topics, known)
        for name, space, names in names_of_robots(bag.topics, choices.robots)
    ]


def names_of_robots(
    topics: Mapping[str, Topic], spaces: Collection[str] | None = None
) -> list[tuple[str, str, dict[str, str]]]:
    """Return name and namespace of each robot, and the names that its topics have to it.

    Parameters
    ----------
    topics : mapping of str to Topic
    spaces : collection of str, optional
        Namespaces of robots; by default they are detected.

    Returns
    -------
    list of tuple
        The third element has names relative to the robot, by recorded names.
    """
    spaces = sorted(_namespaces(topics) if spaces is None else spaces)
    return [
        (
            space.strip("/") if spaces[1:] else "",
            space,
            _names(topics, space, [other for other in spaces if other != space]),
        )
        for space in spaces
    ]


def _robot(
    name: str,
    space: str,
    bag: BagReader,
    chosen: Mapping[str, tuple[str, ...]],
    known: Known | None,
) -> Robot:
    if known is None:
        return Robot(name, space, bag, find_roles(bag, chosen), frozenset(bag.topics), {})
    bag, chosen = known.renamed(bag, chosen)
    roles = known.roles_in(bag, chosen)
    named = [topic for role in chosen for topic in roles.found[role].topics]
    used = known.topics.union(named).intersection(bag.topics)
    return Robot(name, space, bag, roles, used, known.instead(bag, chosen))


def of_robot(recording: str, name: str) -> str:
    """Return the name of a robot of a recording.

    Examples
    --------
    >>> of_robot("bag", "robot1"), of_robot("bag", "")
    ('bag#robot1', 'bag')
    """
    return f"{recording}#{name}" if name else recording


def recording_of(name: str) -> str:
    """Return the recording of what `of_robot` named.

    Examples
    --------
    >>> recording_of("bag#robot1"), recording_of("bag")
    ('bag', 'bag')
    """
    recording, _, robot = name.rpartition("#")
    return recording or robot


def _names(topics: Collection[str], space: str, others: Iterable[str]) -> dict[str, str]:
    """Return the names of topics relative to a robot, by their recorded names.

    For a topic outside its namespace, the common namespace is removed. If two topics would get the
    same name, the one nearer to its namespace is used.
    """
    foreign = tuple(f"{other}/" for other in others)
    seen = [(_inside(name, space), name) for name in topics if not name.startswith(foreign)]
    nearest = dict(sorted(seen, key=lambda each: len(each[1]) - len(each[0])))
    return {recorded: name for name, recorded in nearest.items()}


def _inside(name: str, space: str) -> str:
    """Return a name without the part that it shares with a namespace.

    Examples
    --------
    >>> _inside("/fleet/robot1/scan", "/fleet/robot1"), _inside("/fleet/map", "/fleet/robot1")
    ('/scan', '/map')
    """
    while space and not name.startswith(f"{space}/"):
        space = space.rpartition("/")[0]
    return name[len(space) :]


def _namespaces(topics: Mapping[str, Topic]) -> list[str]:
    """Return the namespaces that are robots; the root, which is empty, if there are none.

    A robot publishes its motion (odometry, or else commands) and at least one other robot topic. If
    several sibling namespaces do, and no topic outside has the motion, each is a robot. If only one
    does, and there are no robot topics outside, it is the robot.
    """
    own = [topic for topic in topics.values() if topic.msgtype not in SHARED_TYPES]
    spaces = _below("", own)
    if len(spaces) == 1 and len(_names(topics, spaces[0], ())) < len(topics):
        return [""]  # two topics would have the same name
    return spaces


def _below(space: str, topics: list[Topic]) -> list[str]:
    children: dict[str, list[Topic]] = {}
    outside: list[Topic] = []
    for topic in topics:
        first, slash, _ = topic.name[len(space) + 1 :].partition("/")
        (children.setdefault(f"{space}/{first}", []) if slash else outside).append(topic)
    robots = {child: held for child, held in children.items() if _is_robot(held)}
    if len(children) == 1 and not outside and _kinds(topics) & _MOTION:
        robots = children
    for child in children.keys() - robots.keys():
        outside += children[child]
    kinds = _kinds(outside)
    if len(robots) == 1 and not kinds:
        ((child, held),) = robots.items()
        return _below(child, held)
    if len(robots) > 1 and not kinds & _motion(robots.values()):
        fleets = {child: _below(child, held) for child, held in robots.items()}
        return [s for child, below in fleets.items() for s in (below if below[1:] else [child])]
    return [space]


def _motion(robots: Iterable[list[Topic]]) -> set[str]:
    """Return the kinds of topics with the robots' motion: odometry if all have it, or commands."""
    return {ODOMETRY} if all(ODOMETRY in _kinds(held) for held in robots) else {ODOMETRY, COMMAND}


def _is_robot(topics: Iterable[Topic]) -> bool:
    kinds = _kinds(topics)
    return bool(kinds & _MOTION) and len(kinds) > 1


def _kinds(topics: Iterable[Topic]) -> set[str]:
    """Return the kinds of robot topics among some topics."""
    types = {topic.msgtype for topic in topics}
    kinds = {kind for kind in (ODOMETRY, COMMAND, JOINTS) if types & set(ROLES[kind].types)}
    return kinds | ({LASER_SCAN} & types)


def roles_as_text(robots: Sequence[Robot]) -> str:
    """Return the topics of each role by robot, and ambiguities."""
    return "\n\n".join("\n".join(_lines_of_roles(robot)) for robot in robots)


def _lines_of_roles(robot: Robot) -> Iterator[str]:
    if robot.name:
        yield f"Robot {robot.name}: its topics without {robot.namespace}, and shared topics"
    elif robot.namespace:
        yield f"One robot: its topics without {robot.namespace}"
    else:
        yield "One robot"
    width = max(map(len, robot.roles.found))
    for role, found in robot.roles.found.items():
        topics = ", ".join(found.topics) or "none"
        yield f"  {role:{width}}  {topics} ({found.reason})"
    for remark in (*robot.roles.notes, *robot.roles.ambiguities()):
        yield f"  Note: {remark}"
