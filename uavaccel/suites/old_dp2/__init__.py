"""DP2: what the drone sees on its way through the lane (paper, sections III-C2b and IV-C)."""
