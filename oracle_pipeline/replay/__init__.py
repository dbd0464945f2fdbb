"""Draws a recorded run as a film and as a picture."""
