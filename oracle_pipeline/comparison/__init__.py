"""Compares two sets of recordings: two builds, two days, two robots."""
