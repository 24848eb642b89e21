"""Robustness of one policy: its success over latency and ClockSpeed, with ADSC and with TCSC."""
