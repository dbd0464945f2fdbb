"""Bags, run directories and graph files: the leaf that the simulation and the analysis share."""
