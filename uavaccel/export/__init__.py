"""A run's games in the formats of other programs: one file per format, and what they have in common."""
