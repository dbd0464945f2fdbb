"""The fourth testbed: a UR5e in MuJoCo with ros2_control and MoveIt, which picks and places."""
