"""The third testbed: a Crazyflie in MuJoCo with its firmware, motion capture and Crazyswarm2."""
