"""Regular expressions from clients, matched against whole names in bounded time: std::regex_match with icase.

The package `regex` matches them, since it can be given a time limit. The syntax is that of ECMA-262, 15.10, with the
POSIX classes of std::regex; what `regex` has beyond it is refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

import regex

from uavaccel.clock import MonotonicClock
from uavaccel.units import NS_PER_S

LONGEST_NS = NS_PER_S // 10  # for all names
MOST_STEPS = 100_000  # of a compiled expression, each of which takes about 300 bytes
FLAGS = regex.VERSION0 | regex.ASCII | regex.IGNORECASE  # \w, \d and \b are ASCII's
TOKEN = re.compile(
    r"(?P<own>\\0|\[\^?\]|[$.]|\{(?!\d+(?:,\d*)?\}))"
    r"|(?P<unknown>\(\?(?![:=!]).?|\(\*|[*+?}]\+)"
    r"|(?P<same>\\[bBdDfnrsStuvwWx1-9]|\[(?:\[:\w*:\]|\\.|[^]\\])+\])"
    r"|\\(?P<letter>.)",
    re.DOTALL,
)
OWN = {"$": r"\Z", ".": r"[^\n\r\u2028\u2029]", "{": r"\{", "[]": "(?!)", "[^]": r"[\s\S]", r"\0": r"\x00"}
POSIX = {"d": r"\d", "s": r"\s", "w": r"\w", "upper": "[:alpha:]", "lower": "[:alpha:]"}


def matching(text: str, names: Iterable[str]) -> list[str]:
    """Return the names that match as a whole, ignoring case. Raises ValueError for a wrong or slow expression."""
    clock = MonotonicClock()
    end_ns = clock.now_ns() + LONGEST_NS
    try:
        _check_size(text)
        pattern = regex.compile(TOKEN.sub(_translated, _folded(text)), FLAGS, cache_pattern=False)
        return [
            name
            for name in names
            if pattern.fullmatch(_folded(name), timeout=max(end_ns - clock.now_ns(), 0) / NS_PER_S)
        ]
    except TimeoutError:
        raise ValueError(f"{text!r} takes too long to match; make it simpler") from None
    except RecursionError:
        raise ValueError(f"{text!r} is no regular expression: nested too deeply") from None
    except (regex.error, ValueError) as error:
        raise ValueError(f"{text!r} is no regular expression: {getattr(error, 'msg', error)}") from None
    finally:
        regex.purge()  # it remembers something of every expression, without a bound


def _check_size(text: str) -> None:
    """Raise ValueError for an expression that might get too long, as `regex` writes out what it has to repeat."""
    groups = [int(least or 1) + 1 for least in re.findall(r"\)(?:\+|\{(\d+))", text)]
    letters = [int(least) for least in re.findall(r"[^)]\{(\d+)", text)]
    if len(text) * math.prod(groups) * max([1, *letters]) > MOST_STEPS:
        raise ValueError(f"longer than {MOST_STEPS} steps, its repetitions written out")


def _folded(text: str) -> str:
    return "".join(letter if letter.isascii() else letter.lower() for letter in text)


def _translated(token: re.Match[str]) -> str:
    """Return what `regex` understands as a token of ECMA-262. Raises ValueError where there is no such token."""
    if token["unknown"]:
        raise ValueError(f"{token['unknown']} is not known")
    if token["own"]:
        return OWN[token["own"]]
    if token["letter"]:
        return re.escape(token["letter"])
    return re.sub(r"\[:(\w+):\]", lambda known: POSIX.get(known[1], known[0]), token["same"])
