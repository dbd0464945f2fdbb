"""Features of messages and graphs, whatever the robot: rhythm, bytes, structure, pairs."""
