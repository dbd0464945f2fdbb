"""The testbeds: robot experiments in MuJoCo, recorded as rosbag2."""
