"""Dagster resources: where runs are stored, who executes them, how much storage they may use."""
