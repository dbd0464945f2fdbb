"""The one scorer: learned from normal recordings, calibrated on the same ones, kept in a card."""
