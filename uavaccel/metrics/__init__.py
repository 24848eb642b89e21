"""Metrics: pure functions of arrays for trajectory distances, speed-ups, intervals and tests."""
