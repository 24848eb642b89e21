"""The hot loop: autopilot, rotors, drag and MuJoCo's own `mj_step`, compiled, without Python and without the GIL.

While no contact is possible, `free_step` replaces `mj_step`, bit for bit.

AirSim integrates by velocity Verlet: the pose moves with the mean velocity of the tick, and the velocity it
reports belongs to the tick's end (FastPhysicsEngine.hpp). MuJoCo's semi-implicit Euler step kicks, then drifts.
Both are one and the same leapfrog if MuJoCo's velocity is read as the one half a tick behind, so here

    mj_step           kick with the accelerations of the last tick, drift to the pose of this one
    accelerate        the next kick, from the rotors and from the pose before the drift, as AirSim takes it
    velocity          MuJoCo's velocity plus half the next kick

and the poses equal AirSim's to rounding, while contacts, images and poses stay those of MuJoCo's own state.
"""

from __future__ import annotations

import ctypes
import math
import re
import sys
import zlib
from dis import opmap
from pathlib import Path
from types import CellType, FunctionType
from typing import TYPE_CHECKING, NamedTuple, Protocol

import mujoco
import numpy as np
from llvmlite import ir
from numba import carray, cfunc, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from uavaccel.sim.parts import part
from uavaccel.sim.vehicle.autopilot import control
from uavaccel.sim.vehicle.free_body import free_step
from uavaccel.sim.vehicle.quadrotor import FLIGHT_DTYPE, NEVER, PARAMETERS_DTYPE, Record, accelerate, turn_rotors

if TYPE_CHECKING:
    from collections.abc import Callable

    from numba.core.base import BaseContext

    Intrinsic = tuple[types.Type, Callable[..., ir.Value]]  # numba's: a signature, and what writes the code

FROM_OURS = re.compile(rf"^\s*from ({__name__.partition('.')[0]}\.[\w.]+) import (\([^)]*\)|.*)", re.MULTILINE)

# One row of the recorder: tick, position, quaternion, velocity, body rate.
SAMPLE_COLUMNS = 1 + 3 + 4 + 3 + 3

RECORDER_DTYPE = np.dtype([("next_tick", "i8"), ("period", "i8"), ("count", "i8"), ("dropped", "i8")])


def mj_step_address() -> int:
    """Return the address of `mj_step` in the library that the mujoco package has loaded."""
    library = next(Path(mujoco.__file__).parent.glob("*mujoco*.[sd][oyl]*"))
    function = ctypes.CDLL(str(library)).mj_step
    return int(ctypes.cast(function, ctypes.c_void_p).value or 0)


@intrinsic
def _call_mj_step(typing_context: object, address: types.Type, model: types.Type, data: types.Type) -> Intrinsic:
    """Call `mj_step(model, data)` by its address, an argument because numba cannot cache a global pointer."""

    def codegen(context: BaseContext, builder: ir.IRBuilder, signature: object, arguments: list[ir.Value]) -> ir.Value:
        pointer = ir.IntType(8).as_pointer()
        function_type = ir.FunctionType(ir.VoidType(), [pointer, pointer])
        function = builder.inttoptr(arguments[0], function_type.as_pointer())
        builder.call(function, [builder.inttoptr(argument, pointer) for argument in arguments[1:]])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), codegen


@intrinsic
def _pointer(typing_context: object, address: types.Type) -> Intrinsic:
    """Convert an address to a pointer, for `carray`."""

    def codegen(context: BaseContext, builder: ir.IRBuilder, signature: object, arguments: list[ir.Value]) -> ir.Value:
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.int64), codegen


call_mj_step: Callable[[int, int, int], None] = _call_mj_step
pointer: Callable[[int], int] = _pointer


@part
def read_pose(state: Record, qpos: NDArray[np.float64]) -> None:
    """Copy MuJoCo's pose into the state, NED and FRD (units.py's half turn about x, unrolled)."""
    state.position[0], state.position[1], state.position[2] = qpos[0], -qpos[1], -qpos[2]
    state.quaternion[0], state.quaternion[1] = qpos[3], qpos[4]
    state.quaternion[2], state.quaternion[3] = -qpos[5], -qpos[6]


LOW_M = 0.5  # below it, the quadrotor's hull may touch the ground
LEVEL = 1e-10  # of a quaternion's component; half the angle in radians


@part
def level_out(parameters: Record, qpos: NDArray[np.float64]) -> None:
    """Make an attitude near the ground exactly level that is so but for rounding errors.

    Where a cylinder is upright to the last bits, MuJoCo 4.0 takes rounding errors for the way to its rim, finds it up
    to a radius deep in the plane below, and throws it up. An attitude that is exactly level has no such errors.
    """
    if parameters.contacts_act == 0 or qpos[2] > LOW_M or abs(qpos[4]) + abs(qpos[5]) > LEVEL:
        return
    norm = math.sqrt(qpos[3] * qpos[3] + qpos[6] * qpos[6])
    qpos[3] /= norm
    qpos[4] = qpos[5] = 0.0
    qpos[6] /= norm


@part(inline=False)
def kick(parameters: Record, state: Record, qvel: NDArray[np.float64], force: NDArray[np.float64]) -> None:
    """Compute the next kick from the state's pose and MuJoCo's velocity, and the velocity at the tick."""
    velocity = (qvel[0], -qvel[1], -qvel[2])
    rate = (qvel[3], -qvel[4], -qvel[5])
    accelerate(parameters, state, velocity, rate)
    half = 0.5 * parameters.tick_s
    for axis in range(3):
        state.velocity[axis] = velocity[axis] + half * state.acceleration[axis]
        state.rate[axis] = rate[axis] + half * state.angular_acceleration[axis]

    mass, inertia = parameters.mass_kg, parameters.inertia_kg_m2
    p, q, r = rate
    # MuJoCo adds gravity and the gyroscopic term itself.
    force[0] = mass * state.acceleration[0]
    force[1] = -mass * state.acceleration[1]
    force[2] = -mass * (state.acceleration[2] - parameters.gravity_m_s2)
    force[3] = inertia[0] * state.angular_acceleration[0] + (inertia[2] - inertia[1]) * q * r
    force[4] = -(inertia[1] * state.angular_acceleration[1] + (inertia[0] - inertia[2]) * r * p)
    force[5] = -(inertia[2] * state.angular_acceleration[2] + (inertia[1] - inertia[0]) * p * q)


@part
def feel_contacts(parameters: Record, state: Record, contact: NDArray[np.float64], push: NDArray[np.float64]) -> None:
    """Add the contact forces of the last step to the accelerations, and to the velocity at the tick.

    MuJoCo adds them to the next kick itself. Those of the coming step are not known yet; at rest they are the same.
    """
    if contact[0] == 0.0 or parameters.contacts_act == 0:
        return
    half, mass, inertia = 0.5 * parameters.tick_s, parameters.mass_kg, parameters.inertia_kg_m2
    for axis in range(3):
        side = 1.0 if axis == 0 else -1.0  # units.py's half turn about x
        linear, angular = side * push[axis] / mass, side * push[3 + axis] / inertia[axis]
        state.acceleration[axis] += linear
        state.angular_acceleration[axis] += angular
        state.velocity[axis] += half * linear
        state.rate[axis] += half * angular


@part
def note_contacts(state: Record, contact: NDArray[np.float64]) -> bool:
    """Return whether the number of contacts has changed; the state is still that of the tick they belong to."""
    if contact[0] == state.contacts:
        return False
    state.contacts, state.contacts_changed, state.contact_tick = contact[0], 1, state.tick
    for axis in range(3):
        state.contact_position[axis] = state.position[axis]
    if state.collision_tick == NEVER:
        state.collision_tick = state.tick
    return True


@part
def record(recorder: Record, samples: NDArray[np.float64], state: Record) -> None:
    """Append the state to the bounded buffer if a sample is due at its tick."""
    if state.tick != recorder.next_tick:
        return
    recorder.next_tick += recorder.period
    if recorder.count == len(samples):
        recorder.dropped += 1
        return
    row = samples[recorder.count]
    recorder.count += 1
    row[0] = state.tick
    for axis in range(3):
        row[1 + axis] = state.position[axis]
        row[8 + axis] = state.velocity[axis]
        row[11 + axis] = state.rate[axis]
    for component in range(4):
        row[4 + component] = state.quaternion[component]


@part
def pass_ticks(state: Record, recorder: Record, samples: NDArray[np.float64], ticks: int) -> None:
    """Record this tick if a sample is due, and let `ticks` pass."""
    record(recorder, samples, state)
    for _ in range(ticks):
        state.tick += 1
        record(recorder, samples, state)


@part
def after_step(
    parameters: Record,
    state: Record,
    recorder: Record,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    force: NDArray[np.float64],
    contact: NDArray[np.float64],
    push: NDArray[np.float64],
    samples: NDArray[np.float64],
) -> bool:
    """Complete one vehicle's tick after MuJoCo's step; returns whether contacts have begun or ended."""
    # the contact sensor reports on the pose at the step's beginning: the tick before
    changed = note_contacts(state, contact)
    kick(parameters, state, qvel, force)
    feel_contacts(parameters, state, contact, push)
    arrive(parameters, state, recorder, qpos, samples)
    return changed


@part
def arrive(
    parameters: Record, state: Record, recorder: Record, qpos: NDArray[np.float64], samples: NDArray[np.float64]
) -> None:
    """Update the rotors at the tick that ends, then pose, autopilot and recorder at the next one."""
    turn_rotors(parameters, state)
    level_out(parameters, qpos)
    read_pose(state, qpos)
    state.tick += 1
    control(parameters, state)
    record(recorder, samples, state)


HANDLES = 15  # per vehicle


class CompiledLoop(Protocol):
    """A compiled entry point, called through `ctypes(handles, ticks)`."""

    def ctypes(self, handles: ctypes._Pointer[ctypes.c_int64], ticks: int) -> int: ...


@part(inline=False)
def views(handles: NDArray[np.int64], first: int) -> tuple[Record, ...]:
    """Return the arrays behind `handles`, int64 addresses from index `first` on, one of which is a count of rows.

    In order: mj_step, model, data; qpos, qvel, qfrc_applied, contact sensor, qfrc_constraint; parameters, flight,
    recorder, samples, their number of rows; and only for `fly_free` qacc_warmstart and a copy of MuJoCo's time. Records
    are arrays of one, since numba returns no records. Plain addresses are used since numba's own dispatch of a dozen
    arrays costs more than three ticks of flight.
    """
    return (
        carray(pointer(handles[first + 3]), 7, np.float64),
        carray(pointer(handles[first + 4]), 6, np.float64),
        carray(pointer(handles[first + 5]), 6, np.float64),
        carray(pointer(handles[first + 6]), 1, np.float64),
        carray(pointer(handles[first + 7]), 6, np.float64),
        carray(pointer(handles[first + 8]), 1, PARAMETERS_DTYPE),
        carray(pointer(handles[first + 9]), 1, FLIGHT_DTYPE),
        carray(pointer(handles[first + 10]), 1, RECORDER_DTYPE),
        carray(pointer(handles[first + 11]), (handles[first + 12], SAMPLE_COLUMNS), np.float64),
    )


@part
def steps_without_mujoco(handles: NDArray[np.int64], ticks: int) -> int:
    """Fly up to `ticks` ticks without contacts and return how many; `handles` as in `views`."""
    qpos, qvel, force, _, _, of_parameters, of_flight, of_recorder, samples = views(handles, 0)
    parameters, state, recorder = of_parameters[0], of_flight[0], of_recorder[0]
    acceleration = carray(pointer(handles[13]), 6, np.float64)
    time_s = carray(pointer(handles[14]), 1, np.float64)
    for flown in range(ticks):
        if not free_step(parameters, qpos, qvel, force, acceleration):
            return flown
        time_s[0] += parameters.tick_s
        kick(parameters, state, qvel, force)
        arrive(parameters, state, recorder, qpos, samples)
    return ticks


@part
def after_step_of_all(handles: NDArray[np.int64]) -> bool:
    """Do `after_step` for every vehicle; `handles` as in `fly_all`."""
    changed = False
    for vehicle in range(handles[0]):
        seen = views(handles, 1 + HANDLES * vehicle)
        qpos, qvel, force, contact, push, parameters, state, recorder, samples = seen
        changed |= after_step(parameters[0], state[0], recorder[0], qpos, qvel, force, contact, push, samples)
    return changed


class EntryPoints(NamedTuple):
    """The compiled entry points, called through `.ctypes(handles, ticks)`, which release the GIL."""

    fly: CompiledLoop
    """Fly up to `ticks` ticks; returns how many: fewer where contacts begin or end."""
    fly_free: CompiledLoop
    """Fly without MuJoCo while no contact is possible; returns fewer ticks at numbers of which it would warn."""
    fly_all: CompiledLoop
    """Fly several vehicles of one model: `handles` are their count, followed by those of each."""
    rest: CompiledLoop
    """Let `ticks` ticks pass without moving, this one included in the recording if a sample is due."""
    refresh: CompiledLoop
    """Read MuJoCo's pose and compute the next kick, after a change from outside."""


def _compile(sources: int) -> EntryPoints:
    """Compile the entry points, or load them from numba's cache.

    numba only notices changes of this file; closing over `sources` makes it notice those of the others.
    """
    entry_point = cfunc(types.int64(types.CPointer(types.int64), types.int64), cache=True)

    @entry_point
    def fly(handles: NDArray[np.int64], ticks: int) -> int:
        qpos, qvel, force, contact, push, of_parameters, of_flight, of_recorder, samples = views(handles, 0)
        parameters, state, recorder = of_parameters[0], of_flight[0], of_recorder[0]
        for flown in range(ticks * (sources != 0)):
            call_mj_step(handles[0], handles[1], handles[2])
            if after_step(parameters, state, recorder, qpos, qvel, force, contact, push, samples):
                return flown + 1
        return ticks

    @entry_point
    def fly_free(handles: NDArray[np.int64], ticks: int) -> int:
        return steps_without_mujoco(handles, ticks * (sources != 0))

    @entry_point
    def fly_all(handles: NDArray[np.int64], ticks: int) -> int:
        for flown in range(ticks * (sources != 0)):
            call_mj_step(handles[1], handles[2], handles[3])
            if after_step_of_all(handles):
                return flown + 1
        return ticks

    @entry_point
    def rest(handles: NDArray[np.int64], ticks: int) -> int:
        _, _, _, _, _, _, of_flight, of_recorder, samples = views(handles, 0)
        pass_ticks(of_flight[0], of_recorder[0], samples, ticks * (sources != 0))
        return ticks

    @entry_point
    def refresh(handles: NDArray[np.int64], ticks: int) -> int:
        qpos, qvel, force, _, _, of_parameters, of_flight, _, _ = views(handles, 0)
        read_pose(of_flight[0], qpos)
        kick(of_parameters[0], of_flight[0], qvel, force)
        return ticks * (sources != 0)

    return EntryPoints(fly, fly_free, fly_all, rest, refresh)


def _reached(module: str, found: dict[str, Path]) -> dict[str, Path]:
    """Collect the package's files that a module imports, directly or indirectly.

    Imports are found as text: parsing the files would take a good part of a program's start.
    """
    file = Path(sys.modules[module].__file__ or "")
    if file.name == "__init__.py" or module in found:  # packages hold no code of the loop's
        return found
    found[module] = file
    for source, names in FROM_OURS.findall(file.read_text("utf-8")):
        for name in (source, *(f"{source}.{word}" for word in re.findall(r"\w+", names))):
            if name in sys.modules:
                _reached(name, found)
    return found


def sources(module: str) -> int:
    """Return a checksum, never 0, of the package's code that a module depends on."""
    files = _reached(module, {})
    return zlib.crc32(b"".join(files[module].read_bytes() for module in sorted(files))) | 1


def stamped(function: Callable[..., object], sources: int) -> Callable[..., object]:
    """Return a function for numba to compile that closes over `sources` too, though nothing in it reads them."""
    code, raw = function.__code__, bytearray(function.__code__.co_code)
    closure = *(function.__closure__ or ()), CellType(sources)
    if (copies := raw[::2].find(opmap["COPY_FREE_VARS"])) >= 0:  # the count of them, which Python runs by
        raw[2 * copies + 1] = len(closure)
    code = code.replace(co_freevars=(*code.co_freevars, "sources"), co_code=bytes(raw))
    return FunctionType(code, function.__globals__, function.__name__, function.__defaults__, closure)


ENTRY_POINTS = _compile(sources(__name__))
