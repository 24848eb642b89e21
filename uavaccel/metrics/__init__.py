"""Pure functions on arrays: trajectory distances, speed-ups and their intervals."""
