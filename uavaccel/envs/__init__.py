"""Gymnasium environments; importing the package `uavaccel` registers them."""
