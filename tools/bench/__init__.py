"""Benchmarks of this project (``make bench``), as ratios measured in one run on one machine."""
