"""Complete Nav2 becomes active, and drives among the pillars."""

import pytest

from sim.middleware.executor import SECOND
from sim.middleware.geometry import Pose2D
from sim.turtlebot3.map import WORLD_IN_MAP
from tests.sim.system import System


@pytest.fixture
def system():
    system = System()
    system.activate()
    return system


def test_nav2_becomes_active_soon_after_the_initial_pose(system):
    assert system.nav2.is_active
    assert system.executor.now_ns < 5 * SECOND


def test_the_robot_visits_poses_among_the_pillars_without_touching_anything(system):
    navigator = system.nav2.navigator
    goals = [Pose2D(-0.55, 0.55, 1.0), Pose2D(0.55, -0.55, -2.0)]
    navigator.follow(goals)
    system.executor.run_until(90 * SECOND, stop=lambda: navigator.is_over)
    assert [result.outcome for result in navigator.results] == ["succeeded", "succeeded"]
    assert [result.number_of_recoveries for result in navigator.results] == [0, 0]
    assert system.world.touches == []
    here = WORLD_IN_MAP.compose(system.world.pose)
    assert here.distance_to(goals[-1]) < 0.35  # 0.25 m by its own estimate
