"""Bags, run directories and graph files: the only code that simulation and analysis share."""
