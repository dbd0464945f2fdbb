"""Features of the air traffic testbed: ADS-B reports, radar replies and fused tracks."""
