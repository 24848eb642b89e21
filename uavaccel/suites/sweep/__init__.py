"""Robustness of one policy, condition by condition: its success as one thing at a time departs from its training."""
