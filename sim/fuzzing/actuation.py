"""Finds topics that move something, by name and type; a scenario needs permission for these."""

import re

# Names as drivers, navigation and autopilots have them, below any namespace.
_NAMES = re.compile(
    r"""/(?:\w+/)*(?:
        cmd_\w+ | \w+_cmd | \w*cmd_vel\w* | command | commands         # velocities, controllers
      | drive | ackermann\w* | steering\w* | throttle\w* | brake\w*    # vehicles
      | (?:control/)?control_cmd | teleop\w* | joy\w* | motor\w* | servo\w* | wheel_velocities
      | joint_trajectory | joint_command\w* | gripper_command\w*       # arms
      | goal | goal_pose | goal_update | move_base_simple/goal | waypoints   # where to go
      | initialpose | set_pose                                         # where it believes it is
      | preempt_teleop | speed_limit
      | mavros/(?:rc/override | manual_control/send | actuator_control | mission/.+)
      | mavros/setpoint_\w+/.+ | fmu/in/.+                             # autopilots
    )""",
    re.VERBOSE,
)

# Types that are commands wherever they are sent, but for those of whole packages of them.
_TYPES = re.compile(
    r"""
        geometry_msgs/msg/(?:Twist|TwistStamped|Wrench|WrenchStamped|Accel|AccelStamped)
      | ackermann_msgs/msg/\w+ | autoware_\w*control_msgs/msg/\w+
      | trajectory_msgs/msg/\w+ | control_msgs/msg/\w*(?:Command|Goal|Trajectory|Jog)\w*
      | actuator_msgs/msg/\w+ | mav_msgs/msg/\w+
      | mavros_msgs/msg/(?:\w*Override\w*|ManualControl|ActuatorControl|\w*Target|Thrust)
      | px4_msgs/msg/(?:\w*Setpoint\w*|VehicleCommand|ActuatorMotors|ActuatorServos
          |ManualControl\w*|OffboardControlMode)
      | sensor_msgs/msg/Joy
    """,
    re.VERBOSE,
)


def moves_something(topic: str, msgtype: str) -> bool:
    """Return whether a message on a topic may move a robot, or change where it goes.

    Parameters
    ----------
    topic
        Full name.
    msgtype
        As ``geometry_msgs/msg/Twist``.
    """
    return bool(_NAMES.fullmatch(topic) or _TYPES.fullmatch(msgtype))
