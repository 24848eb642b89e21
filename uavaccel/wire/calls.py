"""Declares wire calls: a decorator names a method's call, and its annotations check the client's arguments.

    class WorldApi(Calls, title="World"):
        @call("simSetWind")
        def set_wind(self, wind: Wind) -> None:
            self.simulation.world.set_wind(wind)

The number of arguments, their coercion (uavaccel.wire.arguments), the call's latency, whether a client may overlook its
refusal, and its line in docs/airsim-calls.md follow from the declaration.
"""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeVar, get_type_hints

from uavaccel.wire.arguments import coercion_of
from uavaccel.wire.latency import DEFAULT, Channel
from uavaccel.wire.recorder import Recorder
from uavaccel.wire.scenery import Scenery

MOST_IGNORED = 16  # arguments of a call without effect
Method = TypeVar("Method", bound=Callable[..., object])
AnyChannel = Channel | Callable[[Sequence[object]], Channel]


class WireCall:
    """The declaration of a call.

    `channel` is its kind of latency, or a function that derives it from the parameters. AirSim's clients only `join` a
    `joined` call and do not look at its error. A call that `leaves_state` does not change a paused simulation. `status`
    is its entry in docs/airsim-calls.md.
    """

    def __init__(
        self,
        name: str,
        method: Callable[..., object],
        channel: AnyChannel = DEFAULT,
        joined: bool = False,
        leaves_state: bool = False,
        status: str = "done",
    ) -> None:
        self.name, self.method, self.status = name, method, status
        self.joined, self.leaves_state = joined, leaves_state
        self._channel = channel
        _, *parameters = inspect.signature(method).parameters.values()
        taken = [parameter for parameter in parameters if parameter.kind is parameter.POSITIONAL_OR_KEYWORD]
        self.required = sum(each.default is each.empty for each in taken)
        self.most = len(taken) if taken == parameters else MOST_IGNORED
        hints = get_type_hints(method, include_extras=True)
        self._coercions = [(coercion_of(hints[each.name]), each.name) for each in taken]

    def channel_of(self, params: Sequence[object]) -> Channel:
        return self._channel if isinstance(self._channel, str) else self._channel(params)

    def arguments(self, params: Sequence[object]) -> list[object]:
        """Return the method's arguments for a client's parameters. Raises ValueError that names the first wrong one."""
        return [coerce(value, name) for value, (coerce, name) in zip(params, self._coercions, strict=False)]


def call(
    name: str, channel: AnyChannel = DEFAULT, *, joined: bool = False, leaves_state: bool = False
) -> Callable[[Method], Method]:
    """Declare a method of a `Calls` class as the wire call `name`."""

    def declare(method: Method) -> Method:
        method.wire_call = WireCall(name, method, channel, joined, leaves_state)  # type: ignore[attr-defined]
        return method

    return declare


def command(name: str, *, leaves_state: bool = False) -> Callable[[Method], Method]:
    """Declare a flight command, like `call`: its reply is the completion for which `join` waits."""
    return call(name, "move", joined=True, leaves_state=leaves_state)


def without_effect(*names: str, answer: object = None, refused: str = "") -> list[WireCall]:
    """Declare calls that do nothing: they return `answer`, or raise why they are `refused`."""
    return [_ignoring(name, answer, refused) for name in names]


def _ignoring(name: str, answer: object, refused: str) -> WireCall:
    def ignore(self: Calls, *ignored: object) -> object:
        if refused:
            self.notices.once(f"{name}: refused: {refused}")
            raise ValueError(f"{name} is not available: {refused}")
        self.notices.once(f"{name}: accepted, without effect")
        return answer

    return WireCall(name, ignore, status=f"refused: {refused}" if refused else "accepted")


@dataclass
class CallContext:
    """The state that all calls on one simulation share; `wall_ns` is when the present call is handled."""

    scenery: Scenery
    notices: Notices
    recorder: Recorder
    wall_ns: int = 0


class Calls:
    """A group of calls on one simulation: its methods, and those `ignored`, by `without_effect`.

    `title` is its section in docs/airsim-calls.md.
    """

    title: ClassVar[str] = ""
    ignored: ClassVar[Sequence[WireCall]] = ()
    calls: ClassVar[dict[str, WireCall]] = {}

    def __init_subclass__(cls, title: str) -> None:
        cls.title = title
        declared = [member.wire_call for member in vars(cls).values() if hasattr(member, "wire_call")]
        cls.calls = {each.name: each for each in (*declared, *cls.ignored)}

    def __init__(self, context: CallContext) -> None:
        self.context = context
        self.scenery, self.simulation = context.scenery, context.scenery.simulation
        self.notices = context.notices

    @property
    def wall_ns(self) -> int:
        """The wall time at which the present call is handled."""
        return self.context.wall_ns

    def bound(self) -> dict[str, BoundCall]:
        """Return the group's calls by wire name, bound to this object."""
        return {name: BoundCall(each, each.method.__get__(self)) for name, each in self.calls.items()}


@dataclass
class BoundCall:
    """A call, and the bound method that answers it."""

    call: WireCall
    handler: Callable[..., object]


MOST = 200  # kinds that are told apart: names and texts come from clients
LONGEST = 300  # characters of a text


class Notices:
    """Lines that are shown once each by `say`."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.say = say
        self._said: set[str] = set()

    def once(self, line: str) -> None:
        """Show a line, unless it was shown before."""
        if line not in self._said:
            self._said.add(line)
            self.say(line)


class Refusals:
    """Counts refused calls by method and reason; `say` shows a line at the first of each."""

    def __init__(self) -> None:
        self.say: Callable[[str], None] = lambda line: None
        self._count: Counter[tuple[str, str]] = Counter()

    def add(self, method: str, reason: str) -> None:
        """Count a refusal; the method's name may be any text that a client sent."""
        key = printable(method), printable(reason)
        if key not in self._count and len(self._count) >= MOST:
            key = "other calls", "were refused"
        self._count[key] += 1
        if self._count[key] == 1:
            self.say(" ".join(key))

    def lines(self) -> list[str]:
        """Return one line per kind of refusal with its count, the most frequent first."""
        return [f"{count} x {method} {reason}" for (method, reason), count in self._count.most_common()]


def printable(text: str) -> str:
    """Return a client's text on one line, without control characters."""
    return "".join(letter if letter.isprintable() else "?" for letter in text[:LONGEST])
