"""Declares wire calls: a decorator names a method's call, and its annotations check the client's arguments.

    class WorldApi(Calls, title="World"):
        @call("simSetWind")
        def set_wind(self, wind: Vector3r) -> None:
            self.simulation.world.set_wind(wind)

The number of arguments, their coercion (uavaccel.wire.types), the call's latency, whether a client may overlook its
refusal, and its line in docs/airsim-calls.md follow from the declaration.
"""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import ClassVar, TypeVar, get_type_hints

from uavaccel.kinematics import Kinematics
from uavaccel.sim.objects import SceneObjects, matching
from uavaccel.sim.simulation import Pilot, Simulation
from uavaccel.sim.vehicle.vehicle import Vehicle
from uavaccel.wire.latency import DEFAULT, Channel
from uavaccel.wire.pictures import Cameras, Pictures, Segmentation, can_render
from uavaccel.wire.recorder import Recorder
from uavaccel.wire.settings import Settings
from uavaccel.wire.types import coercion_of

MOST_IGNORED = 16  # arguments of a call without effect
Method = TypeVar("Method", bound=Callable[..., object])
AnyChannel = Channel | Callable[[Sequence[object]], Channel]
Say = Callable[[str], None]


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

    def ignoring(name: str) -> Callable[..., object]:
        def ignore(self: Calls, *ignored: object) -> object:
            if refused:
                self.scenery.say_once(f"{name}: refused: {refused}")
                raise ValueError(f"{name} is not available: {refused}")
            self.scenery.say_once(f"{name}: accepted, without effect")
            return answer

        return ignore

    status = f"refused: {refused}" if refused else "accepted"
    return [WireCall(name, ignoring(name), status=status) for name in names]


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

    def __init__(self, scenery: Scenery) -> None:
        self.scenery, self.simulation = scenery, scenery.simulation

    @property
    def wall_ns(self) -> int:
        """The wall time at which the present call is handled."""
        return self.scenery.wall_ns

    def handlers(self) -> dict[str, Callable[..., object]]:
        return {name: each.method.__get__(self) for name, each in self.calls.items()}


class Scenery:
    """What all calls on one simulation share: vehicles, cameras, objects, pictures, each made at first use; recorder.

    `wall_ns` is when the present call is handled. With `render` False images are refused. `recordings` is the folder of
    startRecording; `say` shows a line to the user.
    """

    def __init__(
        self, simulation: Simulation, settings: Settings, render: bool, recordings: Path | None, say: Say
    ) -> None:
        self.simulation, self.settings, self.render = simulation, settings, render
        self.wall_ns = 0
        self._cameras: dict[int, Cameras] = {}
        self._say, self._said = say, set[str]()
        self.recorder = Recorder(self, recordings, say)

    def say_once(self, line: str) -> None:
        """Show the user a line, unless it was shown before."""
        if line not in self._said:
            self._said.add(line)
            self._say(line)

    def cameras(self, vehicle: str = "", external: bool = False) -> Cameras:
        """Return the cameras of a vehicle or of the scene. Raises ValueError for an unknown vehicle either way."""
        number = self.number_of(vehicle)
        if external:
            return self._external_cameras
        if number not in self._cameras:
            name = self.simulation.world.vehicles[number].name
            given = self.settings.vehicles.get(name)
            cameras = given.cameras if given else {}
            self._cameras[number] = Cameras(self.settings.camera_defaults, cameras, carrier=number)
        return self._cameras[number]

    def number_of(self, name: str) -> int:
        """Return the number of the vehicle with this name; "" is the first vehicle.

        Raises ValueError, in AirSim's words, for an unknown name.
        """
        for number, vehicle in enumerate(self.simulation.world.vehicles):
            if name in ("", vehicle.name):
                return number
        raise self._not_there(name)

    def vehicle(self, name: str = "") -> Vehicle:
        """Return the vehicle with this name. Raises ValueError as number_of does."""
        return self.simulation.world.vehicles[self.number_of(name)]

    def truth(self, vehicle: str = "") -> Kinematics:
        """Return a vehicle's state in the world's frame. Raises ValueError as number_of does."""
        return self.vehicle(vehicle).kinematics(self.simulation.time0_ns, in_world=True)

    def pilot(self, name: str = "") -> Pilot:
        """Return the pilot of a vehicle. Raises ValueError as number_of does."""
        return self.simulation.pilots[self.number_of(name)]

    def flying_pilot(self, name: str) -> Pilot:
        """Return the pilot of a flying vehicle. Raises ValueError as number_of does, and in SimMode ComputerVision."""
        if self.settings.flightless:
            raise self._not_there(name)
        return self.pilot(name)

    def _not_there(self, name: str) -> ValueError:
        known = ", ".join(f"'{known}'" for known in self._names())
        return ValueError(
            f"Vehicle API for '{name}' is not available. This could either because this is simulation"
            f"-only API or this vehicle does not exist; there is {known}"
        )

    def _names(self) -> list[str]:
        return [vehicle.name for vehicle in self.simulation.world.vehicles]

    def named(self, name: str) -> list[str]:
        """Return the objects, then the vehicles, with this name in any case."""
        return [entry for entry in self._all_names() if entry.lower() == name.lower()]

    def named_like(self, pattern: str) -> list[str]:
        """List the objects, then the vehicles, whose whole name matches. Raises ValueError for a wrong pattern."""
        return matching(pattern, self._all_names())

    def _all_names(self) -> list[str]:
        return [*self.objects.names(), *self._names()]

    @cached_property
    def _external_cameras(self) -> Cameras:
        return Cameras(self.settings.camera_defaults, self.settings.external_cameras, external=True)

    def forget(self) -> None:
        """Forget objects, segmentation and pictures: the world has a new model."""
        for name in ("objects", "segmentation", "pictures"):
            self.__dict__.pop(name, None)

    @cached_property
    def objects(self) -> SceneObjects:
        return SceneObjects(self.simulation.world)

    @cached_property
    def segmentation(self) -> Segmentation:
        return Segmentation(self.simulation.world, self.objects)

    @cached_property
    def pictures(self) -> Pictures:
        own = [lens for name in self._names() for lens in self.cameras(name).lenses()]
        lenses = [lens for lens in (*own, *self._external_cameras.lenses()) if can_render(lens)]
        largest = max(lens.width for lens in lenses), max(lens.height for lens in lenses)
        return Pictures(self.simulation, largest, self.segmentation, self.render)


MOST = 200  # kinds that are told apart: names and texts come from clients
LONGEST = 300  # characters of a text


class Refusals:
    """Counts refused calls by method and reason; `say` shows a line at the first of each."""

    def __init__(self) -> None:
        self.say: Say = lambda line: None
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
