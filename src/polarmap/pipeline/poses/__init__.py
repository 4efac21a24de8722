"""Where poses come from, and whether they can be believed."""
