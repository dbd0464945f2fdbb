"""Agglomerative clustering of run features, without labels: scale, grow a tree, cut, score."""
