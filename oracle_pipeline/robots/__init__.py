"""Who is in a recording: its robots, and which of a robot's topics is what."""
