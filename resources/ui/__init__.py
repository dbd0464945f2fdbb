"""Dagster's web server, which answers its own pages only."""
