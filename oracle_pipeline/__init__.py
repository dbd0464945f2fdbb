"""The analysis: bags and graphs in, features, datasets, clusters and reports out."""
