"""What the project measures of itself: ``make bench``. Ratios of one run on one machine."""
