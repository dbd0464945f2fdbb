"""Storage of runs. Imports no Dagster; only the commands print."""
