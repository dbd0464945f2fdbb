"""Formats the robots of a recording and the roles of their topics as text."""

from collections.abc import Iterator, Sequence

from oracle_pipeline.robots.robot import Robot


def as_text(robots: Sequence[Robot]) -> str:
    """Return the topics of each role by robot, and ambiguities."""
    return "\n\n".join("\n".join(_lines(robot)) for robot in robots)


def _lines(robot: Robot) -> Iterator[str]:
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
