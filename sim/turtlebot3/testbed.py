"""The first testbed: a TurtleBot3 with Nav2 in MuJoCo, on patrol."""

from sim.testbed import Testbed, later
from sim.turtlebot3.recipes import TurtleBot3Recipe

TURTLEBOT3 = Testbed(
    experiments=(  # of the thesis
        "lidar_passthrough",
        "lidar_passthrough_odom",
        "fake_object",
        "random_noise",
        "delayed_passthrough",
        "delayed_fakeobject",
    ),
    hard_negatives={
        "benign_median": {},
        "benign_noise": {},
        "benign_drop": {},
        "benign_obstacle": {"obstacle": True},
        "benign_slow": {"speed": 0.6},
        "benign_pedestrian": {"pedestrian": True},
    },
    recipe=TurtleBot3Recipe,
    draw=later("sim.turtlebot3.drawing:draw"),
    bring_up=later("sim.turtlebot3.run:TurtleBot3Run"),
    made_by="sim.turtlebot3.run",
)
