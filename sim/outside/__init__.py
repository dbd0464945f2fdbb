"""A system that is not simulated here: a file says with which commands it starts and stops."""
