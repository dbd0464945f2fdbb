"""Five kinds of oracle side by side, each calibrated as the scorer of a reference card is."""
