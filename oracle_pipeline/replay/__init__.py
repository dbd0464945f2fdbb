"""A recorded run as a film and as one picture."""
