"""The oracle beside a running robot: a DDS domain is watched, recorded and judged."""
