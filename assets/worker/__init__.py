"""What a worker process does for one run. No Dagster here."""
