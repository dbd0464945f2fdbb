"""A scenario needs permission to send messages that move a robot, of any name and type."""

import pytest

from sim.fuzzing.actuation import moves_something
from sim.modes import modes
from sim.scenarios import builtin_scenarios

ANY = "std_msgs/msg/Float64"


@pytest.mark.parametrize(
    "topic",
    [
        "/cmd_vel", "/cmd_vel_nav", "/robot1/cmd_vel", "/diff_drive/cmd_vel_unstamped", "/drive",
        "/car/drive", "/ackermann_cmd", "/goal_pose", "/initialpose", "/move_base_simple/goal",
        "/mavros/rc/override", "/uav1/mavros/setpoint_position/local", "/mavros/actuator_control",
        "/mavros/setpoint_raw/attitude", "/fmu/in/vehicle_command", "/px4_1/fmu/in/actuator_motors",
        "/arm_controller/joint_trajectory", "/forward_position_controller/commands", "/joy",
        "/control/command/control_cmd", "/gripper_command", "/joint_command", "/speed_limit",
    ],
)  # fmt: skip
def test_these_names_move_something(topic):
    assert moves_something(topic, ANY)


@pytest.mark.parametrize(
    "msgtype",
    [
        "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Wrench",
        "ackermann_msgs/msg/AckermannDriveStamped", "trajectory_msgs/msg/JointTrajectory",
        "mavros_msgs/msg/OverrideRCIn", "mavros_msgs/msg/PositionTarget",
        "px4_msgs/msg/TrajectorySetpoint", "px4_msgs/msg/VehicleCommand", "sensor_msgs/msg/Joy",
        "autoware_auto_control_msgs/msg/AckermannControlCommand", "actuator_msgs/msg/Actuators",
    ],
)  # fmt: skip
def test_these_types_move_something_under_any_name(msgtype):
    assert moves_something("/anything", msgtype)


@pytest.mark.parametrize(
    ("topic", "msgtype"),
    [
        ("/scan", "sensor_msgs/msg/LaserScan"),
        ("/odom", "nav_msgs/msg/Odometry"),
        ("/tf", "tf2_msgs/msg/TFMessage"),
        ("/imu/data", "sensor_msgs/msg/Imu"),
        ("/joint_states", "sensor_msgs/msg/JointState"),
        ("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped"),
        ("/plan", "nav_msgs/msg/Path"),
        ("/mavros/local_position/pose", "geometry_msgs/msg/PoseStamped"),
        ("/fmu/out/vehicle_odometry", "px4_msgs/msg/VehicleOdometry"),
        ("/drive_status", "std_msgs/msg/String"),
    ],
)
def test_topics_that_report_the_robots_state_do_not_move_it(topic, msgtype):
    assert not moves_something(topic, msgtype)


def test_built_in_scenarios_that_alter_commands_need_permission_and_are_no_modes():
    mains = {name: scenario.document["main"] for name, scenario in builtin_scenarios().items()}
    moving = {name for name, main in mains.items() if moves_something(main["output"], main["type"])}
    of_robots = {"cf_setpoint_offset", "arm_trajectory_offset"}
    assert moving == {"command_injection", "command_scale", *of_robots}
    assert not moving & modes().keys()
