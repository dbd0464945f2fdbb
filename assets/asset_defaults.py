"""What all assets share."""

import dagster as dg

OWNERS = ["team:behaviour-oracle"]
SINGLE_RUN = dg.BackfillPolicy.single_run()  # one Dagster run for any range of partitions
