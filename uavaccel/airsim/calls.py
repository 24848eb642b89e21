"""Declares AirSim's calls: a method's signature says what is sent, its annotations how arguments and answer convert.

@remote
def simGetVehiclePose(self, vehicle_name: str = "") -> Pose: ...
"""

from __future__ import annotations

import functools
import inspect
import operator
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, TypeVar, get_args, get_origin, get_type_hints

from uavaccel.airsim.connection import Future
from uavaccel.airsim.types import MsgpackMixin
from uavaccel.wire.rpc import Received

if TYPE_CHECKING:
    from uavaccel.airsim.client import VehicleClient

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
        self._signature = signature = inspect.Signature(parameters)

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
