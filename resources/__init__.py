"""Dagster resources: the place of runs, the worker processes, and the storage budget."""
