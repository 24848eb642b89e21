"""What the shell completes: the names of experiments that ship, and the values of options that take a few words."""

from __future__ import annotations

from collections.abc import Callable

from uavaccel.resources import experiment_names

Complete = Callable[[str], list[str]]
"""The values that begin with what has been typed."""


def one_of(*values: str) -> Complete:
    """Return the completion of an option that takes one of these values."""

    def complete(incomplete: str) -> list[str]:
        return [value for value in values if value.startswith(incomplete)]

    return complete


def experiments(incomplete: str) -> list[str]:
    """Complete the name of an experiment that ships."""
    return [name for name in experiment_names() if name.startswith(incomplete)]
