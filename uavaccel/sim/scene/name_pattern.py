"""Regular expressions from clients, matched against whole names in bounded time: std::regex_match with icase.

A backtracking matcher takes 2^n steps for some expressions of n characters, and cannot be interrupted. This one is a
nondeterministic finite automaton, simulated on all paths at once (Thompson, CACM 11(6), 1968). Syntax: ECMA-262, 15.10,
with the POSIX classes of std::regex; back references are refused, since they cannot be matched in bounded time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

MOST_STEPS = 10_000  # states of an expression, with its repetitions unrolled
MOST_WORK = 300_000  # states visited for all names: a tenth of a second
LINE_ENDS = "\n\r\u2028\u2029"

Letters: TypeAlias = Callable[[str], bool]
"""Whether a character class contains a character."""
Condition: TypeAlias = Callable[[str, int], bool]
"""Whether an assertion holds at a position of a name."""


@dataclass
class Step:
    """A state of the automaton: it consumes a character or checks an assertion, and continues to any of `ways`."""

    takes: Letters | None = None
    holds: Condition | None = None
    ways: list[int] = field(default_factory=list)


Part: TypeAlias = Callable[[list[Step]], None]
"""Appends the states of a part of an expression, which continue to those appended next."""


class NamePattern:
    """A compiled expression. Raises ValueError for an invalid one."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._work = 0
        try:
            self._steps = _written(Parser(text, self._ends).whole())
        except RecursionError:
            raise ValueError(f"{text!r} is no regular expression: nested too deeply") from None
        except ValueError as error:
            raise ValueError(f"{text!r} is no regular expression: {error}") from None

    def matches(self, name: str) -> bool:
        """Return whether the whole name matches, ignoring case. Raises ValueError if that takes too long."""
        return self._ends(self._steps, name, 0, whole=True)

    def _ends(self, steps: list[Step], name: str, place: int, whole: bool) -> bool:
        """Return whether the states match from a position to the end of the name or, unless `whole`, any part."""
        reached = self._reached(steps, [0], name, place)
        for number in range(place, len(name)):
            if not whole and len(steps) - 1 in reached:
                return True
            self._count_work(len(reached))
            letter = name[number]
            taken = [step for step in reached if (takes := steps[step].takes) and takes(letter)]
            if not taken:
                return False
            onwards = [way for step in taken for way in steps[step].ways]
            reached = self._reached(steps, onwards, name, number + 1)
        return len(steps) - 1 in reached

    def _reached(self, steps: list[Step], begin: list[int], name: str, place: int) -> set[int]:
        """Return all states reachable from some without consuming a character."""
        reached: set[int] = set()
        pending = begin
        while pending:
            number = pending.pop()
            if number in reached:
                continue
            self._count_work(1)
            reached.add(number)
            step = steps[number]
            if step.takes is None and (step.holds is None or step.holds(name, place)):
                pending.extend(step.ways)
        return reached

    def _count_work(self, steps: int) -> None:
        self._work += steps
        if self._work > MOST_WORK:
            raise ValueError(f"{self._text!r} takes too long to match; make it simpler")


def _written(part: Part) -> list[Step]:
    """Return the states of a part; the last one is the accepting state."""
    steps: list[Step] = []
    part(steps)
    _add(steps, Step())
    return steps


def _add(steps: list[Step], step: Step) -> int:
    if len(steps) >= MOST_STEPS:
        raise ValueError(f"longer than {MOST_STEPS} steps, its repetitions written out")
    steps.append(step)
    return len(steps) - 1


def letter_of(takes: Letters) -> Part:
    return lambda steps: steps[_add(steps, Step(takes=takes))].ways.append(len(steps))


def condition(holds: Condition) -> Part:
    return lambda steps: steps[_add(steps, Step(holds=holds))].ways.append(len(steps))


def sequence(parts: list[Part]) -> Part:
    def write(steps: list[Step]) -> None:
        for part in parts:
            part(steps)

    return write


def choice(parts: list[Part]) -> Part:
    def write(steps: list[Step]) -> None:
        fork, ends = _add(steps, Step()), []
        for part in parts:
            steps[fork].ways.append(len(steps))
            part(steps)
            ends.append(_add(steps, Step()))
        for end in ends:
            steps[end].ways.append(len(steps))

    return write if len(parts) > 1 else parts[0]


def repeated(part: Part, least: int, most: int | None) -> Part:
    def write(steps: list[Step]) -> None:
        for _ in range(least):
            part(steps)
        forks = []
        for _ in range(1 if most is None else most - least):
            forks.append(_add(steps, Step()))
            part(steps)
        if most is None:
            _add(steps, Step(ways=[forks[0]]))
        for fork in forks:
            steps[fork].ways += [fork + 1, len(steps)]

    return write


# --- syntax ---------------------------------------------------------------------------------------------------


def _is_word(letter: str) -> bool:
    return letter == "_" or (letter.isascii() and letter.isalnum())


def _at_word_edge(name: str, place: int) -> bool:
    before, after = name[place - 1 : place] if place else "", name[place : place + 1]
    return (before != "" and _is_word(before)) != (after != "" and _is_word(after))


CLASSES: dict[str, Letters] = {
    "d": lambda letter: letter.isascii() and letter.isdigit(),
    "s": str.isspace,
    "w": _is_word,
}
POSIX: dict[str, Letters] = {
    **CLASSES,
    "alnum": str.isalnum,
    "alpha": str.isalpha,
    "blank": lambda letter: letter in " \t",
    "cntrl": lambda letter: letter < " " or letter == "\x7f",
    "digit": CLASSES["d"],
    "graph": lambda letter: letter.isprintable() and letter != " ",
    "lower": str.isalpha,  # whatever its case
    "print": str.isprintable,
    "punct": lambda letter: letter.isprintable() and not letter.isalnum() and letter != " ",
    "space": str.isspace,
    "upper": str.isalpha,
    "xdigit": lambda letter: letter in "0123456789abcdefABCDEF",
}
CONTROLS = {"0": "\0", "f": "\f", "n": "\n", "r": "\r", "t": "\t", "v": "\v"}
HEX_DIGITS = {"x": 2, "u": 4}


def _not(takes: Letters) -> Letters:
    return lambda letter: not takes(letter)


def _between(first: str, last: str) -> Letters:
    """Return a class of the characters in a range, ignoring case."""
    if first > last:
        raise ValueError(f"the range {first}-{last} runs backwards")
    return lambda letter: any(first <= each <= last for each in {letter, letter.lower(), letter.upper()})


class Parser:
    """Parses an expression; `ends` matches states from a position of a name, for lookaheads."""

    def __init__(self, text: str, ends: Callable[[list[Step], str, int, bool], bool]) -> None:
        self._text, self._place, self._ends = text, 0, ends

    def whole(self) -> Part:
        """Parse the whole expression. Raises ValueError."""
        part = self._choice()
        if self._place < len(self._text):
            raise ValueError(f"unbalanced ) at letter {self._place}")
        return part

    def _next(self, wanted: str) -> bool:
        """Skip `wanted` if it comes next, and return whether it does."""
        found = self._text.startswith(wanted, self._place)
        self._place += len(wanted) * found
        return found

    def _letter(self) -> str:
        if self._place >= len(self._text):
            raise ValueError("it ends too soon")
        self._place += 1
        return self._text[self._place - 1]

    def _choice(self) -> Part:
        parts = [self._sequence()]
        while self._next("|"):
            parts.append(self._sequence())
        return choice(parts)

    def _sequence(self) -> Part:
        parts: list[Part] = []
        while self._place < len(self._text) and self._text[self._place] not in "|)":
            parts.append(self._repeated(self._atom()))
        return sequence(parts)

    def _repeated(self, part: Part) -> Part:
        ends = self._repetition()
        if ends is None:
            return part
        self._next("?")  # as few as possible: the same where all has to match
        return repeated(part, *ends)

    def _repetition(self) -> tuple[int, int | None] | None:
        for sign, ends in {"*": (0, None), "+": (1, None), "?": (0, 1)}.items():
            if self._next(sign):
                return ends
        inside, closed, _ = self._text[self._place + 1 :].partition("}")
        least, comma, most = inside.partition(",")
        given = [number for number in (least, most) if number]
        if not (self._text.startswith("{", self._place) and closed and least) or not all(
            number.isascii() and number.isdecimal() and len(number) < 6 for number in given
        ):
            return None  # a brace like any letter
        self._place += len(inside) + 2
        ends = int(least), int(most) if most else None if comma else int(least)
        if ends[1] is not None and ends[1] < ends[0]:
            raise ValueError(f"{{{inside}}} asks for fewer than it asks for at least")
        return ends

    def _atom(self) -> Part:
        letter = self._letter()
        if letter == "(":
            return self._group()
        if letter in "*+?":
            raise ValueError(f"nothing to repeat at letter {self._place - 1}")
        if letter in "^$":
            at_start = letter == "^"
            return condition(lambda name, place: place == (0 if at_start else len(name)))
        if letter == "\\" and self._text[self._place : self._place + 1] in ("b", "B"):
            edge = self._letter() == "b"
            return condition(lambda name, place: _at_word_edge(name, place) == edge)
        if letter == "[":
            return letter_of(self._class())
        if letter == ".":
            return letter_of(lambda each: each not in LINE_ENDS)
        escaped = self._escaped() if letter == "\\" else letter
        return letter_of(escaped if callable(escaped) else _between(escaped, escaped))

    def _group(self) -> Part:
        ahead = next((sign for sign in ("?=", "?!") if self._next(sign)), None)
        if ahead is None and not self._next("?:") and self._text.startswith("?", self._place):
            raise ValueError(f"(?{self._text[self._place + 1 : self._place + 2]} is not known")
        part = self._choice()
        if not self._next(")"):
            raise ValueError("a ( is not closed")
        if ahead is None:
            return part
        steps, wanted = _written(part), ahead == "?="
        return condition(lambda name, place: self._ends(steps, name, place, False) == wanted)

    def _escaped(self) -> str | Letters:
        """Parse what follows a backslash: a character or a class."""
        letter = self._letter()
        if letter.lower() in CLASSES:
            known = CLASSES[letter.lower()]
            return known if letter.islower() else _not(known)
        if letter in CONTROLS:
            return CONTROLS[letter]
        if letter.isdecimal():
            raise ValueError(f"the back reference \\{letter} is not available")
        if letter in HEX_DIGITS:
            digits = "".join(self._letter() for _ in range(HEX_DIGITS[letter]))
            return chr(int(digits, 16))
        return letter

    def _class(self) -> Letters:
        """Parse a class in brackets, after the opening one."""
        negated, members = self._next("^"), []
        while not self._next("]"):
            first = self._member()
            if callable(first) or not self._text.startswith("-", self._place):
                members.append(first if callable(first) else _between(first, first))
                continue
            self._next("-")
            if self._text.startswith("]", self._place):
                members += [_between(first, first), _between("-", "-")]
                continue
            last = self._member()
            if callable(last):
                raise ValueError(f"a range from {first} has no end")
            members.append(_between(first, last))
        has: Letters = lambda letter: any(member(letter) for member in members)  # noqa: E731
        return _not(has) if negated else has

    def _member(self) -> str | Letters:
        if self._next("[:"):
            name, closed, _ = self._text[self._place :].partition(":]")
            if not closed or name not in POSIX:
                raise ValueError(f"there is no class [:{name[:20]}:]")
            self._place += len(name) + 2
            return POSIX[name]
        if self._next("\\"):
            return "\b" if self._next("b") else self._escaped()
        return self._letter()
