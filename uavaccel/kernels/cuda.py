"""Lanes on one GPU: the same functions as CUDA kernels, through numba-cuda.

A thread flies a lane, and a thread draws and sees a block of 4 x 4 pixels. Everything stays on the device; kernels are
launched on PyTorch's stream, so that a round of them can be recorded as a CUDA graph. numba-cuda has no switch for
fused multiply-adds: flights differ from the CPU's in their last bits, events do not (vision/rounding).
"""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
import torch as th
from numba import cuda, types
from numba.core.errors import NumbaPerformanceWarning
from numba.cuda import libdevice
from numba.cuda.extending import overload
from numba.np.numpy_support import from_dtype

from uavaccel.kernels import events, lanes
from uavaccel.kernels import fields as at
from uavaccel.kernels.cpu import DEPTH, NS, SEEN_FAR_M
from uavaccel.kernels.flight import fly_ticks
from uavaccel.kernels.lanes import EVENT_SEED, PICTURE_SEED
from uavaccel.kernels.faces import begin as begin_faces
from uavaccel.kernels.faces import view_of
from uavaccel.kernels.project import project_solid
from uavaccel.kernels.rays import colour_of, covers, linear, quad_lumas, touches
from uavaccel.sim.quadrotor import FLIGHT_DTYPE, NEVER, PARAMETERS_DTYPE
from uavaccel.vision.noise import READ_NOISE, normal_block
from uavaccel.vision.observation import BLOCK_SIDE, NEUTRAL_LEVEL
from uavaccel.vision.rounding import times

BLOCK_ROWS, BLOCK_COLUMNS = at.ROWS // BLOCK_SIDE, at.COLUMNS // BLOCK_SIDE
BLOCKS = BLOCK_ROWS * BLOCK_COLUMNS
FLYING_THREADS, SEEING_THREADS = 32, 128  # of a block of CUDA's
WARP, WHOLE_WARP = 32, 0xFFFFFFFF
SLOTS_PER_SOLID = 6  # faces of a solid, at most (kernels/project)
SLOTS = 1 + SLOTS_PER_SOLID * at.SOLIDS
MOST_CANDIDATES = 48  # faces that a block of pixels chooses among; what is left out is farther than those
RECORDS = {PARAMETERS_DTYPE: from_dtype(PARAMETERS_DTYPE), FLIGHT_DTYPE: from_dtype(FLIGHT_DTYPE)}
PARAMETERS, FLIGHT = RECORDS[PARAMETERS_DTYPE], RECORDS[FLIGHT_DTYPE]


@overload(times)
def _times(a, b):  # type: ignore[no-untyped-def]
    if a == types.float32 and b == types.float32:
        return lambda a, b: libdevice.fmul_rn(a, b)
    return lambda a, b: libdevice.dmul_rn(a, b)


for _function, _chosen in events.BY_TYPE:
    overload(_function)(_chosen)


class Plan(NamedTuple):
    """What all lanes have in common: a command's, and what they are seen with."""

    hull: Any
    texels: Any
    textures: Any
    looks: Any
    sensor: Any


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


def fly_lanes(going, ticks, games, now, hull):  # type: ignore[no-untyped-def]
    """Fly so many ticks, (L,), from copies in registers: a lane's ticks wait for one another, and for nothing else."""
    lane = cuda.grid(1)
    if lane >= len(going) or going[lane] == 0 or ticks[lane] == 0:
        return
    game = now.game[lane]
    parameters, state = cuda.local.array(1, PARAMETERS), cuda.local.array(1, FLIGHT)
    pose, motion = cuda.local.array(7, types.float64), cuda.local.array(6, types.float64)
    force, acceleration = cuda.local.array(6, types.float64), cuda.local.array(6, types.float64)
    parameters[0], state[0] = games.parameters[game], now.state[lane]
    parameters[0].full_pid = 0  # nobody sets gains here: the compiler leaves out what would serve them
    body = now.body[lane]
    for field in range(7):
        pose[field] = body[lanes.POSE + field]
    for field in range(6):
        motion[field], force[field] = body[lanes.MOTION + field], body[lanes.FORCE + field]
        acceleration[field] = body[lanes.ACCELERATION + field]
    fly_ticks(
        parameters[0],
        state[0],
        (pose, motion, force, acceleration),
        games.solids[game],
        games.counts[game],
        hull,
        now.watch[lane],
        ticks[lane],
        False,
    )
    now.state[lane] = state[0]
    for field in range(7):
        body[lanes.POSE + field] = pose[field]
    for field in range(6):
        body[lanes.MOTION + field], body[lanes.FORCE + field] = motion[field], force[field]
        body[lanes.ACCELERATION + field] = acceleration[field]


def project_lanes(going, sky, looks, games, now, faces):  # type: ignore[no-untyped-def]
    """Project what each lane that is `going` sees: faces (L, SLOTS, FIELDS), a thread and slots of its own a solid."""
    thread = cuda.grid(1)
    lane, solid = thread // WARP, thread % WARP
    if lane >= len(going) or going[lane] == 0:
        return
    state, game = now.state[lane], now.game[lane]
    view = view_of(looks.camera, state.position, state.quaternion)
    if solid == 0:
        begin_faces(looks.camera, view, faces[lane])
        faces[lane, 0, at.COUNT] = np.float32(1 + SLOTS_PER_SOLID * games.scenes.counts[game])
    while solid < games.scenes.counts[game]:
        first = 1 + SLOTS_PER_SOLID * solid
        for slot in range(SLOTS_PER_SOLID):
            faces[lane, first + slot, at.NEAREST_W] = np.float32(0.0)
        project_solid(looks, games.scenes, game, solid, view, sky, faces[lane], first)
        solid += WARP


@cuda.jit(device=True)
def choose(faces, y, x, chosen):  # type: ignore[no-untyped-def]
    """The faces that a block of 4 x 4 pixels may show; how many.

    The threads of a warp have blocks beside each other: each looks at other faces for all of them, then at those found
    for itself.
    """
    count, end, place = 0, BLOCK_SIDE - 1, cuda.laneid
    row0, row1, column0, column1 = np.float32(y), np.float32(y + end), np.float32(x), np.float32(x + end)
    left = np.float32(x - BLOCK_SIDE * place)
    right, total = left + np.float32(BLOCK_SIDE * WARP - 1), int(faces[0, at.COUNT])
    for first in range(1, total, WARP):
        face = first + place
        found = face < total and touches(faces, face, row0, row1, left, right)
        those = np.int64(cuda.ballot_sync(WHOLE_WARP, found)) & WHOLE_WARP
        while those != 0:
            lowest = cuda.ffs(those) - 1
            those &= those - 1
            face = first + lowest
            beside = faces[face, at.FIRST_COLUMN] <= column1 and faces[face, at.LAST_COLUMN] >= column0
            if beside and count < MOST_CANDIDATES and touches(faces, face, row0, row1, column0, column1):
                chosen[count] = face
                count += 1
    return count


@cuda.jit(device=True)
def nearest(faces, chosen, count, row, column):  # type: ignore[no-untyped-def]
    """The face that a pixel shows, of those chosen; 0 for the sky (rays.nearest_face)."""
    x, y = np.float32(column), np.float32(row)
    near, best, shown = faces[0, at.NEAR_W], faces[0, at.FAR_W], 0
    for number in range(count):
        face = chosen[number]
        w = linear(faces, face, at.W, x, y)
        if w > best and w <= near and covers(faces, face, x, y, w):
            best, shown = w, face
    return shown


@cuda.jit(device=True)
def two_rows(faces, chosen, count, plan, camera, seeds, moment_ns, y, x):  # type: ignore[no-untyped-def]
    """Luma of two rows of four pixels, as a noisy camera reads them."""
    texels, textures = plan.texels, plan.textures
    a, b, c, d = quad_lumas(faces, chosen, count, texels, textures, y, x)
    e, f, g, h = quad_lumas(faces, chosen, count, texels, textures, y, x + 2)
    upper, lower = (int(a), int(b), int(e), int(f)), (int(c), int(d), int(g), int(h))
    if camera[events.READ] > 0.0:
        block, sigma, seed = (y * at.COLUMNS + x) // BLOCK_SIDE, camera[events.READ], seeds[PICTURE_SEED]
        upper = events.read_noise(upper, sigma, seed, moment_ns, block)
        lower = events.read_noise(lower, sigma, seed, moment_ns, block + BLOCK_COLUMNS)
    return upper, lower


def start_events(going, faces, plan, games, now, pixels):  # type: ignore[no-untyped-def]
    """Show each lane that is `going` its first picture, which makes no events."""
    thread = cuda.grid(1)
    lane, block = thread // BLOCKS, thread % BLOCKS
    if lane >= len(going) or going[lane] == 0:
        return
    y, x = BLOCK_SIDE * (block // BLOCK_COLUMNS), BLOCK_SIDE * (block % BLOCK_COLUMNS)
    chosen, game = cuda.local.array(MOST_CANDIDATES, types.int32), now.game[lane]
    count = choose(faces[lane], y, x, chosen)
    for row in range(y, y + BLOCK_SIDE, 2):
        both = two_rows(faces[lane], chosen, count, plan, games.cameras[game], games.seeds[game], 0, row, x)
        for line in range(2):
            for place in range(BLOCK_SIDE):
                log = plan.sensor.logs[both[line][place]]
                pixels.base[lane, row + line, x + place] = log
                if pixels.filtered.size:
                    pixels.filtered[lane, row + line, x + place] = log
                if pixels.last_s.size:
                    dead_s = games.cameras[game, events.REFRACTORY]
                    pixels.last_s[lane, row + line, x + place] = -np.float32(dead_s)
    pixels.gathered[lane, block // BLOCK_COLUMNS, block % BLOCK_COLUMNS] = 0
    if block == 0:
        pixels.clock[lane], pixels.time_s[lane] = 0, 0.0


def see_events(going, tick_ns, take, faces, plan, games, now, pixels, frames):  # type: ignore[no-untyped-def]
    """Let the event cameras see a picture; where `take`, their events since the last time are a frame (L, 36, 64)."""
    thread = cuda.grid(1)
    lane, block = thread // BLOCKS, thread % BLOCKS
    if lane >= len(going) or going[lane] == 0:
        return
    across, down = block % BLOCK_COLUMNS, block // BLOCK_COLUMNS
    y, x, state, game = BLOCK_SIDE * down, BLOCK_SIDE * across, now.state[lane], now.game[lane]
    if state.collision_tick != NEVER:
        if take != 0:
            frames[lane, down, across] = NEUTRAL_LEVEL
        return
    chosen, camera, seeds = cuda.local.array(MOST_CANDIDATES, types.int32), games.cameras[game], games.seeds[game]
    count, moment_ns = choose(faces[lane], y, x, chosen), state.tick * tick_ns
    noise, dt_s = (seeds[EVENT_SEED], pixels.clock[lane] + 1), moment_ns * NS - pixels.time_s[lane]
    filtered = pixels.filtered[lane] if pixels.filtered.size else pixels.filtered[0:0, 0]
    total = pixels.gathered[lane, down, across]
    for row in range(y, y + BLOCK_SIDE, 2):
        upper, lower = two_rows(faces[lane], chosen, count, plan, camera, seeds, moment_ns, row, x)
        total += events.see(upper, camera, plan.sensor, pixels.base[lane], filtered, noise, row, x, dt_s)
        total += events.see(lower, camera, plan.sensor, pixels.base[lane], filtered, noise, row + 1, x, dt_s)
    if take != 0:
        frames[lane, down, across] = events.level_of(total)
        total = 0
    pixels.gathered[lane, down, across] = total


def note_seen(going, tick_ns, now, pixels):  # type: ignore[no-untyped-def]
    """After `see_events`, once all blocks are done: the clock of each lane's camera."""
    lane = cuda.grid(1)
    if lane < len(going) and going[lane] != 0 and now.state[lane].collision_tick == NEVER:
        pixels.clock[lane] += 1
        pixels.time_s[lane] = now.state[lane].tick * tick_ns * NS


@cuda.jit(device=True)
def mean_colour(faces, chosen, count, plan, camera, seeds, moment_ns, y, x, channel):  # type: ignore[no-untyped-def]
    """One channel's mean over a block of 4 x 4 pixels, of pictures as a noisy camera reads them."""
    total = 0
    for row in range(y, y + BLOCK_SIDE):
        for column in range(x, x + BLOCK_SIDE):
            face = nearest(faces, chosen, count, row, column)
            colour = colour_of(faces, face, plan.texels, plan.textures, row, column)
            level = int(colour[channel])
            if camera[events.READ] > 0.0:
                value = 3 * (row * at.COLUMNS + column) + channel
                seed, moment = np.uint64(seeds[PICTURE_SEED]), np.uint64(moment_ns)
                drawn = normal_block(seed, moment, READ_NOISE, value // BLOCK_SIDE)
                level = events.noisy(level, np.float32(camera[events.READ]), drawn[value % BLOCK_SIDE])
            total += level
    return int(round(total / BLOCK_SIDE**2))


@cuda.jit(device=True)
def mean_depth(faces, chosen, count, y, x):  # type: ignore[no-untyped-def]
    """A block's mean depth, 0 to SEEN_FAR_M as 0 to 255."""
    total = np.float32(0.0)
    for row in range(y, y + BLOCK_SIDE):
        for column in range(x, x + BLOCK_SIDE):
            face = nearest(faces, chosen, count, row, column)
            w = linear(faces, face, at.W, np.float32(column), np.float32(row)) if face else faces[0, at.FAR_W]
            total += min(np.float32(1.0) / w, SEEN_FAR_M)
    return int(round(total / np.float32(BLOCK_SIDE**2) * np.float32(255.0 / 50.0)))


def show_lanes(going, kind, tick_ns, faces, plan, games, now, frames):  # type: ignore[no-untyped-def]
    """Frames (L, channels, 36, 64) in colour or of depth; blank after a touch."""
    thread = cuda.grid(1)
    lane, block = thread // BLOCKS, thread % BLOCKS
    if lane >= len(going) or going[lane] == 0:
        return
    across, down, state, game = block % BLOCK_COLUMNS, block // BLOCK_COLUMNS, now.state[lane], now.game[lane]
    y, x, free = BLOCK_SIDE * down, BLOCK_SIDE * across, state.collision_tick == NEVER
    chosen = cuda.local.array(MOST_CANDIDATES, types.int32)
    count = choose(faces[lane], y, x, chosen)
    if kind == DEPTH:
        frames[lane, 0, down, across] = mean_depth(faces[lane], chosen, count, y, x) if free else 0
        return
    camera, seeds, moment_ns = games.cameras[game], games.seeds[game], state.tick * tick_ns
    for channel in range(3):
        level = mean_colour(faces[lane], chosen, count, plan, camera, seeds, moment_ns, y, x, channel) if free else 0
        frames[lane, channel, down, across] = level


class Kernels(NamedTuple):
    """What can be launched: each takes the arrays that its function has, one thread a lane or a block of pixels."""

    begin: Any
    command: Any
    fly: Any
    project: Any
    start: Any
    see: Any
    note: Any
    show: Any


def compiled() -> Kernels:
    """The kernels, from numba's cache if they are there. Raises UserError where there is no GPU, or no numba-cuda."""
    warnings.filterwarnings("ignore", category=NumbaPerformanceWarning)  # few lanes leave a GPU idle: so be it
    functions = (
        begin_lanes,
        command_lanes,
        fly_lanes,
        project_lanes,
        start_events,
        see_events,
        note_seen,
        show_lanes,
    )
    return Kernels(*(cuda.jit(function, cache=True) for function in functions))


def stream() -> Any:
    """PyTorch's present stream, as numba launches on it."""
    return cuda.external_stream(th.cuda.current_stream().cuda_stream)


def shared(tensor: th.Tensor, dtype: np.dtype[Any] | None = None) -> Any:
    """A tensor's memory as an array of numba's; rows (n, bytes) of uint8 as n records of `dtype`."""
    array = cuda.as_cuda_array(tensor, sync=False)
    return array if dtype is None else array.view(dtype).reshape(tensor.shape[0])


def on_device(arrays: Any, device: th.device) -> tuple[Any, Any]:
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
