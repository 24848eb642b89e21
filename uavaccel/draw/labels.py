"""The words of figures, tables and films: commands, ClockSpeeds, rounds. Loads nothing that draws."""

from __future__ import annotations

import math
from collections.abc import Mapping

from uavaccel.files import Plain


def command_name(command: str) -> str:
    """Return a command as figures and tables write it: ADSC, TCSC."""
    return command.upper()


def rounds_label(rounds: int) -> str:
    """Return a number of rounds with its noun: 1 round, 24 rounds."""
    return f"{rounds} round" if rounds == 1 else f"{rounds} rounds"


def clock_label(clock_speed: float) -> str:
    """Return a ClockSpeed as figures and tables write it: 1x, 1.5x, 100x."""
    return f"{clock_speed:g}x"


def command_at_clock(game: Mapping[str, Plain]) -> str:
    """Return command and ClockSpeed of a row or a task, as in "TCSC at 5x"."""
    return f"{command_name(game['command'])} at {clock_label(game['clock_speed'])}"


def number(value: float, digits: int = 5) -> str:
    """Return a number as people write it, of so many significant digits: 671.88, 0.0012, 4.3e-6; only 0 is "0"."""
    if not math.isfinite(value) or abs(value) < 1e-4:
        return f"{value:.{digits}g}".replace("e-0", "e-")
    text = f"{value:.{max(digits - 1 - math.floor(math.log10(abs(value))), 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def metres(value: float) -> str:
    """Return metres of three significant digits, as errors range from micrometres to metres."""
    return number(value, 3)


def in_words(seconds: float) -> str:
    """Return a duration in seconds, minutes or hours."""
    if seconds < 600:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
