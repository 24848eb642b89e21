"""A call of AirSim's clients is its declaration: the decorator sends the arguments, and answers with what it declares.

@remote
def simGetVehiclePose(self, vehicle_name: str = "") -> Pose: ...
"""

from __future__ import annotations

import functools
import inspect
import operator
from collections.abc import Callable
from typing import Annotated, TypeVar, get_args, get_origin, get_type_hints

from uavaccel.airsim.connection import Connection, Future
from uavaccel.airsim.wire_type import MsgpackMixin
from uavaccel.wire.rpc import Received

CameraName = Annotated[str | int, str]
Mirrored = Annotated[float, operator.neg]
"""An angle or a rate that is positive the other way round on the wire."""
Declared = TypeVar("Declared", bound=Callable[..., object])


class Calls:
    """Calls over a connection."""

    client: Connection


def remote(declared: Declared) -> Declared:
    """A method that calls what has its name on the wire, less "Async", with all its arguments in their order.

    An argument is sent as the annotation's function makes it, where that is `Annotated`. The answer becomes what the
    method is annotated to return; a `Future` is returned at once.
    """
    name = declared.__name__.removesuffix("Async")
    _, *parameters = inspect.signature(declared).parameters.values()
    defaults = tuple(each.default for each in parameters if each.default is not each.empty)
    required = len(parameters) - len(defaults)
    hints = get_type_hints(declared, include_extras=True)
    annotated = [(place, hints[each.name]) for place, each in enumerate(parameters)]
    conversions = [
        (place, hint.__metadata__[0]) for place, hint in annotated if get_origin(hint) is Annotated
    ]
    answer = _answer(hints["return"])

    @functools.wraps(declared)
    def call(self: Calls, *arguments: object, **named: object) -> object:
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


def _answer(annotation: type) -> Callable[[Received], object] | None:
    """What makes a server's answer one of the annotated type; None for a `Future`, whose answer is waited for later."""
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
