"""Summaries, figures and documents of finished runs."""
