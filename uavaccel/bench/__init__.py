"""Instruments: what this machine does, each measurement beside the bound that it is judged by."""
