"""Features of laser scanners: noise, agreement with each other, with the map and costmap."""
