"""Worlds of randomly placed shapes, one per game, with a clear start and goal."""
