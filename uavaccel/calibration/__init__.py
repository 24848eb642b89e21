"""This machine: whether it is complete and quiet, how long its messages take, and what that does to a flight."""
