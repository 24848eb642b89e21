"""Training and evaluation of policies in the obstacle lane."""
