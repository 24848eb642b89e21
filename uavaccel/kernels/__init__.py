"""Lanes by the thousand: what the camera sees of them, as arithmetic on arrays, for CPU threads and for GPUs."""
