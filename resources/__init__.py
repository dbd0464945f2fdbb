"""Dagster resources: where runs live, how they are executed, what may be spent."""
