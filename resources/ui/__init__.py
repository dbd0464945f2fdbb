"""Dagster's web server behind a guard that accepts requests of its own pages only."""
