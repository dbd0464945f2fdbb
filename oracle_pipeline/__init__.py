"""The analysis of recordings: features, datasets, clusters, verdicts and reports."""
