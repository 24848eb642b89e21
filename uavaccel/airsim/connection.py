"""A client's connection to a server, and the declaration of AirSim's calls over it.

A call blocks, or returns a future. A method's signature says what is sent, its annotations how arguments and answer
convert:

@remote
def simGetVehiclePose(self, vehicle_name: str = "") -> Pose: ...
"""

from __future__ import annotations

import functools
import inspect
import operator
import sys
import threading
import weakref
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Protocol, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from uavaccel.airsim.types import MsgpackMixin
from uavaccel.clock import MonotonicClock, wait_for_sockets
from uavaccel.units import NS_PER_S
from uavaccel.wire.rpc import Future, Received, RpcSocket

if TYPE_CHECKING:
    from uavaccel.airsim.client import VehicleClient

LONGEST_S = 1e6  # in which a socket can be waited for
_printed: set[str] = set()
_AS_THEY_ARE = (bool, int, float, str, bytes, type(None))


class Connection(Protocol):
    """What AirSim's clients need: calls by name, with arguments that msgpack or `plain` can convert."""

    def call(self, method: str, *params: object) -> Received:
        """Call a method and wait for its answer. Raises rpc.RpcError with the server's text."""
        ...

    def call_async(self, method: str, *params: object) -> Future:
        """Call a method without waiting."""
        ...

    def close(self) -> None: ...


def print_once(method: str, error: str) -> None:
    """Print the error of a call, which its caller may never look at; the same text is printed once per process."""
    if error not in _printed:
        _printed.add(error)
        print(f"airsim: {method} failed: {error}", file=sys.stderr, flush=True)


def plain(value: object) -> object:
    """Convert a value for msgpack: AirSim's types to their fields, NumPy's to numbers and lists.

    Raises TypeError for anything else.
    """
    for name in ("to_msgpack", "tolist"):
        if hasattr(value, name):
            return getattr(value, name)()
    if isinstance(value, set | frozenset | range) or hasattr(value, "__iter__"):
        return list(value)
    raise TypeError(f"{type(value).__name__} cannot be sent; numbers, text, lists, maps and AirSim's types can")


class SocketConnection:
    """msgpack-rpc over TCP for any number of threads: one of those that wait reads for all.

    An answer may take `timeout_s` from when it is waited for. Raises ConnectionError if no server listens at the
    address.
    """

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        self._rpc: RpcSocket[Future] = RpcSocket(host, port)
        self._close = weakref.finalize(self, self._rpc.close)  # scripts close nothing
        self._timeout_ns = patience_ns(timeout_s)
        self._clock = MonotonicClock()
        self._sending = threading.Lock()
        self._state = threading.Condition()  # guards what is below
        self._read_by_somebody = False

    def call(self, method: str, *params: object) -> Received:
        return self._send(method, params, self._wait).get()

    def call_async(self, method: str, *params: object) -> Future:
        return self._send(method, params, self._join)

    def close(self) -> None:
        self._close()

    def _send(self, method: str, params: tuple[object, ...], wait: Callable[[Future], None]) -> Future:
        future = Future(method, wait)
        with self._sending:
            self._rpc.socket.sendall(self._rpc.request(future, method, params, default=plain))
        return future

    def _join(self, future: Future) -> None:
        """Wait for the answer of an asynchronous call; print its error."""
        self._wait(future)
        if future.error is not None:
            print_once(future.method, future.error)

    def _wait(self, future: Future) -> None:
        """Wait until the answer has arrived, or is late. Raises ConnectionError if the server has gone."""
        deadline_ns = self._clock.now_ns() + self._timeout_ns
        while True:
            with self._state:
                while self._read_by_somebody and not future.done:
                    left_ns = deadline_ns - self._clock.now_ns()
                    if not self._state.wait(left_ns / NS_PER_S):
                        answer_late(future, self._timeout_ns)
                if future.done:
                    return
                self._read_by_somebody = True
            answered: list[Future] = []
            try:
                if wait_for_sockets(self._rpc.selector, deadline_ns):
                    answered = self._rpc.receive()
                else:
                    answer_late(future, self._timeout_ns)
            finally:
                with self._state:
                    self._read_by_somebody = False
                    self._state.notify_all()
            for each in answered:
                each.tell()


def patience_ns(timeout_s: float) -> int:
    """Return for how long a client with this time-out waits, which may be infinite."""
    return round(min(timeout_s, LONGEST_S) * NS_PER_S)


def answer_late(future: Future, timeout_ns: int) -> None:
    future.answer(f"no answer within {timeout_ns / NS_PER_S:g} s", None, late=True)


Connect = Callable[[str, int, float], Connection]
_connect: Connect = SocketConnection


def connect(host: str, port: int, timeout_s: float) -> Connection:
    """Return a connection for a client: over TCP, unless `_connect` has been replaced, as under `uavaccel fly`."""
    return _connect(host, port, timeout_s)


def as_sent(value: object) -> object:
    """Convert an argument to what a server would receive: maps, lists and numbers. Raises TypeError like packing."""
    if type(value) in _AS_THEY_ARE:
        return value
    if isinstance(value, Mapping):
        return {key: as_sent(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [as_sent(inner) for inner in value]
    if isinstance(value, int | float | str):  # an enumeration's member, NumPy's float64
        return next(kind(value) for kind in (int, float, str) if isinstance(value, kind))
    return as_sent(plain(value))


def as_received(value: object) -> object:
    """Convert an answer to what a client would receive: arrays become lists of single precision."""
    if isinstance(value, np.ndarray):
        return value.astype(np.float32).ravel().tolist()
    if isinstance(value, list):
        return [as_received(inner) for inner in value] if value and type(value[0]) is not float else value
    if isinstance(value, dict) and any(isinstance(inner, np.ndarray) for inner in value.values()):
        return {key: as_received(inner) for key, inner in value.items()}
    return value


CameraName = Annotated[str | int, str]
Mirrored = Annotated[float, operator.neg]
"""An angle or a rate whose sign is the opposite one on the wire."""
Declared = TypeVar("Declared", bound=Callable[..., object])


def remote(declared: Declared) -> Declared:
    """Make a declared method send the call of its name, without "Async", and its arguments in their order.

    An argument annotated with `Annotated` is converted by the annotation's function before it is sent. The answer is
    converted to the annotated return type; a method annotated to return a `Future` returns it at once.
    """
    name = declared.__name__.removesuffix("Async")
    _, *parameters = inspect.signature(declared).parameters.values()
    defaults = tuple(parameter.default for parameter in parameters if parameter.default is not parameter.empty)
    required = len(parameters) - len(defaults)
    hints = get_type_hints(declared, include_extras=True)
    annotated = [(place, hints.get(parameter.name)) for place, parameter in enumerate(parameters)]
    conversions = [
        (place, hint.__metadata__[0]) for place, hint in annotated if hint is not None and get_origin(hint) is Annotated
    ]
    answer = _answer(hints["return"])

    @functools.wraps(declared)
    def call(self: VehicleClient, *arguments: object, **named: object) -> object:
        if named or not required <= len(arguments) <= len(parameters):
            declared(self, *arguments, **named)  # raises TypeError where they do not fit
            rest = parameters[len(arguments) :]
            arguments += tuple(named.get(each.name, each.default) for each in rest)
        params = [*arguments, *defaults[len(arguments) - required :]]
        for place, convert in conversions:
            params[place] = convert(params[place])
        if answer is None:
            return self.client.call_async(name, *params)
        return answer(self.client.call(name, *params))

    return call  # type: ignore[return-value]


class Untyped:
    """Declares the call of its attribute's name by required parameters and defaults; nothing is converted."""

    def __init__(self, *required: str, **defaults: object) -> None:
        kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
        parameters = [inspect.Parameter(each, kind) for each in ("self", *required)]
        parameters += [inspect.Parameter(default, kind, default=value) for default, value in defaults.items()]
        signature = inspect.Signature(parameters)

        def declared(*arguments: object, **named: object) -> object:
            return signature.bind(*arguments, **named)

        declared.__signature__ = signature  # type: ignore[attr-defined]
        self._declared = declared

    def __set_name__(self, owner: type, name: str) -> None:
        self._declared.__name__ = name
        self._declared.__qualname__ = f"{owner.__name__}.{name}"
        setattr(owner, name, remote(self._declared))


def _answer(annotation: type) -> Callable[[Received], object] | None:
    """Return what converts a server's answer to the annotated type; None for a `Future`, which is awaited."""
    if annotation is Future:
        return None
    if annotation is object:
        return lambda answer: answer
    if annotation is type(None):
        return lambda answer: None
    if get_origin(annotation) is list:
        (each,) = get_args(annotation)
        if issubclass(each, MsgpackMixin):
            return lambda answers: [each.from_msgpack(one) for one in answers]
        return list
    return annotation.from_msgpack if issubclass(annotation, MsgpackMixin) else annotation
