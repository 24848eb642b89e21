"""Cameras of lanes on one GPU, as CUDA kernels; in all of them `going` (L,) says which lanes observe.

In the lane's pictures one thread resolves visibility in a column, and one shades 4 x 2 pixels; in other scenes a thread
casts a pixel's ray. Event cameras see gray pictures of either; those of the lane without noise compute events at once.
"""

from __future__ import annotations

import numpy as np
from numba import cuda, types
from numba.cuda.extending import overload

from uavaccel.kernels import casting, events, tiles
from uavaccel.kernels import fields as at
from uavaccel.kernels.faces import begin as begin_faces
from uavaccel.kernels.faces import project_solid, view_of
from uavaccel.kernels.lanes import EVENT_SEED, PICTURE_SEED
from uavaccel.kernels.quads import (
    BELOW,
    MOST_INTERVALS,
    MOST_PIECES,
    RIGHT,
    Column,
    add_interval,
    fill_column,
    quad_lumas,
    quick_count,
    settle,
    update_quad,
)
from uavaccel.kernels.rays import ONE, colour_of, linear
from uavaccel.kernels.scene import world_of
from uavaccel.sim.camera.pixels import luma_of
from uavaccel.sim.vehicle.quadrotor import NEVER
from uavaccel.vision.dvs_kernels import count_double_pixel, signed_count
from uavaccel.vision.dvs_sensor import BLOCK_SIDE, NEUTRAL_LEVEL
from uavaccel.vision.noise import READ_NOISE, normal_block

BLOCK_ROWS, BLOCK_COLUMNS = at.ROWS // BLOCK_SIDE, at.COLUMNS // BLOCK_SIDE
BLOCKS = BLOCK_ROWS * BLOCK_COLUMNS
WARP, WHOLE_WARP = 32, 0xFFFFFFFF
COLUMN_THREADS, SEEING_THREADS = 64, 128  # per thread block
SEEING_THREADS_A_LANE, PIXELS_A_LANE = at.ROWS * at.COLUMNS // 8, np.uintp(at.ROWS * at.COLUMNS)
DEALING_THREADS = 128  # of a world of clutter, or of what a camera may see
STEP_ENDS = tiles.STEPS + 1
BOX_SLOTS, CYLINDER_SLOTS = 3, 6  # largest number of rows that a solid fills (kernels/faces)
SLOTS = 1 + CYLINDER_SLOTS * at.SOLIDS
LEVELS_A_M = np.float32(255.0) / at.SEEN_FAR_M


def _signed_count(log, base, positive, negative):  # type: ignore[no-untyped-def]
    function = quick_count if log == types.float32 else count_double_pixel
    return lambda log, base, positive, negative: function(log, base, positive, negative)


@overload(events.raise_to)
def _raise_in_turn(numbers, place, least):  # type: ignore[no-untyped-def]
    return lambda numbers, place, least: cuda.atomic.max(numbers, place, least)


for _function, _chosen in events.BY_TYPE:
    overload(_function)(_signed_count if _function is signed_count else _chosen)


@cuda.jit(device=True)
def sum_counts(mine, start, cells):  # type: ignore[no-untyped-def]
    """Turn counts of shapes into the ends of cells; `start` has one more place, for the number of all."""
    sums = cuda.shared.array(DEALING_THREADS, types.int32)
    share = (cells + DEALING_THREADS - 1) // DEALING_THREADS
    first, beyond = min(mine * share, cells), min((mine + 1) * share, cells)
    total = 0
    for cell in range(first, beyond):
        total += start[cell]
    sums[mine] = total
    cuda.syncthreads()
    before = 0
    for thread in range(mine):
        before += sums[thread]
    for cell in range(first, beyond):
        before += start[cell]
        start[cell] = before
    if mine == DEALING_THREADS - 1:
        start[cells] = before
    cuda.syncthreads()


def project(going, sky, appearance, games, now, faces):  # type: ignore[no-untyped-def]
    """Project the scene of every lane that is `going` to `faces` (L, SLOTS, FIELDS): one thread per solid."""
    thread = cuda.grid(1)
    lane, solid = thread // WARP, thread % WARP
    if lane >= len(going) or going[lane] == 0:
        return
    state, game = now.state[lane], now.game[lane]
    solids, count = games.scenes.solids[game], games.scenes.counts[game]
    view = view_of(appearance.camera, state.position, state.quaternion)
    if solid == 0:
        begin_faces(appearance.camera, view, faces[lane])
        faces[lane, 0, at.COUNT] = np.float32(first_slot(solids, count))
    while solid < count:
        first, beyond = first_slot(solids, solid), first_slot(solids, solid + 1)
        for slot in range(first, beyond):
            faces[lane, slot, at.NEAREST_W] = np.float32(0.0)
        project_solid(appearance, games.scenes, game, solid, view, sky, faces[lane], first)
        solid += WARP


@cuda.jit(device=True)
def first_slot(solids, solid):  # type: ignore[no-untyped-def]
    """Return the first slot of a solid: each solid before it reserves as many as its shape can fill."""
    slot = 1
    for before in range(solid):
        slot += CYLINDER_SLOTS if solids[before, at.KIND] == at.CYLINDER else BOX_SLOTS
    return slot


def find(going, faces, shown):  # type: ignore[no-untyped-def]
    """Find the visible face of each pixel, `shown` (L, 144, 256) int16, in the lanes that are `going`.

    One thread per column. The 32 threads of a warp have adjacent columns and test 32 faces at a time for all of them.
    """
    thread, thread_place = cuda.grid(1), np.uintp(cuda.threadIdx.x)
    lane, column = thread // at.COLUMNS, np.int32(thread % at.COLUMNS)
    scratch = Column(
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
        mask = np.int64(cuda.ballot_sync(WHOLE_WARP, found)) & WHOLE_WARP
        while mask != 0:
            face = np.int32(first + cuda.ffs(mask) - 1)
            mask &= mask - 1
            count = add_interval(own, face, column, scratch, thread_place, count)
    settle(own[0, at.FAR_W], scratch, thread_place, count)
    fill_column(scratch, thread_place, shown[lane], np.uintp(column))


@cuda.jit(device=True)
def noisy_at(level, camera, seeds, moment_ns, value):  # type: ignore[no-untyped-def]
    """Return a level with read noise; `value` is the index of the value in the image."""
    seed, moment = np.uint64(seeds[PICTURE_SEED]), np.uint64(moment_ns)
    drawn = normal_block(seed, moment, READ_NOISE, value // BLOCK_SIDE)
    return events.noisy(level, np.float32(camera[events.READ]), drawn[value % BLOCK_SIDE])


@cuda.jit(device=True)
def camera_of(games, game):  # type: ignore[no-untyped-def]
    """Return a game's camera parameters as scalars, which the compiler keeps in registers."""
    row = games.cameras[game]
    return row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9]


@cuda.jit(device=True)
def pixels_of_thread():  # type: ignore[no-untyped-def]
    """Return this thread's lane, and the first row and column of its 4 x 2 pixels.

    A warp covers 16 x 16 pixels, so that most of its threads see the same faces; two adjacent threads cover a block of
    4 x 4.
    """
    thread, threads = np.uint32(cuda.grid(1)), np.uint32(SEEING_THREADS_A_LANE)
    lane, place = np.uint32(thread // threads), np.uint32(thread % threads)
    tile, mine = np.uint32(place >> np.uint32(5)), np.uint32(place & np.uint32(31))
    y = np.int32(((tile >> np.uint32(4)) << np.uint32(4)) + ((mine >> np.uint32(3)) << np.uint32(2)))
    x = np.int32(((tile & np.uint32(15)) << np.uint32(4)) + ((mine & np.uint32(7)) << np.uint32(1)))
    return np.uintp(lane), y, x


@cuda.jit(device=True)
def grey_quad(faces, shown, first, looks, y, x):  # type: ignore[no-untyped-def]
    """Return the luma of a quad; `first` is its first pixel's index over all lanes (quads.update_quad)."""
    quad = (
        np.int32(shown[0, 0, first]),
        np.int32(shown[0, 0, first + RIGHT]),
        np.int32(shown[0, 0, first + BELOW]),
        np.int32(shown[0, 0, first + BELOW + RIGHT]),
    )
    return quad_lumas(faces, quad, looks.texels, looks.textures, y, x)


def draw_gray(going, faces, shown, looks, gray):  # type: ignore[no-untyped-def]
    """Write luma `gray` (L, 144, 256) uint8 of the lanes that are `going`."""
    lane, y, x = pixels_of_thread()
    if lane >= np.uintp(len(going)) or going[lane] == 0:
        return
    for half in range(2):
        top = np.int32(y + 2 * half)
        first = lane * PIXELS_A_LANE + np.uintp(top * at.COLUMNS + x)
        levels = grey_quad(faces[lane], shown, first, looks, top, x)
        gray[0, 0, first], gray[0, 0, first + RIGHT] = levels[0], levels[1]
        gray[0, 0, first + BELOW], gray[0, 0, first + BELOW + RIGHT] = levels[2], levels[3]


def see(going, take, faces, shown, looks, sensor, games, now, pixels, frames):  # type: ignore[no-untyped-def]
    """Compute the events of cameras without noise; if `take`, move the blocks' sums to `frames` (L, 36, 64).

    It does as `draw_gray`, `see_gray` and `take_frames` together, and writes no picture.
    """
    lane, y, x = pixels_of_thread()
    if lane >= np.uintp(len(going)) or going[lane] == 0:
        return
    if now.state[lane].collision_tick != NEVER:
        if take != 0 and x % BLOCK_SIDE == 0:
            frames[lane, np.uintp(y // BLOCK_SIDE), np.uintp(x // BLOCK_SIDE)] = NEUTRAL_LEVEL
        return
    camera, own, base, total = camera_of(games, now.game[lane]), faces[lane], pixels.base, np.int32(0)
    for half in range(2):
        top = np.int32(y + 2 * half)
        place = np.uintp(np.uint32(top * at.COLUMNS + x))
        first = lane * PIXELS_A_LANE + place
        before = (base[0, 0, first], base[0, 0, first + RIGHT])
        under = (base[0, 0, first + BELOW], base[0, 0, first + BELOW + RIGHT])
        levels = grey_quad(own, shown, first, looks, top, x)
        total = np.int32(total + update_quad(levels, before + under, camera, sensor, base, first, place))
    total = np.int32(total + cuda.shfl_xor_sync(WHOLE_WARP, total, 1))  # with the neighbour's, those of a block
    if x % BLOCK_SIDE == 0:
        across, down = np.uintp(x // BLOCK_SIDE), np.uintp(y // BLOCK_SIDE)
        total = np.int32(total + pixels.gathered[lane, down, across])
        if take != 0:
            frames[lane, down, across] = events.level_of(total)
        pixels.gathered[lane, down, across] = 0 if take != 0 else total


def show(going, kind, tick_ns, faces, shown, looks, games, now, frames):  # type: ignore[no-untyped-def]
    """Write colour or depth frames (L, channels, 36, 64), means over blocks of 4 x 4 pixels; 0 after a collision."""
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
            w = linear(faces[lane], face, at.W, np.float32(x), np.float32(y)) if face else faces[lane, 0, at.FAR_W]
            depth_sum += min(np.float32(1.0) / w, at.SEEN_FAR_M)
        else:
            red, green, blue = colour_of(faces[lane], face, looks.texels, looks.textures, y, x)
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


def add_colours(going, faces, shown, looks, sums):  # type: ignore[no-untyped-def]
    """Add red, green and blue of each lane's image to `sums` (L, 3) int64: one thread per column."""
    thread = cuda.grid(1)
    lane, column = thread // at.COLUMNS, thread % at.COLUMNS
    if lane >= len(going) or going[lane] == 0:
        return
    red_sum = green_sum = blue_sum = 0
    for row in range(at.ROWS):
        face = np.int32(shown[lane, row, column])
        red, green, blue = colour_of(faces[lane], face, looks.texels, looks.textures, row, column)
        red_sum, green_sum, blue_sum = red_sum + int(red), green_sum + int(green), blue_sum + int(blue)
    cuda.atomic.add(sums, (lane, 0), np.int64(red_sum))
    cuda.atomic.add(sums, (lane, 1), np.int64(green_sum))
    cuda.atomic.add(sums, (lane, 2), np.int64(blue_sum))


# --- still scenes -------------------------------------------------------------------------------------------------


@cuda.jit(device=True)
def pixel_of_thread(rows, columns):  # type: ignore[no-untyped-def]
    """Return this thread's lane, row and column; a warp has a tile, 8 x 4 pixels, whose rays stay together.

    As for all quotients here numbers are unsigned and of 32 bits: a division of 64 bits takes a hundred instructions.
    """
    tile, across = np.uint32(cuda.grid(1)) >> np.uint32(5), np.uint32((columns + tiles.TILE_COLUMNS - 1) >> 3)
    of_lane = across * np.uint32((rows + tiles.TILE_ROWS - 1) >> 2)
    lane = divided(tile, of_lane)
    place, mine = np.uint32(tile - lane * of_lane), np.uint32(cuda.laneid)
    down = divided(place, across)
    row, column = (down << 2) + (mine >> 3), ((place - down * across) << 3) + (mine & 7)
    return np.uintp(lane), np.uint32(row), np.uint32(column)


@cuda.jit(device=True)
def divided(number, by):  # type: ignore[no-untyped-def]
    """Return a quotient, rounded down, of numbers that are not negative."""
    return np.uint32(np.uint32(number) // np.uint32(by))


def look(going, size, looks, games, now, sight):  # type: ignore[no-untyped-def]
    """Write what the cameras of the lanes that are `going` may see to `sight`: DEALING_THREADS a lane. `size`: (2,)."""
    lane, mine = cuda.blockIdx.x, cuda.threadIdx.x
    if lane >= len(going) or going[lane] == 0:
        return
    state, scene = now.state[lane], games.scenes
    eye, world = casting.eye_of(looks.camera, state.position, state.quaternion), world_of(scene, now.game[lane])
    ends = cuda.shared.array(STEP_ENDS, types.int32)
    for step in range(mine, STEP_ENDS, DEALING_THREADS):
        ends[step] = 0
    cuda.syncthreads()
    for listing in range(2):
        for item in range(mine, scene.shapes.shape[1], DEALING_THREADS):
            shape = scene.shapes[world, item]
            covered = tiles.tiles_of(shape, looks.camera, eye, size)
            if covered < 0:
                continue
            step = tiles.step_of(shape, eye)
            place = cuda.atomic.add(ends, step, 1 - 2 * listing) - 1
            if listing:
                sight.items[lane, place], sight.tiles[lane, place] = item, covered
                sight.nears[lane, place] = np.float32(step) * tiles.STEP_M
        cuda.syncthreads()
        if listing == 0:
            sum_counts(mine, ends, tiles.STEPS)
            if mine == 0:
                sight.counts[lane] = ends[tiles.STEPS]
                casting.put_eye(sight.eyes[lane], eye)


@cuda.jit(device=True)
def first_met(scene, world, sight, lane, pixel, origin, direction, far_m):  # type: ignore[no-untyped-def]
    """Do as `casting.first_met` for this thread's ray, with the other rays of its warp, which are those of a tile."""
    met, first = (far_m, np.int32(casting.NOTHING)), np.uint32(0)
    mine, count = np.uint32(cuda.laneid), np.uint32(sight.counts[lane])
    down, across = np.uint32(pixel[0] >> np.uint32(2)), np.uint32(pixel[1] >> np.uint32(3))
    items, covered, nears, shapes = sight.items[lane], sight.tiles[lane], sight.nears[lane], scene.shapes[world]
    while first < count and cuda.any_sync(WHOLE_WARP, met[0] >= nears[first]):
        place = np.uint32(first + mine)
        mask = cuda.ballot_sync(WHOLE_WARP, place < count and tiles.covers(np.uint32(covered[place]), across, down))
        while mask != 0:
            place = np.uint32(first + np.uint32(cuda.ffs(mask) - 1))
            mask = np.int32(mask & (mask - 1))
            if met[0] >= nears[place]:
                item = items[place]
                shape = shapes[np.uint32(item)]
                met = casting.nearer(met, (casting.meet(scene, shape, origin, direction, met[0]), item))
        first = np.uint32(first + np.uint32(WARP))
    return met


@cuda.jit(device=True)
def summed(number, side):  # type: ignore[no-untyped-def]
    """Return the sum of a number over the `side` x `side` pixels, 1 or 4, of this thread's block, all in one tile."""
    if side > 1:
        for distance in (1, 2, 8, 16):
            number += cuda.shfl_xor_sync(WHOLE_WARP, number, distance)
    return number


def cast_depth(going, side, looks, games, now, sight, frames):  # type: ignore[no-untyped-def]
    """Write depth frames (L, 1, rows, columns), means of `side` x `side` pixels; 0 after a touch."""
    rows, columns = frames.shape[2] * side, frames.shape[3] * side
    lane, y, x = pixel_of_thread(rows, columns)
    if lane >= np.uintp(len(going)) or going[lane] == 0:
        return
    level, scene = 0, games.scenes
    if now.state[lane].collision_tick == NEVER:
        origin, axes, far_m = casting.get_eye(sight.eyes[lane])
        ray, scale = casting.ray_of(looks.camera, axes, y, x, rows, columns)
        far_m = far_m / scale if y < rows and x < columns else -ONE
        met = first_met(scene, world_of(scene, now.game[lane]), sight, lane, (y, x), origin, ray, far_m)
        depths = summed(min(met[0] * scale, at.SEEN_FAR_M), side)
        level = round(depths / np.float32(side * side) * LEVELS_A_M)
    if (y | x) & (side - 1) == 0 and y < rows and x < columns:
        frames[lane, 0, divided(y, side), divided(x, side)] = level


@cuda.jit(device=True)
def colour_of_thread(lane, y, x, size, looks, games, now, sight):  # type: ignore[no-untyped-def]
    """Return red, green and blue of this thread's pixel; without meaning if it is beside the picture."""
    scene, eye = games.scenes, casting.get_eye(sight.eyes[lane])
    world = world_of(scene, now.game[lane])
    ray, _ = casting.ray_of(looks.camera, eye[1], y, x, size[0], size[1])
    far_m = eye[2] * casting.SKY if y < size[0] and x < size[1] else -ONE
    met = first_met(scene, world, sight, lane, (y, x), eye[0], ray, far_m)
    return casting.colour_of(scene, world, looks, eye, (y, x), size, ray, met)


def cast_colour(going, tick_ns, side, looks, games, now, sight, frames):  # type: ignore[no-untyped-def]
    """Write colour frames (L, 3, rows, columns), means of `side` x `side` pixels; 0 after a touch."""
    rows, columns = frames.shape[2] * side, frames.shape[3] * side
    lane, y, x = pixel_of_thread(rows, columns)
    if lane >= np.uintp(len(going)) or going[lane] == 0:
        return
    state, game = now.state[lane], now.game[lane]
    red = green = blue = 0
    if state.collision_tick == NEVER:
        colour = colour_of_thread(lane, y, x, (rows, columns), looks, games, now, sight)
        red, green, blue = int(colour[0]), int(colour[1]), int(colour[2])
        camera = camera_of(games, game)
        if camera[events.READ] > 0.0:
            seeds, moment_ns, value = games.seeds[game], state.tick * tick_ns, 3 * (y * columns + x)
            red = noisy_at(red, camera, seeds, moment_ns, value)
            green = noisy_at(green, camera, seeds, moment_ns, value + 1)
            blue = noisy_at(blue, camera, seeds, moment_ns, value + 2)
    red, green, blue = summed(red, side), summed(green, side), summed(blue, side)
    if (y | x) & (side - 1) == 0 and y < rows and x < columns:
        y, x = divided(y, side), divided(x, side)
        frames[lane, 0, y, x] = round(red / (side * side))
        frames[lane, 1, y, x] = round(green / (side * side))
        frames[lane, 2, y, x] = round(blue / (side * side))


def cast_gray(going, looks, games, now, sight, gray):  # type: ignore[no-untyped-def]
    """Write luma `gray` (L, rows, columns) uint8 of the lanes that are `going`."""
    size = gray.shape[1], gray.shape[2]
    lane, y, x = pixel_of_thread(size[0], size[1])
    if lane >= np.uintp(len(going)) or going[lane] == 0:
        return
    red, green, blue = colour_of_thread(lane, y, x, size, looks, games, now, sight)
    if y < size[0] and x < size[1]:
        gray[lane, y, x] = luma_of(red, green, blue)


# --- event cameras, of gray pictures ------------------------------------------------------------------------------


@cuda.jit(device=True)
def noisy_gray(gray, lane, y, x, tick_ns, games, now):  # type: ignore[no-untyped-def]
    """Return a pixel's grey level, with read noise."""
    level, game = np.int32(gray[lane, y, x]), now.game[lane]
    camera = camera_of(games, game)
    if camera[events.READ] > 0.0:
        moment_ns, place = now.state[lane].tick * tick_ns, y * gray.shape[2] + x
        return np.int32(noisy_at(level, camera, games.seeds[game], moment_ns, place))
    return level


def start_events(going, gray, sensor, games, now, pixels):  # type: ignore[no-untyped-def]
    """Initialise the event cameras of the lanes that are `going` with their first image, which causes no events."""
    rows, columns, side = gray.shape[1], gray.shape[2], divided(gray.shape[1], pixels.gathered.shape[1])
    lane, y, x = pixel_of_thread(rows, columns)
    if lane >= np.uintp(len(going)) or going[lane] == 0 or y >= rows or x >= columns:
        return
    level, camera = noisy_gray(gray, lane, y, x, 0, games, now), camera_of(games, now.game[lane])
    log = sensor.logs[np.uint32(level)]
    pixels.base[lane, y, x] = log
    if pixels.filtered.size:
        pixels.filtered[lane, y, x] = log
    if pixels.last_s.size:
        pixels.last_s[lane, y, x] = -np.float32(camera[events.REFRACTORY])
    if (y | x) & (side - 1) == 0:
        pixels.gathered[lane, divided(y, side), divided(x, side)] = 0
    if y == 0 and x == 0:
        pixels.clock[lane], pixels.time_s[lane] = 0, 0.0


def see_gray(going, tick_ns, gray, sensor, games, now, pixels, rest):  # type: ignore[no-untyped-def]
    """Compute the events of the lanes that are `going`, BLOCK_SIDE pixels a thread, and add them to their blocks'."""
    rows, columns, side = gray.shape[1], gray.shape[2], divided(gray.shape[1], pixels.gathered.shape[1])
    thread, threads = np.uint32(cuda.grid(1)), np.uint32((rows * columns + BLOCK_SIDE - 1) // BLOCK_SIDE)
    lane = np.uintp(divided(thread, threads))
    if lane >= np.uintp(len(going)) or going[lane] == 0 or now.state[lane].collision_tick != NEVER:
        return
    game, block = now.game[lane], np.uint32(thread - np.uint32(lane) * threads)
    y = divided(block * np.uint32(BLOCK_SIDE), columns)
    x, camera = np.uint32(block * np.uint32(BLOCK_SIDE) - y * np.uint32(columns)), camera_of(games, game)
    moment = lane, pixels.time_s[lane], events.seconds(now.state[lane].tick * tick_ns)
    normals, draws = events.block_draws(camera, games.seeds[game, EVENT_SEED], pixels.clock[lane] + 1, int(block))
    filtered = pixels.filtered[lane] if pixels.filtered.size else pixels.filtered[0:0, 0]
    for number in range(BLOCK_SIDE):
        if y >= rows:
            return
        level, draw = noisy_gray(gray, lane, y, x, tick_ns, games, now), (normals[number], draws[number])
        memory = pixels.base[lane], filtered
        signed = events.update_pixel(level, camera, sensor, *memory, draw, int(y), int(x), moment, rest)
        if signed != 0:
            cuda.atomic.add(pixels.gathered, (lane, divided(y, side), divided(x, side)), np.int32(signed))
        x = np.uint32(x + np.uint32(1))
        if x == columns:
            x, y = np.uint32(0), np.uint32(y + np.uint32(1))


def finish(going, tick_ns, now, pixels):  # type: ignore[no-untyped-def]
    """Advance the clocks of the lanes' event cameras, after their events have been computed in all blocks."""
    lane = cuda.grid(1)
    if lane < len(going) and going[lane] != 0 and now.state[lane].collision_tick == NEVER:
        pixels.clock[lane] += 1
        pixels.time_s[lane] = now.state[lane].tick * tick_ns * events.NS


def take_frames(going, now, pixels, frames):  # type: ignore[no-untyped-def]
    """Move the events since the last call to `frames` (L, rows, columns) of the lanes that are `going`."""
    rows, columns = frames.shape[1], frames.shape[2]
    lane, y, x = pixel_of_thread(rows, columns)
    if lane >= np.uintp(len(going)) or going[lane] == 0 or y >= rows or x >= columns:
        return
    hit = now.state[lane].collision_tick != NEVER
    frames[lane, y, x] = NEUTRAL_LEVEL if hit else events.level_of(pixels.gathered[lane, y, x])
    if not hit:
        pixels.gathered[lane, y, x] = 0


KERNELS = (
    *(project, find, draw_gray, see, show, add_colours, look, cast_depth, cast_colour, cast_gray),
    *(start_events, see_gray, finish, take_frames),
)
