"""The second testbed: air traffic control around an airport, with ADS-B, two radars and fusion."""
