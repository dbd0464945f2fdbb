"""The work on one run, in a worker process. Imports no Dagster."""
