"""Six kinds of oracle, each calibrated like the scorer of a reference card."""
