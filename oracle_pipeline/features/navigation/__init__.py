"""Features of Nav2: goals, plans and recoveries."""
