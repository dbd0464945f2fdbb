"""How two sets of recordings differ: two builds, two days, two robots."""
