"""Lanes on one GPU: the functions of the CPU, compiled as CUDA kernels by numba-cuda.

One to 32 threads fly a lane. All data stays on the device; kernels are launched on PyTorch's current stream, so that a
round of them can be recorded as a CUDA graph. numba-cuda cannot disable fused multiply-adds: flights differ from the
CPU's in their last bits, events do not (sim/parts).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np
import torch as th
from numba import cuda, types
from numba.cuda import libdevice
from numba.cuda.core import caching
from numba.cuda.extending import overload
from numba.np.numpy_support import from_dtype

from uavaccel.kernels import clutter_games, lanes, touching
from uavaccel.kernels import cuda_views as views
from uavaccel.kernels.clutter_games import put_in_both
from uavaccel.kernels.cuda_views import BLOCKS as BLOCKS
from uavaccel.kernels.cuda_views import COLUMN_THREADS as COLUMN_THREADS
from uavaccel.kernels.cuda_views import DEALING_THREADS, WARP, WHOLE_WARP, sum_counts
from uavaccel.kernels.cuda_views import SEEING_THREADS as SEEING_THREADS
from uavaccel.kernels.cuda_views import SEEING_THREADS_A_LANE as SEEING_THREADS_A_LANE
from uavaccel.kernels.cuda_views import SLOTS as SLOTS
from uavaccel.kernels.fields import Operand
from uavaccel.kernels.lane_clocks import LAUNCHED
from uavaccel.kernels.lane_games import OF_LAYOUT
from uavaccel.kernels.lanes import NEXT_CHECK, TOUCHED, fly_ticks
from uavaccel.kernels.scene import LOOSE, add_to, sort_cell, visit
from uavaccel.kernels.touching import around, deepest_of_all, least_of_all
from uavaccel.sim.clutter import DRAWS, GAP, keep_gaps, sample_shape
from uavaccel.sim.parts import save_apart, times
from uavaccel.sim.pcg64 import STREAM_FIELDS, advance
from uavaccel.sim.vehicle.hotloop import sources, stamped
from uavaccel.sim.vehicle.quadrotor import FLIGHT_DTYPE, PARAMETERS_DTYPE, PID_LEVELS

FLYING_THREADS = 32  # per thread block
FLYING_WARPS = 2  # per multiprocessor: a quarter of its registers, which leaves the rest to the learner
PARAMETERS, FLIGHT = from_dtype(PARAMETERS_DTYPE), from_dtype(FLIGHT_DTYPE)

SIGNED = {np.dtype(np.uint32): np.int32, np.dtype(np.uint64): np.int64}  # PyTorch computes with signed integers

caching.IndexDataCacheFile.save = save_apart


@overload(times)
def _times(a, b):  # type: ignore[no-untyped-def]
    if a == types.float32 and b == types.float32:
        return lambda a, b: libdevice.fmul_rn(a, b)
    return lambda a, b: libdevice.dmul_rn(a, b)


@cuda.jit(device=True)
def mask_of(threads):  # type: ignore[no-untyped-def]
    """Return the bit mask of the threads in this warp that fly the same lane."""
    return (WHOLE_WARP >> (WARP - threads)) << (cuda.laneid // threads * threads)


@overload(least_of_all)
def _least_of_all(distance_m, threads):  # type: ignore[no-untyped-def]
    def shuffled(distance_m, threads):  # type: ignore[no-untyped-def]
        mask, distance = mask_of(threads), threads // 2
        while distance > 0:
            distance_m = min(distance_m, cuda.shfl_xor_sync(mask, distance_m, distance))
            distance //= 2
        return distance_m

    return shuffled


@overload(deepest_of_all)
def _deepest_of_all(found, depth_m, threads):  # type: ignore[no-untyped-def]
    def shuffled(found, depth_m, threads):  # type: ignore[no-untyped-def]
        mask, distance = mask_of(threads), threads // 2
        while distance > 0:
            other, depth = (cuda.shfl_xor_sync(mask, found, distance), cuda.shfl_xor_sync(mask, depth_m, distance))
            if depth < depth_m or (depth == depth_m and other > found):
                found, depth_m = other, depth
            distance //= 2
        return found

    return shuffled


for _function, _chosen in touching.BY_TYPE:
    overload(_function)(_chosen)


# --- one thread a lane -----------------------------------------------------------------------------------------------

work: Any = None
"""The part that a kernel calls, a global of each one's own: a part in a closure would have another key in each process,
by which numba's cache would not find the kernel again."""


def _each_lane(which, arguments):  # type: ignore[no-untyped-def]
    """Work for every lane whose flag in `which` (L,) is set."""
    lane = cuda.grid(1)
    if lane < len(which) and which[lane] != 0:
        work(lane, *arguments)


def _of_lanes(name: str, part: Any) -> FunctionType:
    code = _each_lane.__code__.replace(co_name=name, co_qualname=name)
    return FunctionType(code, {**globals(), "work": part}, name)


# --- worlds of clutter, DEALING_THREADS a lane -----------------------------------------------------------------------


def deal_clutter(idle, distribution, deals, games):  # type: ignore[no-untyped-def]
    """Sample the next goal and world of every lane whose flag in `idle` (L,) is set: DEALING_THREADS a lane."""
    lane, mine = cuda.blockIdx.x, cuda.threadIdx.x
    if lane >= len(idle) or idle[lane] == 0:
        return
    scene, rows = games.solids, deals.layouts[lane]
    first, start, cells = int(scene.frame[lane, LOOSE]), scene.start[lane], scene.start.shape[1] - 1
    if mine == 0:
        clutter_games.deal(lane, distribution, deals, games)
    for cell in range(mine, cells + 1, DEALING_THREADS):
        start[cell] = 0
    cuda.syncthreads()
    sample_shapes(mine, distribution.clutter, deals.streams[lane, OF_LAYOUT], deals.goals[lane], rows)
    cuda.syncthreads()
    if mine == 0 and distribution.clutter[GAP] > 0.0:
        keep_gaps(distribution.clutter, rows)
    cuda.syncthreads()
    for number in range(mine, len(rows), DEALING_THREADS):
        put_in_both(rows, number, scene, games.scenes, lane)
        visit(scene, lane, first + number, False)
    cuda.syncthreads()
    sum_counts(mine, start, cells)
    if start[cells] > scene.items.shape[1]:
        return
    for number in range(mine, len(rows), DEALING_THREADS):
        visit(scene, lane, first + number, True)
    cuda.syncthreads()
    for cell in range(mine, cells, DEALING_THREADS):
        sort_cell(scene, lane, cell)


@cuda.jit(device=True)
def sample_shapes(mine, numbers, stream, goal, rows):  # type: ignore[no-untyped-def]
    """Sample a thread's share of a layout, from its own places in the layout's stream."""
    own, place = cuda.local.array(STREAM_FIELDS, types.uint64), 0
    for field in range(STREAM_FIELDS):
        own[field] = stream[field]
    for number in range(mine, len(rows), DEALING_THREADS):
        advance(own, DRAWS * (number - place))
        sample_shape(numbers, own, goal[0], -goal[1], rows[number])
        place = number + 1


@overload(add_to)
def _add_in_turn(counts, place, number):  # type: ignore[no-untyped-def]
    return lambda counts, place, number: cuda.atomic.add(counts, place, number)


@cuda.jit(device=True, inline="always")
def store_flight(lane, watch, state, pose, motion, now):  # type: ignore[no-untyped-def]
    """Write a lane's state, pose and velocity from registers back to memory.

    Forces and accelerations are recomputed in each tick and not stored (flight.short_step).
    """
    now.watch[lane, NEXT_CHECK], now.watch[lane, TOUCHED] = watch[NEXT_CHECK], watch[TOUCHED]
    stored, body = now.state[lane], now.body[lane]
    for field in range(3 * PID_LEVELS):  # unused by the kernel: reread here, so as to occupy no registers in between
        state[0].pid_integral[field], state[0].pid_error[field] = (stored.pid_integral[field], stored.pid_error[field])
    for field in range(4):
        state[0].pid_mode[field] = stored.pid_mode[field]
    state[0].contacts, state[0].contacts_changed = stored.contacts, stored.contacts_changed
    now.state[lane] = state[0]
    for field in range(7):
        body[lanes.POSE + field] = pose[field]
    for field in range(6):
        body[lanes.MOTION + field] = motion[field]


def flying(nominal: Operand) -> Any:
    """Return the flight kernel for vehicles of `nominal` parameters, except for mass, inertia and thrust.

    Compile-time constants need no registers, and a flight uses as many as a thread can have.
    """
    tick_s, gravity, arm, keep = (
        float(nominal[name]) for name in ("tick_s", "gravity_m_s2", "rotor_arm_m", "rotor_keep")
    )
    drag, drag_floor = tuple(map(float, nominal["drag_factor_m2"])), float(nominal["drag_min_velocity_m_s"])
    ground, sea = float(nominal["ground_altitude_m"]), float(nominal["sea_density_kg_m3"])
    place_gain, speed_gain = (tuple(map(float, nominal["position_gain"])), tuple(map(float, nominal["velocity_gain"])))
    angle_gain, rate_gain = tuple(map(float, nominal["angle_gain"])), tuple(map(float, nominal["rate_gain"]))
    z_gain, z_keep = float(nominal["z_integral_gain"]), float(nominal["z_integral_keep"])
    velocity_limit, tilt_limit = float(nominal["velocity_limit_m_s"]), float(nominal["tilt_limit_rad"])
    rate_limit, min_throttle, min_mixed = (
        float(nominal[name]) for name in ("rate_limit_rad_s", "min_throttle", "min_mixed_throttle")
    )

    def fly(going, ticks, games, now, hull, threads):  # type: ignore[no-untyped-def]
        """Fly every lane that is `going` for `ticks` (L,), on copies in registers, so that no tick waits for memory.

        Each lane is flown by `threads` threads of a warp. They all compute the same flight, but share the solids of
        the collision test among them.
        """
        lane, mine = cuda.grid(1) // threads, cuda.laneid % threads
        if lane >= len(going) or going[lane] == 0 or ticks[lane] == 0:
            return
        game, mask = now.game[lane], mask_of(threads)
        watch = cuda.local.array(2, types.int64)
        own, state = cuda.local.array(1, PARAMETERS), cuda.local.array(1, FLIGHT)
        pose, motion = cuda.local.array(7, types.float64), cuda.local.array(6, types.float64)
        force, acceleration = cuda.local.array(6, types.float64), cuda.local.array(6, types.float64)
        own[0], state[0] = games.parameters[game], now.state[lane]
        own[0].full_pid = 0
        own[0].tick_s, own[0].gravity_m_s2, own[0].rotor_arm_m, own[0].rotor_keep = tick_s, gravity, arm, keep
        own[0].drag_min_velocity_m_s, own[0].ground_altitude_m, own[0].sea_density_kg_m3 = (drag_floor, ground, sea)
        own[0].z_integral_gain, own[0].z_integral_keep = z_gain, z_keep
        own[0].velocity_limit_m_s, own[0].tilt_limit_rad = velocity_limit, tilt_limit
        own[0].rate_limit_rad_s, own[0].min_throttle, own[0].min_mixed_throttle = (rate_limit, min_throttle, min_mixed)
        for axis in range(3):
            own[0].drag_factor_m2[axis], own[0].position_gain[axis] = drag[axis], place_gain[axis]
            own[0].velocity_gain[axis], own[0].angle_gain[axis] = speed_gain[axis], angle_gain[axis]
            own[0].rate_gain[axis] = rate_gain[axis]
        body = now.body[lane]
        for field in range(7):
            pose[field] = body[lanes.POSE + field]
        for field in range(6):
            motion[field] = body[lanes.MOTION + field]
        watch[NEXT_CHECK], watch[TOUCHED] = now.watch[lane, NEXT_CHECK], now.watch[lane, TOUCHED]
        parts = (pose, motion, force, acceleration)
        solids, count = around(games.solids, games.counts, game)
        cuda.syncwarp(mask)  # all have read before any writes
        fly_ticks(own[0], state[0], parts, (solids, count, hull, (mine, threads)), watch, ticks[lane], False)
        cuda.syncwarp(mask)
        if mine != 0:
            return
        store_flight(lane, watch, state, pose, motion, now)

    return fly


KERNELS = (*(_of_lanes(*each) for each in LAUNCHED.items()), deal_clutter, *views.KERNELS)
LIMITS = {"see": 72, "look": 64, "cast_depth": 64, "cast_colour": 80, "cast_gray": 64, "see_gray": 64}
"""Registers per thread: fewer of them let more threads wait for memory at the same time."""
SOURCES = sources(__name__)  # of which numba notices changes of this file and of kernels/cuda_views alone


def compiled(nominal: Operand) -> Any:
    """Return the kernels by name, compiled or from numba's cache; `nominal` is a record of PARAMETERS_DTYPE."""
    warnings.filterwarnings("ignore", message=".*under-utilization")  # expected with few lanes
    named = {each.__name__: stamped(each, SOURCES) for each in (*KERNELS, flying(nominal))}
    made = {name: cuda.jit(each, cache=True, max_registers=LIMITS.get(name)) for name, each in named.items()}
    return SimpleNamespace(**made)


def threads_a_lane(lanes: int, device: th.device) -> int:
    """Return the number of threads that fly one lane: as many as the GPU has capacity for, at most a warp."""
    capacity, threads = (th.cuda.get_device_properties(device).multi_processor_count * FLYING_WARPS * WARP, WARP)
    while threads > 1 and lanes * threads > capacity:
        threads //= 2
    return threads


def grid(threads: int, per_block: int) -> tuple[int, int, Any]:
    """Return a launch configuration on PyTorch's current stream: blocks, threads per block, stream."""
    return -(-threads // per_block), per_block, cuda.external_stream(th.cuda.current_stream().cuda_stream)


def in_each_lane(kernel: Any, which: th.Tensor, *arguments: Any) -> None:
    """Launch a kernel with one thread per lane (kernels/lane_clocks.LAUNCHED) for those in `which` (L,) uint8."""
    kernel[grid(len(which), FLYING_THREADS)](shared(which), arguments)


class SideStream:
    """A CUDA stream beside PyTorch's current one, for work that runs concurrently until it is joined."""

    def __init__(self, priority: int = 0) -> None:
        self._stream, self._follows = th.cuda.Stream(priority=priority), False

    @contextmanager
    def following(self) -> Iterator[None]:
        """Launch what is called within on this stream, after all earlier work of the current one."""
        self._stream.wait_stream(th.cuda.current_stream())
        self._follows = True
        with th.cuda.stream(self._stream):
            yield

    def join(self) -> None:
        """Let the current stream wait for this one, if it was used: a recording may not refer to an unused stream."""
        if self._follows:
            th.cuda.current_stream().wait_stream(self._stream)
        self._follows = False


def shared(tensor: th.Tensor, dtype: np.dtype[Any] | None = None) -> Any:
    """Return a tensor's memory as a numba array; with `dtype`, rows (n, bytes) of uint8 become n records."""
    array = cuda.as_cuda_array(tensor, sync=False)
    return array if dtype is None else array.view(dtype).reshape(tensor.shape[0])


def on_device(arrays: Operand, device: th.device) -> tuple[Any, Any]:
    """Copy a NamedTuple of arrays, nested or not, to the device; return it as tensors, and as numba arrays on them."""
    if not isinstance(arrays, np.ndarray):
        pairs = [on_device(array, device) for array in arrays]
        return type(arrays)(*(pair[0] for pair in pairs)), type(arrays)(*(pair[1] for pair in pairs))
    if arrays.dtype.names:
        rows = np.ascontiguousarray(arrays).view(np.uint8).reshape(len(arrays), arrays.dtype.itemsize)
        tensor = th.from_numpy(rows.copy()).to(device)
        return tensor, shared(tensor, arrays.dtype)
    signed = SIGNED.get(arrays.dtype)
    tensor = th.from_numpy(np.ascontiguousarray(arrays if signed is None else arrays.view(signed))).to(device)
    return tensor, shared(tensor) if signed is None else shared(tensor).view(arrays.dtype)
