"""Storage used and kept by runs. Imports no Dagster; only the commands print."""
