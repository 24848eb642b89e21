"""Training: a policy learned in the obstacle lane (paper, sections III-C3 and IV-D)."""
