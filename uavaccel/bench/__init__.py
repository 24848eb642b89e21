"""Instruments: what this machine does, measured; each figure beside the bound that it is judged by."""
