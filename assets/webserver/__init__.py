"""Dagster's web server behind a guard that accepts requests from its own pages only."""
