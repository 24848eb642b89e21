"""DP1: trajectory accuracy and speed on a square path (paper, sections III-C2a and IV-B)."""
