"""Lanes on one GPU: the same functions as CUDA kernels, through numba-cuda.

A thread flies a lane, a thread settles what a column of its picture shows, and a thread draws and sees 4 x 2 pixels.
Everything stays on the device; kernels are launched on PyTorch's stream, so that a round of them can be recorded as a
CUDA graph. numba-cuda has no switch for fused multiply-adds: flights differ from the CPU's in their last bits, events
do not (vision/rounding).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import torch as th
from numba import cuda, types
from numba.cuda import libdevice
from numba.cuda.extending import overload
from numba.np.numpy_support import from_dtype

from uavaccel.kernels import events, lanes
from uavaccel.kernels import fields as at
from uavaccel.kernels.columns import MOST_INTERVALS, MOST_PIECES, Column, add_interval, fill_column, settle
from uavaccel.kernels.faces import begin as begin_faces
from uavaccel.kernels.faces import view_of
from uavaccel.kernels.flight import NEXT_LOOK, TOUCHED, fly_ticks
from uavaccel.kernels.lanes import EVENT_SEED, PICTURE_SEED
from uavaccel.kernels.operands import Launchable, Operand
from uavaccel.kernels.project import project_solid
from uavaccel.kernels.quads import BELOW, RIGHT, quad_lumas, quick_count, see_plainly
from uavaccel.kernels.rays import colour_of, linear
from uavaccel.kernels.recording import recording
from uavaccel.kernels.touching import NOTHING, deepest_of_all, least_of_all
from uavaccel.sim.vehicle.quadrotor import FLIGHT_DTYPE, NEVER, PARAMETERS_DTYPE
from uavaccel.vision.dvs_kernels import count_double_pixel
from uavaccel.vision.noise import READ_NOISE, normal_block
from uavaccel.vision.observation import BLOCK_SIDE, NEUTRAL_LEVEL
from uavaccel.vision.rounding import times

BLOCK_ROWS, BLOCK_COLUMNS = at.ROWS // BLOCK_SIDE, at.COLUMNS // BLOCK_SIDE
BLOCKS = BLOCK_ROWS * BLOCK_COLUMNS
WARP, WHOLE_WARP = 32, 0xFFFFFFFF
FLYING_THREADS, COLUMN_THREADS, SEEING_THREADS = 32, 64, 128  # of a block of CUDA's
SEEING_THREADS_A_LANE, PIXELS_A_LANE = at.ROWS * at.COLUMNS // 8, np.uintp(at.ROWS * at.COLUMNS)
FLYING_WARPS = 2  # of a multiprocessor: a quarter of its registers, and room for who learns meanwhile
EAGER = 2  # times before work is recorded: what is compiled and chosen at first use
BOX_SLOTS, CYLINDER_SLOTS = 3, 6  # faces of a solid, at most (kernels/project)
SLOTS = 1 + CYLINDER_SLOTS * at.SOLIDS
RECORDS = {PARAMETERS_DTYPE: from_dtype(PARAMETERS_DTYPE), FLIGHT_DTYPE: from_dtype(FLIGHT_DTYPE)}
PARAMETERS, FLIGHT = RECORDS[PARAMETERS_DTYPE], RECORDS[FLIGHT_DTYPE]


@overload(times)
def _times(a, b):  # type: ignore[no-untyped-def]
    if a == types.float32 and b == types.float32:
        return lambda a, b: libdevice.fmul_rn(a, b)
    return lambda a, b: libdevice.dmul_rn(a, b)


def _due(log, base, positive, negative):  # type: ignore[no-untyped-def]
    of_type = quick_count if log == types.float32 else count_double_pixel
    return lambda log, base, positive, negative: of_type(log, base, positive, negative)


@cuda.jit(device=True)
def mask_of(threads):  # type: ignore[no-untyped-def]
    """The threads of a warp that fly this one's lane, as bits."""
    return (WHOLE_WARP >> (WARP - threads)) << (cuda.laneid // threads * threads)


@overload(least_of_all)
def _least_of_all(distance_m, threads):  # type: ignore[no-untyped-def]
    return _shuffled_least


@overload(deepest_of_all)
def _deepest_of_all(found, depth_m, threads):  # type: ignore[no-untyped-def]
    return _shuffled_deepest


def _shuffled_least(distance_m, threads):  # type: ignore[no-untyped-def]
    those, distance = mask_of(threads), threads // 2
    while distance > 0:
        distance_m = min(distance_m, cuda.shfl_xor_sync(those, distance_m, distance))
        distance //= 2
    return distance_m


def _shuffled_deepest(found, depth_m, threads):  # type: ignore[no-untyped-def]
    those, distance = mask_of(threads), threads // 2
    while distance > 0:
        other, depth = (
            cuda.shfl_xor_sync(those, found, distance),
            cuda.shfl_xor_sync(those, depth_m, distance),
        )
        if depth < depth_m or (depth == depth_m and other > found):
            found, depth_m = other, depth
        distance //= 2
    return found


for _function, _chosen in events.BY_TYPE:
    overload(_function)(_due if _function is events.due else _chosen)


class Plan(NamedTuple):
    """What all lanes have in common: a command's, and what they are seen with."""

    hull: Operand
    texels: Operand
    textures: Operand
    looks: Operand
    sensor: Operand


def begin_lanes(renewed, rows, games, now):  # type: ignore[no-untyped-def]
    """Let each lane that is `renewed` (L,) begin the game of its row."""
    lane = cuda.grid(1)
    if lane < len(renewed) and renewed[lane] != 0:
        game = rows[lane]
        lanes.begin(lane, game, games, now)
        lanes.look(games.parameters[game], now.state[lane], now.body[lane])


def command_lanes(going, directions, games, now):  # type: ignore[no-untyped-def]
    """Let each lane that is `going` (L,) take its direction (L, 3)."""
    lane = cuda.grid(1)
    if lane < len(going) and going[lane] != 0:
        lanes.command(lane, directions, games, now)


@cuda.jit(device=True, inline="always")
def put_down(lane, watch, state, pose, motion, now):  # type: ignore[no-untyped-def]
    """Where a lane has flown to, out of registers; forces and accelerations are each tick's own (flight.short_step)."""
    now.watch[lane, NEXT_LOOK], now.watch[lane, TOUCHED] = watch[NEXT_LOOK], watch[TOUCHED]
    there, body = now.state[lane], now.body[lane]
    for field in range(9):  # not used here, and read again so that no register keeps them from tick to tick
        state[0].pid_integral[field], state[0].pid_error[field] = (
            there.pid_integral[field],
            there.pid_error[field],
        )
    for field in range(4):
        state[0].pid_mode[field] = there.pid_mode[field]
    state[0].contacts, state[0].contacts_changed = there.contacts, there.contacts_changed
    now.state[lane] = state[0]
    for field in range(7):
        body[lanes.POSE + field] = pose[field]
    for field in range(6):
        body[lanes.MOTION + field] = motion[field]


def flying(usual: Operand) -> Any:
    """The kernel that flies, for vehicles whose parameters are the `usual` ones but for mass, inertia and thrust.

    What is known when it is compiled needs no registers, of which a flight takes all that a thread can have.
    """
    tick_s, gravity, arm, keep = (
        float(usual[name]) for name in ("tick_s", "gravity_m_s2", "rotor_arm_m", "rotor_keep")
    )
    drag, slow = tuple(map(float, usual["drag_factor_m2"])), float(usual["drag_min_velocity_m_s"])
    ground, sea = float(usual["ground_altitude_m"]), float(usual["sea_density_kg_m3"])
    place_gain, speed_gain = (
        tuple(map(float, usual["position_gain"])),
        tuple(map(float, usual["velocity_gain"])),
    )
    angle_gain, rate_gain = tuple(map(float, usual["angle_gain"])), tuple(map(float, usual["rate_gain"]))
    gather, remember = float(usual["z_integral_gain"]), float(usual["z_integral_keep"])
    fastest, steepest = float(usual["velocity_limit_m_s"]), float(usual["tilt_limit_rad"])
    turning, least, least_mixed = (
        float(usual[name]) for name in ("rate_limit_rad_s", "min_throttle", "min_mixed_throttle")
    )

    def fly_lanes(going, ticks, games, now, hull, threads):  # type: ignore[no-untyped-def]
        """Fly so many ticks, (L,), from copies in registers: a lane's ticks wait for nothing but one another.

        So many `threads` of a warp fly a lane, all of them the same; they share in looking at what stands around it.
        """
        lane, mine = cuda.grid(1) // threads, cuda.laneid % threads
        if lane >= len(going) or going[lane] == 0 or ticks[lane] == 0:
            return
        game, those = now.game[lane], mask_of(threads)
        watch = cuda.local.array(2, types.int64)
        own, state = cuda.local.array(1, PARAMETERS), cuda.local.array(1, FLIGHT)
        pose, motion = cuda.local.array(7, types.float64), cuda.local.array(6, types.float64)
        force, acceleration = cuda.local.array(6, types.float64), cuda.local.array(6, types.float64)
        own[0], state[0] = games.parameters[game], now.state[lane]
        own[0].full_pid = 0
        own[0].tick_s, own[0].gravity_m_s2, own[0].rotor_arm_m, own[0].rotor_keep = tick_s, gravity, arm, keep
        own[0].drag_min_velocity_m_s, own[0].ground_altitude_m, own[0].sea_density_kg_m3 = slow, ground, sea
        own[0].z_integral_gain, own[0].z_integral_keep = gather, remember
        own[0].velocity_limit_m_s, own[0].tilt_limit_rad = fastest, steepest
        own[0].rate_limit_rad_s, own[0].min_throttle, own[0].min_mixed_throttle = turning, least, least_mixed
        for axis in range(3):
            own[0].drag_factor_m2[axis], own[0].position_gain[axis] = drag[axis], place_gain[axis]
            own[0].velocity_gain[axis], own[0].angle_gain[axis] = speed_gain[axis], angle_gain[axis]
            own[0].rate_gain[axis] = rate_gain[axis]
        body = now.body[lane]
        for field in range(7):
            pose[field] = body[lanes.POSE + field]
        for field in range(6):
            motion[field] = body[lanes.MOTION + field]
        watch[NEXT_LOOK], watch[TOUCHED] = now.watch[lane, NEXT_LOOK], now.watch[lane, TOUCHED]
        parts = (pose, motion, force, acceleration)
        solids, count = games.solids[game], games.counts[game]
        cuda.syncwarp(those)  # read before one of them writes
        fly_ticks(own[0], state[0], parts, solids, count, hull, watch, ticks[lane], False, (mine, threads))
        cuda.syncwarp(those)
        if mine != 0:
            return
        put_down(lane, watch, state, pose, motion, now)

    return fly_lanes


def project_lanes(going, sky, looks, games, now, faces):  # type: ignore[no-untyped-def]
    """Project what each lane that is `going` sees: faces (L, SLOTS, FIELDS), a thread and slots of its own a solid."""
    thread = cuda.grid(1)
    lane, solid = thread // WARP, thread % WARP
    if lane >= len(going) or going[lane] == 0:
        return
    state, game = now.state[lane], now.game[lane]
    solids, count = games.scenes.solids[game], games.scenes.counts[game]
    view = view_of(looks.camera, state.position, state.quaternion)
    if solid == 0:
        begin_faces(looks.camera, view, faces[lane])
        faces[lane, 0, at.COUNT] = np.float32(first_slot(solids, count))
    while solid < count:
        first, beyond = first_slot(solids, solid), first_slot(solids, solid + 1)
        for slot in range(first, beyond):
            faces[lane, slot, at.NEAREST_W] = np.float32(0.0)
        project_solid(looks, games.scenes, game, solid, view, sky, faces[lane], first)
        solid += WARP


@cuda.jit(device=True)
def first_slot(solids, solid):  # type: ignore[no-untyped-def]
    """Where a solid's faces begin: as many before as the solids before it have at most."""
    slot = 1
    for before in range(solid):
        slot += CYLINDER_SLOTS if solids[before, at.KIND] == at.CYLINDER else BOX_SLOTS
    return slot


def find_shown(going, faces, shown):  # type: ignore[no-untyped-def]
    """The face of each pixel, (L, 144, 256) int16, of the lanes that are `going`: a thread a column.

    The threads of a warp have columns beside each other: each looks at other faces for all of them.
    """
    thread, thread_place = cuda.grid(1), np.uintp(cuda.threadIdx.x)
    lane, column = thread // at.COLUMNS, np.int32(thread % at.COLUMNS)
    room = Column(
        cuda.shared.array((MOST_INTERVALS, COLUMN_THREADS), types.int32),
        cuda.shared.array((MOST_INTERVALS, COLUMN_THREADS), types.float32),
        cuda.shared.array((MOST_INTERVALS, COLUMN_THREADS), types.float32),
        cuda.shared.array((MOST_PIECES, COLUMN_THREADS), types.int32),
    )
    if lane >= len(going) or going[lane] == 0:
        return
    own, mine, count = faces[lane], np.int32(cuda.laneid), np.int32(0)
    left, total = np.float32(column - mine), np.int32(own[0, at.COUNT])
    right = left + np.float32(WARP - 1)
    for first in range(1, total, WARP):
        face = np.int32(first + mine)
        found = face < total and own[face, at.NEAREST_W] > np.float32(0.0)
        found = found and own[face, at.FIRST_COLUMN] <= right and own[face, at.LAST_COLUMN] >= left
        those = np.int64(cuda.ballot_sync(WHOLE_WARP, found)) & WHOLE_WARP
        while those != 0:
            face = np.int32(first + cuda.ffs(those) - 1)
            those &= those - 1
            count = add_interval(own, face, column, room, thread_place, count)
    settle(own[0, at.FAR_W], room, thread_place, count)
    fill_column(room, thread_place, shown[lane], np.uintp(column))


@cuda.jit(device=True)
def noisy_at(level, camera, seeds, moment_ns, value):  # type: ignore[no-untyped-def]
    """A grey level as a noisy camera reads it; `value` is its number in the picture."""
    seed, moment = np.uint64(seeds[PICTURE_SEED]), np.uint64(moment_ns)
    drawn = normal_block(seed, moment, READ_NOISE, value // BLOCK_SIDE)
    return events.noisy(level, np.float32(camera[events.READ]), drawn[value % BLOCK_SIDE])


@cuda.jit(device=True)
def camera_of(games, game):  # type: ignore[no-untyped-def]
    """A game's camera, in registers."""
    row = games.cameras[game]
    return row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9]


@cuda.jit(device=True)
def pixels_of_thread():  # type: ignore[no-untyped-def]
    """Lane, and the first row and column of the 4 x 2 pixels of a thread.

    A warp has 16 x 16 pixels, so that few of its threads see other faces than the rest; two threads beside each other
    have a block.
    """
    thread, threads = np.uint32(cuda.grid(1)), np.uint32(SEEING_THREADS_A_LANE)
    lane, place = np.uint32(thread // threads), np.uint32(thread % threads)
    tile, mine = np.uint32(place >> np.uint32(5)), np.uint32(place & np.uint32(31))
    y = np.int32(((tile >> np.uint32(4)) << np.uint32(4)) + ((mine >> np.uint32(3)) << np.uint32(2)))
    x = np.int32(((tile & np.uint32(15)) << np.uint32(4)) + ((mine & np.uint32(7)) << np.uint32(1)))
    return np.uintp(lane), y, x


@cuda.jit(device=True)
def grey_quad(faces, shown, first, plan, y, x):  # type: ignore[no-untyped-def]
    """Luma of a quad's pixels, the first of which is that of all lanes' (quads.see_plainly)."""
    those = (
        np.int32(shown[0, 0, first]),
        np.int32(shown[0, 0, first + RIGHT]),
        np.int32(shown[0, 0, first + BELOW]),
        np.int32(shown[0, 0, first + BELOW + RIGHT]),
    )
    return quad_lumas(faces, those, plan.texels, plan.textures, y, x)


@cuda.jit(device=True)
def noisy_quad(levels, camera, seeds, moment_ns, y, x):  # type: ignore[no-untyped-def]
    """A quad's levels as a noisy camera reads them."""
    value = y * at.COLUMNS + x
    return (
        np.int32(noisy_at(levels[0], camera, seeds, moment_ns, value)),
        np.int32(noisy_at(levels[1], camera, seeds, moment_ns, value + 1)),
        np.int32(noisy_at(levels[2], camera, seeds, moment_ns, value + at.COLUMNS)),
        np.int32(noisy_at(levels[3], camera, seeds, moment_ns, value + at.COLUMNS + 1)),
    )


def start_events(going, faces, shown, plan, games, now, pixels):  # type: ignore[no-untyped-def]
    """Show each lane that is `going` its first picture, which makes no events."""
    lane, y, x = pixels_of_thread()
    if lane >= np.uintp(len(going)) or going[lane] == 0:
        return
    game = now.game[lane]
    camera = camera_of(games, game)
    for half in range(2):
        top = np.int32(y + 2 * half)
        first = lane * PIXELS_A_LANE + np.uintp(top * at.COLUMNS + x)
        levels = grey_quad(faces[lane], shown, first, plan, top, x)
        if camera[events.READ] > 0.0:
            levels = noisy_quad(levels, camera, games.seeds[game], 0, top, x)
        begin_pixel(levels[0], camera, plan.sensor, pixels, lane, np.uintp(top), np.uintp(x))
        begin_pixel(levels[1], camera, plan.sensor, pixels, lane, np.uintp(top), np.uintp(x + 1))
        begin_pixel(levels[2], camera, plan.sensor, pixels, lane, np.uintp(top + 1), np.uintp(x))
        begin_pixel(levels[3], camera, plan.sensor, pixels, lane, np.uintp(top + 1), np.uintp(x + 1))
    if x % BLOCK_SIDE == 0:
        pixels.gathered[lane, np.uintp(y // BLOCK_SIDE), np.uintp(x // BLOCK_SIDE)] = 0
    if x == 0 and y == 0:
        pixels.clock[lane], pixels.time_s[lane] = 0, 0.0


@cuda.jit(device=True)
def begin_pixel(level, camera, sensor, pixels, lane, row, column):  # type: ignore[no-untyped-def]
    """What a pixel knows after its first picture."""
    log = sensor.logs[np.uint32(level)]
    pixels.base[lane, row, column] = log
    if pixels.filtered.size:
        pixels.filtered[lane, row, column] = log
    if pixels.last_s.size:
        pixels.last_s[lane, row, column] = -np.float32(camera[events.REFRACTORY])


@cuda.jit(device=True)
def noisy_pair(levels, camera, sensor, base, filtered, noise, y, x, dt_s):  # type: ignore[no-untyped-def]
    """Two pixels beside each other, of a camera with noise or a low-pass."""
    normals, draws = events.drawn(camera, noise[0], noise[1], (y * at.COLUMNS + x) // BLOCK_SIDE)
    later = x % BLOCK_SIDE != 0
    first = (normals[2], draws[2]) if later else (normals[0], draws[0])
    second = (normals[3], draws[3]) if later else (normals[1], draws[1])
    signed = events.see_pixel(levels[0], camera, sensor, base, filtered, first, y, x, dt_s)
    return signed + events.see_pixel(levels[1], camera, sensor, base, filtered, second, y, x + 1, dt_s)


@cuda.jit(device=True)
def is_plain(camera, pixels):  # type: ignore[no-untyped-def]
    """Whether a camera has neither noise nor a low-pass."""
    quiet = camera[events.LEAK] <= 0.0 and camera[events.SHOT] <= 0.0 and camera[events.HOT] <= 0.0
    return quiet and camera[events.READ] <= 0.0 and pixels.filtered.size == 0


@cuda.jit(device=True)
def gather(total, take, lane, y, x, pixels, frames):  # type: ignore[no-untyped-def]
    """Add the events of a thread, and of the one beside it, to their block; where `take`, they are a frame's."""
    total = np.int32(total + cuda.shfl_xor_sync(WHOLE_WARP, total, 1))
    if x % BLOCK_SIDE == 0:
        across, down = np.uintp(x // BLOCK_SIDE), np.uintp(y // BLOCK_SIDE)
        total = np.int32(total + pixels.gathered[lane, down, across])
        if take != 0:
            frames[lane, down, across] = events.level_of(total)
        pixels.gathered[lane, down, across] = 0 if take != 0 else total


def see_events(going, take, faces, shown, plan, games, now, pixels, frames):  # type: ignore[no-untyped-def]
    """Let plain event cameras see a picture; where `take`, events since the last time are a frame (L, 36, 64)."""
    lane, y, x = pixels_of_thread()
    if lane >= np.uintp(len(going)) or going[lane] == 0:
        return
    if now.watch[lane, TOUCHED] != NOTHING:
        if take != 0 and x % BLOCK_SIDE == 0:
            frames[lane, np.uintp(y // BLOCK_SIDE), np.uintp(x // BLOCK_SIDE)] = NEUTRAL_LEVEL
        return
    camera = camera_of(games, now.game[lane])
    if not is_plain(camera, pixels):
        return
    own, base, total = faces[lane], pixels.base, np.int32(0)
    for half in range(2):
        top = np.int32(y + 2 * half)
        place = np.uintp(np.uint32(top * at.COLUMNS + x))
        first = lane * PIXELS_A_LANE + place
        before = (base[0, 0, first], base[0, 0, first + RIGHT])
        under = (base[0, 0, first + BELOW], base[0, 0, first + BELOW + RIGHT])
        levels = grey_quad(own, shown, first, plan, top, x)
        total = np.int32(total + see_plainly(levels, before + under, camera, plan.sensor, base, first, place))
    gather(total, take, lane, y, x, pixels, frames)


def see_noise(going, tick_ns, take, faces, shown, plan, games, now, pixels, frames):  # type: ignore[no-untyped-def]
    """`see_events` for the cameras that have noise or a low-pass: a kernel of its own, as it takes more registers."""
    lane, y, x = pixels_of_thread()
    if lane >= np.uintp(len(going)) or going[lane] == 0 or now.watch[lane, TOUCHED] != NOTHING:
        return
    game = now.game[lane]
    camera, seeds = camera_of(games, game), games.seeds[game]
    if is_plain(camera, pixels):
        return
    base, total, moment_ns = pixels.base[lane], np.int32(0), now.state[lane].tick * tick_ns
    filtered = pixels.filtered[lane] if pixels.filtered.size else pixels.filtered[0:0, 0]
    dt_s, noise = moment_ns * events.NS - pixels.time_s[lane], (seeds[EVENT_SEED], pixels.clock[lane] + 1)
    for half in range(2):
        top = np.int32(y + 2 * half)
        first = lane * PIXELS_A_LANE + np.uintp(top * at.COLUMNS + x)
        levels = grey_quad(faces[lane], shown, first, plan, top, x)
        if camera[events.READ] > 0.0:
            levels = noisy_quad(levels, camera, seeds, moment_ns, top, x)
        total += noisy_pair(levels[0:2], camera, plan.sensor, base, filtered, noise, top, x, dt_s)
        total += noisy_pair(levels[2:4], camera, plan.sensor, base, filtered, noise, top + 1, x, dt_s)
    gather(np.int32(total), take, lane, y, x, pixels, frames)


def note_seen(going, tick_ns, now, pixels):  # type: ignore[no-untyped-def]
    """After `see_events`, once all blocks are done: the clock of each lane's camera."""
    lane = cuda.grid(1)
    if lane < len(going) and going[lane] != 0 and now.state[lane].collision_tick == NEVER:
        pixels.clock[lane] += 1
        pixels.time_s[lane] = now.state[lane].tick * tick_ns * events.NS


def show_lanes(going, kind, tick_ns, faces, shown, plan, games, now, frames):  # type: ignore[no-untyped-def]
    """Frames (L, channels, 36, 64) in colour or of depth: means of blocks of 4 x 4 pixels; blank after a touch."""
    thread = cuda.grid(1)
    lane, block = thread // BLOCKS, thread % BLOCKS
    if lane >= len(going) or going[lane] == 0:
        return
    across, down, state, game = block % BLOCK_COLUMNS, block // BLOCK_COLUMNS, now.state[lane], now.game[lane]
    free, camera, seeds = state.collision_tick == NEVER, camera_of(games, game), games.seeds[game]
    moment_ns, number, depth_sum = state.tick * tick_ns, BLOCK_SIDE**2, np.float32(0.0)
    red_sum = green_sum = blue_sum = 0
    for pixel in range(16):
        y, x = BLOCK_SIDE * down + pixel // BLOCK_SIDE, BLOCK_SIDE * across + pixel % BLOCK_SIDE
        face = np.int32(shown[lane, y, x])
        if kind == at.DEPTH:
            w = (
                linear(faces[lane], face, at.W, np.float32(x), np.float32(y))
                if face
                else faces[lane, 0, at.FAR_W]
            )
            depth_sum += min(np.float32(1.0) / w, at.SEEN_FAR_M)
        else:
            red, green, blue = colour_of(faces[lane], face, plan.texels, plan.textures, y, x)
            if camera[events.READ] > 0.0:
                value = 3 * (y * at.COLUMNS + x)
                red = noisy_at(int(red), camera, seeds, moment_ns, value)
                green = noisy_at(int(green), camera, seeds, moment_ns, value + 1)
                blue = noisy_at(int(blue), camera, seeds, moment_ns, value + 2)
            red_sum, green_sum, blue_sum = red_sum + red, green_sum + green, blue_sum + blue
    if kind == at.DEPTH:
        shade = round(depth_sum / np.float32(number) * np.float32(255.0 / 50.0))
        frames[lane, 0, down, across] = shade if free else 0
        return
    frames[lane, 0, down, across] = round(red_sum / number) if free else 0
    frames[lane, 1, down, across] = round(green_sum / number) if free else 0
    frames[lane, 2, down, across] = round(blue_sum / number) if free else 0


def add_grey(going, faces, shown, plan, sums):  # type: ignore[no-untyped-def]
    """Add the grey levels of each lane's picture to its first sum (L, 3) int64."""
    lane, y, x = pixels_of_thread()
    if lane >= np.uintp(len(going)) or going[lane] == 0:
        return
    total = np.int32(0)
    for half in range(2):
        top = np.int32(y + 2 * half)
        first = lane * PIXELS_A_LANE + np.uintp(top * at.COLUMNS + x)
        levels = grey_quad(faces[lane], shown, first, plan, top, x)
        total += np.int32(levels[0] + levels[1] + levels[2] + levels[3])
    for distance in (1, 2, 4, 8, 16):
        total += np.int32(cuda.shfl_xor_sync(WHOLE_WARP, total, distance))
    if cuda.laneid == 0:
        cuda.atomic.add(sums, (lane, 0), np.int64(total))


def add_colours(going, faces, shown, plan, sums):  # type: ignore[no-untyped-def]
    """Add red, green and blue of each lane's picture to its sums (L, 3) int64: a thread a column."""
    thread = cuda.grid(1)
    lane, column = thread // at.COLUMNS, thread % at.COLUMNS
    if lane >= len(going) or going[lane] == 0:
        return
    red_sum = green_sum = blue_sum = 0
    for row in range(at.ROWS):
        face = np.int32(shown[lane, row, column])
        red, green, blue = colour_of(faces[lane], face, plan.texels, plan.textures, row, column)
        red_sum, green_sum, blue_sum = red_sum + int(red), green_sum + int(green), blue_sum + int(blue)
    cuda.atomic.add(sums, (lane, 0), np.int64(red_sum))
    cuda.atomic.add(sums, (lane, 1), np.int64(green_sum))
    cuda.atomic.add(sums, (lane, 2), np.int64(blue_sum))


LIMITS: dict[Any, int] = {see_events: 72}
"""Registers a thread, so that enough of them wait for memory at the same time."""


class Kernels(NamedTuple):
    """What can be launched: each takes the arrays that its function has, one thread a lane or a block of pixels."""

    begin: Launchable
    command: Launchable
    fly: Launchable
    project: Launchable
    find: Launchable
    start: Launchable
    see: Launchable
    see_noise: Launchable
    note: Launchable
    show: Launchable
    add_grey: Launchable
    add_colours: Launchable


def compiled(usual: Operand) -> Kernels:
    """The kernels, from numba's cache if they are there, for vehicles of `usual` parameters, a record."""
    warnings.filterwarnings("ignore", message=".*under-utilization")  # few lanes leave a GPU idle: so be it
    functions = (
        begin_lanes,
        command_lanes,
        flying(usual),
        project_lanes,
        find_shown,
        start_events,
        see_events,
        see_noise,
        note_seen,
        show_lanes,
        add_grey,
        add_colours,
    )
    return Kernels(
        *(cuda.jit(function, cache=True, max_registers=LIMITS.get(function)) for function in functions)
    )


def threads_a_lane(lanes: int, device: th.device) -> int:
    """How many threads fly a lane: as many as the GPU has room for, but no more than a warp."""
    room, threads = th.cuda.get_device_properties(device).multi_processor_count * FLYING_WARPS * WARP, WARP
    while threads > 1 and lanes * threads > room:
        threads //= 2
    return threads


def grid(threads: int, per_block: int) -> tuple[int, int]:
    """Blocks, and threads of each."""
    return -(-threads // per_block), per_block


def stream() -> Any:
    """PyTorch's present stream, as numba launches on it."""
    return cuda.external_stream(th.cuda.current_stream().cuda_stream)


class SideStream:
    """A stream beside PyTorch's present one, for work that nothing there waits for until it is joined."""

    def __init__(self, priority: int = 0) -> None:
        self._stream, self._follows = th.cuda.Stream(priority=priority), False

    @contextmanager
    def following(self) -> Iterator[None]:
        """Launch within: it begins when what was launched before is done."""
        self._stream.wait_stream(th.cuda.current_stream())
        self._follows = True
        with th.cuda.stream(self._stream):
            yield

    def join(self) -> None:
        """What is launched next begins when it is done; a stream that followed nothing is no part of a recording."""
        if self._follows:
            th.cuda.current_stream().wait_stream(self._stream)
        self._follows = False


class Recorded:
    """Work that is the same calls on the same memory each time: done as it is at first, then as one CUDA graph."""

    def __init__(self, work: Callable[[], None]) -> None:
        self._work, self._eager = work, EAGER
        self._graph: th.cuda.CUDAGraph | None = None

    def __call__(self) -> None:
        if self._eager:
            self._eager -= 1
            self._work()
            return
        if self._graph is None:
            self._graph = th.cuda.CUDAGraph()
            with recording(self._graph):
                self._work()
        self._graph.replay()


def shared(tensor: th.Tensor, dtype: np.dtype[Any] | None = None) -> Any:
    """A tensor's memory as an array of numba's; rows (n, bytes) of uint8 as n records of `dtype`."""
    array = cuda.as_cuda_array(tensor, sync=False)
    return array if dtype is None else array.view(dtype).reshape(tensor.shape[0])


def on_device(arrays: Operand, device: th.device) -> tuple[Any, Any]:
    """A NamedTuple of arrays, nested ones too, copied to the device: of tensors, and of the same memory for numba."""
    if not isinstance(arrays, np.ndarray):
        pairs = [on_device(each, device) for each in arrays]
        return type(arrays)(*(pair[0] for pair in pairs)), type(arrays)(*(pair[1] for pair in pairs))
    if arrays.dtype.names:
        rows = np.ascontiguousarray(arrays).view(np.uint8).reshape(len(arrays), arrays.dtype.itemsize)
        tensor = th.from_numpy(rows.copy()).to(device)
        return tensor, shared(tensor, arrays.dtype)
    plain = arrays.view(np.int32) if arrays.dtype == np.uint32 else arrays
    tensor = th.from_numpy(np.ascontiguousarray(plain)).to(device)
    return tensor, shared(tensor).view(np.uint32) if arrays.dtype == np.uint32 else shared(tensor)
