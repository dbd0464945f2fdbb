"""A recorder of interval graphs that runs inside ROS."""
