"""Processes that run this Python: their start and end, those that stall, and what killed ones leave behind."""
