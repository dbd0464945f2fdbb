"""The Dagster layer: partitions, assets, checks, jobs, schedules."""
