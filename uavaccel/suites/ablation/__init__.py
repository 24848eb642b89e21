"""Ablations of DP1: one thing of the modelled simulator changed at a time."""
