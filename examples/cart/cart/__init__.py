"""A testbed as a plug-in: a cart on a rail in MuJoCo."""
