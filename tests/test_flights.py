"""Flights call by call: what is answered, when, and where every vehicle is then, as recorded in tests/data/flights.

A flight is a heading, options, and calls; below each call stands what came of it, written anew with RECORD=1. `& call`
does not wait for the reply. After a call: the answer, what was said, replies that have come due, wall time in ms, tick,
and vehicles that have changed: position, attitude in degrees, velocity, modes and values of the goal, and what there is
besides.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
import numpy as np
import pytest

from tests.flying import FOR_EVER, STRAIGHT, point, pose
from tests.scenes import assert_bounded
from uavaccel.errors import UserError
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.simulation import DeferredReply, Pilot, Simulation
from uavaccel.sim.world import World
from uavaccel.units import euler_from_quaternion
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.settings import Settings

DEGREES = ("latitude", "longitude")
FOLDER = Path(__file__).parent / "data/flights"


def moving(x: float, y: float, z: float, velocity: tuple[float, ...], turning: tuple[float, ...]) -> dict[str, Any]:
    return pose(x, y, z) | {"linear_velocity": point(*velocity), "angular_velocity": point(*turning)}


class Scenario(NamedTuple):
    """A flight as it is written: its heading, its options, and its calls without what came of them."""

    heading: str
    options: dict[str, Any]
    calls: list[str]


def scenarios(file: Path) -> Iterator[Scenario]:
    for text in file.read_text(encoding="utf-8").split("\n## ")[1:]:
        heading, *lines = text.splitlines()
        options = {key: eval(value) for key, value in (line[2:].split(": ", 1) for line in lines if line[:2] == "- ")}
        yield Scenario(heading, options, [line for line in lines if line[:2] in ("> ", "& ")])


class Flight(dict[str, Any]):
    """The names that a call may use: AirSim's calls, times to wait for, and parameters in short."""

    def __init__(
        self, profile: str = "native", clock: float = 1.0, settings: Any = None, show: str = "", airsim: bool = False
    ) -> None:
        super().__init__(point=point, pose=pose, moving=moving, FOR_EVER=FOR_EVER, STRAIGHT=STRAIGHT, NAN=float("nan"))
        self.said: list[str] = []
        self |= {"go": self.go, "to": self.to, "settle": self.settle}
        self |= {"ANY": (0, STRAIGHT), "ROUTE": (0, STRAIGHT, -1, 1)}  # the way it faces, and how it follows a path
        self.simulation = Simulation(World("blocks", PROFILES[profile], airsim=airsim), clock)
        read = Settings.model_validate(settings or {})
        read.prepare(self.simulation.world)
        self.api = Api(self.simulation, read, render=False, say=self.said.append)
        for pilot in self.simulation.pilots:
            pilot.api_control = True
        self.show, self.begun_ns = show.split(), 0
        self.pending, self.told = list[tuple[str, DeferredReply]](), dict[str, str]()

    def __missing__(self, method: str) -> Any:
        def call(*params: Any) -> Any:
            request = rpc.unpack_request(rpc.pack_request(1, method, params))
            return self.api.call(request.method, request.params, self.simulation.wall_ns)

        return call

    def go(self, seconds: float) -> None:
        self.simulation.advance_to(self.simulation.wall_ns + round(seconds * 1e9))

    def to(self, tick: int, late_ns: int = 0) -> None:
        self.simulation.advance_to(self.simulation.pacer.wall_due(tick) + late_ns)

    def settle(self) -> None:
        self.simulation.settle(self.simulation.wall_ns)

    def do(self, line: str) -> str:
        """Make a call, and say what came of it."""
        try:
            answer = eval(line[2:], {"__builtins__": {}}, self)
        except (rpc.RpcError, UserError) as error:
            answer = f"refused: {error}"
        if not isinstance(answer, DeferredReply):
            answer = received(answer)
        else:
            reply, answer = answer, "later"
            while line[0] == ">" and reply.due_wall_ns is None:
                due_ns = self.simulation.next_event_wall_ns()
                assert due_ns is not None, "nothing will ever end"
                self.simulation.advance_to(due_ns)
            if line[0] == ">":
                answer = received(reply)
            else:
                self.pending.append((line[2:].partition("(")[0], reply))
        assert_bounded(self.simulation.world.model)
        due, begun_ns = [each for each in self.pending if each[1].due_wall_ns is not None], self.begun_ns
        self.pending = [each for each in self.pending if each[1].due_wall_ns is None]
        replies = [f"{name}: {plain(received(one))} at {ms((one.due_wall_ns or 0) - begun_ns)}" for name, one in due]
        clock = f"{ms(self.simulation.wall_ns - begun_ns)} ms, tick {self.simulation.world.tick}"
        pilots = [pilot for pilot in self.simulation.pilots if pilot.vehicle.name != "Other"]
        state = [clock + ", paused" * self.simulation.paused, *filter(None, map(self._changed, pilots))]
        said, self.said[:] = [f"said: {text}" for text in self.said], []
        return "; ".join([plain(answer), *said, *replies, *state, *filter(None, [self.simulation.failure])])

    def begin_anew(self) -> None:
        """Reset, at a whole second from which times are counted now; a vehicle alone gets company far away."""
        self.simulation.run(self.simulation.wall_ns)
        self.begun_ns = -(-self.simulation.wall_ns // 10**9) * 10**9
        self.simulation.advance_to(self.begun_ns)
        if len(self.simulation.pilots) == 1 and not self.simulation.world.still:
            self.api.call("simAddVehicle", ["Other", "SimpleFlight", pose(-80, -80, 0)], self.begun_ns)
        self.api.call("reset", [], self.begun_ns)
        for part in (self.pending, self.told, self.said):
            part.clear()
        for pilot in self.simulation.pilots:
            pilot.api_control = True

    def _changed(self, pilot: Pilot) -> str:
        vehicle, state, now = pilot.vehicle, pilot.vehicle.state, pilot.kinematics()
        attitude = np.degrees(euler_from_quaternion(now.orientation_wxyz))
        flags = {"no control": not pilot.api_control, "disarmed": not state["armed"], "landed": vehicle.landed}
        modes = "".join(str(int(state[f"{axis}_mode"])) for axis in ("xy", "z", "yaw"))
        own = {name: state[name] if name in state.dtype.names else vehicle.parameters[name] for name in self.show}
        told = ", ".join([
            f"{vehicle.name} {digits(now.position_m, 3)}",
            *(digits(attitude, 1), digits(now.linear_velocity_m_s, 2), f"modes {modes} {digits(state['goal'], 3)}"),
            *([f"{len(pilot.log)} commands to {[*pilot.log][-1]}"] if len(pilot.log) else []),
            *([f"{vehicle.contact_log.count} touches"] if vehicle.contact_log.count else []),
            *(flag for flag, is_so in flags.items() if is_so),
            *(f"{name} {digits(np.ravel(values), 4)}" for name, values in own.items()),
        ])  # fmt: skip
        changed, self.told[vehicle.name] = self.told.get(vehicle.name) != told, told
        return told if changed else ""


def received(reply: Any) -> Any:
    answer = reply.encode(reply.value) if isinstance(reply, DeferredReply) else reply
    return msgpack.unpackb(rpc.pack_response(1, None, answer))[3]


def ms(wall_ns: int) -> str:
    return f"{wall_ns / 1e6:.9g}"


def digits(values: Any, decimals: int) -> str:
    return " ".join(f"{round(float(value), decimals) + 0.0:g}" for value in values)


def plain(value: Any) -> str:
    """An answer in short: numbers with five digits, places on the earth with nine, counts and times with all."""
    if isinstance(value, dict):
        parts = [(key, f"{each:.9g}" if key in DEGREES else plain(each)) for key, each in value.items()]
        return "{" + ", ".join(f"{key.removesuffix('_val')} {text}" for key, text in parts) + "}"
    if isinstance(value, list | tuple | np.ndarray):
        return "[" + " ".join(map(plain, value)) + "]"
    return f"{round(float(value), 6) + 0.0:.5g}" if isinstance(value, float | np.floating) else str(value)


def assert_scenario_as_recorded(file: Path, scenario: Scenario, do: Callable[[str], str]) -> None:
    """Make its calls, and hold what `do` says of each against what stands below it in the file."""
    options = [f"- {key}: {value!r}" for key, value in scenario.options.items()]
    made = [part for line in scenario.calls for part in (line, f"  {do(line)}")]
    now, text = "\n".join([f"## {scenario.heading}", *options, *made]), file.read_text(encoding="utf-8")
    [recorded] = re.findall(rf"^## {re.escape(scenario.heading)}$(?:\n.+)*", text, re.MULTILINE)
    if os.environ.get("RECORD"):
        file.write_text(text.replace(recorded, now), encoding="utf-8")
        recorded = now
    changes = difflib.unified_diff(recorded.splitlines(), now.splitlines(), "recorded", "now", lineterm="", n=0)
    assert recorded == now, "\n".join(["RECORD=1 pytest writes it anew; read the change:", *changes])


FLIGHTS = {scenario.heading: (file, scenario) for file in sorted(FOLDER.glob("*.txt")) for scenario in scenarios(file)}


# what outlasts a reset, and simulated times, which go on
LASTING = re.compile(r"simSpawn|simDestroy|simSet(?!Veh|Kin)|simAdd|set\w+Gains|Recording|uavaccel(?!Cont)|Detection")
TIMES = re.compile(r"(?:(?:stamp|utc) |(?:^|ContinueFor: )\[)\d+")


@pytest.mark.parametrize("heading", FLIGHTS)
def test_a_flight_is_as_recorded(heading: str) -> None:
    """And the same after a reset, which leaves nothing of it, and beside another vehicle."""
    (file, scenario), told = FLIGHTS[heading], list[str]()
    flight = Flight(**scenario.options)

    def do(line: str) -> str:
        told.append(flight.do(line))
        return told[-1]

    assert_scenario_as_recorded(file, scenario, do)
    if not LASTING.search(" ".join(scenario.calls)):
        flight.begin_anew()
        again = [flight.do(line) for line in scenario.calls]
        assert [TIMES.sub("", text) for text in again] == [TIMES.sub("", text) for text in told]
