"""Numbers of a window or an array: medians, shares, extremes, and even times."""
