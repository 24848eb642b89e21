"""Lanes on the CPU: commands flown and seen lane by lane, in threads that share nothing but what they read."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from uavaccel.kernels import events
from uavaccel.kernels.fields import COLUMNS, ROWS, Looks
from uavaccel.kernels.lanes import (
    EVENT_SEED,
    PICTURE_SEED,
    Flights,
    Games,
    begin,
    command,
    fly,
    look,
    touched,
)
from uavaccel.kernels.project import project
from uavaccel.kernels.spans import draw_channels, draw_depths, make_desk
from uavaccel.parts import part
from uavaccel.sim.hotloop import sources
from uavaccel.vision import dvs_kernels as dvs
from uavaccel.vision.noise import READ_NOISE, fill_normal
from uavaccel.vision.observation import BLOCK_SIDE

STATE, DVS, COLOUR, DEPTH = range(4)  # what is observed
SAMPLE_FIELDS = 13  # place, attitude, velocity, body rate: a flight's record from `position` on
NS = 1e-9
SEEN_FAR_M = np.float32(50.0)  # depth that is shown as 255


@part
def _look_at_starts(games: Games, rows: Any) -> None:
    """Finish the starts of games: the accelerations in their wind."""
    for game in rows:
        look(games.parameters[game], games.start[game], games.body[game])


@part(error_model="numpy", inline=False)
def add_read_noise(picture: Any, sigma: float, seed: int, moment_ns: int) -> None:
    """Make a picture (values,) of grey levels noisy, in place (vision/image_noise)."""
    drawn, deviation = np.empty(len(picture), np.float32), np.float32(sigma)
    fill_normal(drawn, np.uint64(seed), np.uint64(moment_ns), READ_NOISE)  # type: ignore[arg-type]
    for value in range(len(picture)):
        picture[value] = events.noisy(picture[value], deviation, drawn[value])


@part(error_model="numpy")
def start_seeing(lane: int, picture: Any, pixels: events.Pixels, sensor: Any, camera: Any) -> None:
    """A game's first frame makes no events."""
    for y in range(ROWS):
        for x in range(COLUMNS):
            pixels.base[lane, y, x] = sensor.logs[picture[y, x]]
            if pixels.filtered.size:
                pixels.filtered[lane, y, x] = sensor.logs[picture[y, x]]
            if pixels.last_s.size:
                pixels.last_s[lane, y, x] = -np.float32(camera[events.REFRACTORY])
            pixels.gathered[lane, y // BLOCK_SIDE, x // BLOCK_SIDE] = 0
    pixels.clock[lane], pixels.time_s[lane] = 0, 0.0


@part(error_model="numpy")
def four_of(picture: Any, y: int, x: int) -> events.Four:
    """Four grey levels in a row."""
    return picture[y, x], picture[y, x + 1], picture[y, x + 2], picture[y, x + 3]


@part(error_model="numpy", inline=False)
def see_quietly(picture: Any, base: Any, gathered: Any, sensor: Any, camera: Any) -> None:
    """`events.see` of a whole picture whose pixels have no low-pass and no noise: few of them have events to count."""
    positive, negative = np.empty(COLUMNS, np.float32), np.empty(COLUMNS, np.float32)
    logs, busy = np.empty(COLUMNS, np.float32), np.empty(COLUMNS, np.bool_)
    nominal, sigma = (camera[events.POSITIVE], camera[events.NEGATIVE]), camera[events.SIGMA]
    for y in range(ROWS):
        for x in range(COLUMNS):
            logs[x] = sensor.logs[picture[y, x]]
        for x in range(COLUMNS):
            positive[x] = events.single_threshold(nominal[0], sigma, sensor.up[y, x])
            negative[x] = events.single_threshold(nominal[1], sigma, sensor.down[y, x])
            change = logs[x] - np.float32(base[y, x])
            busy[x] = (change >= positive[x]) | (-change >= negative[x])
        for x in range(COLUMNS):
            if busy[x]:
                before = base[y, x]
                signed = events.due(logs[x], before, positive[x], negative[x])
                base[y, x] = dvs.advanced(before, signed, positive[x], negative[x])
                gathered[y // BLOCK_SIDE, x // BLOCK_SIDE] += signed


@part(error_model="numpy", inline=False)
def see_with_dead_time(
    lane: int, picture: Any, times_s: Any, pixels: events.Pixels, sensor: Any, camera: Any, noise: Any
) -> None:
    """`events.see` of a whole picture whose pixels rest after an event; `times_s` of the last frame and of this."""
    counts, most = np.empty((ROWS, COLUMNS), np.int32), 1
    base, filtered, dt_s = pixels.base[lane], filtered_of(lane, pixels), times_s[1] - times_s[0]
    for y in range(ROWS):
        for x in range(0, COLUMNS, BLOCK_SIDE):
            levels = four_of(picture, y, x)
            most = max(most, events.count(levels, camera, sensor, base, filtered, counts, noise, y, x, dt_s))
    dead_s = np.float32(camera[events.REFRACTORY])
    for y in range(ROWS):
        for x in range(0, COLUMNS, BLOCK_SIDE):
            if camera[events.REFRACTORY] > dt_s / most:
                events.keep_late(counts, pixels.last_s[lane], y, x, times_s[0], times_s[1], most, dead_s)
            levels = four_of(picture, y, x)
            total = events.settle(levels, camera, sensor, base, filtered, counts, noise, y, x, dt_s)
            pixels.gathered[lane, y // BLOCK_SIDE, x // BLOCK_SIDE] += total


@part
def filtered_of(lane: int, pixels: events.Pixels) -> Any:
    """A lane's logarithms after a low-pass (144, 256), or an empty array."""
    return pixels.filtered[lane] if pixels.filtered.size else pixels.filtered[0:0, 0]


@part(error_model="numpy", inline=False)
def see(
    lane: int, picture: Any, time_s: float, pixels: events.Pixels, sensor: Any, camera: Any, seed: int
) -> None:
    """A lane's event camera sees a frame (144, 256)."""
    before_s, index = pixels.time_s[lane], pixels.clock[lane] + 1
    noise, dt_s, noisy = (seed, index), time_s - before_s, False
    for kind in (events.LEAK, events.SHOT, events.HOT):
        noisy |= camera[kind] > 0.0
    if pixels.last_s.size:
        see_with_dead_time(lane, picture, (before_s, time_s), pixels, sensor, camera, noise)
    elif pixels.filtered.size or noisy:
        base, filtered = pixels.base[lane], filtered_of(lane, pixels)
        for y in range(ROWS):
            for x in range(0, COLUMNS, BLOCK_SIDE):
                levels = four_of(picture, y, x)
                total = events.see(levels, camera, sensor, base, filtered, noise, y, x, dt_s)
                pixels.gathered[lane, y // BLOCK_SIDE, x // BLOCK_SIDE] += total
    else:
        see_quietly(picture, pixels.base[lane], pixels.gathered[lane], sensor, camera)
    pixels.clock[lane], pixels.time_s[lane] = index, time_s


@part(error_model="numpy")
def moment_ns(lane: int, now: Flights, tick_ns: int) -> int:
    """Simulated time since the game's start."""
    return now.state[lane].tick * tick_ns


@part(error_model="numpy", inline=False)
def draw_gray(
    lane: int, looks: Looks, games: Games, now: Flights, tick_ns: int, desk: Any, picture: Any
) -> None:
    """What a lane's front camera sees, grey (144, 256), with the camera's noise."""
    state, game = now.state[lane], now.game[lane]
    project(looks, games.scenes, game, state.position, state.quaternion, True, desk.faces)
    draw_channels(looks, desk, False)
    channels = desk.channels
    for y in range(ROWS):
        for x in range(COLUMNS):
            picture[y, x] = channels[0, x, y]
    if games.cameras[game, events.READ] > 0.0:
        seed, moment = games.seeds[game, PICTURE_SEED], moment_ns(lane, now, tick_ns)
        add_read_noise(picture.ravel(), games.cameras[game, events.READ], seed, moment)


@part(error_model="numpy", inline=False)
def draw_colour(
    lane: int, looks: Looks, games: Games, now: Flights, tick_ns: int, desk: Any, frame: Any
) -> None:
    """Red, green and blue (3, 36, 64): means of blocks of 4 x 4 pixels."""
    state, game = now.state[lane], now.game[lane]
    project(looks, games.scenes, game, state.position, state.quaternion, True, desk.faces)
    draw_channels(looks, desk, True)
    picture, channels = np.empty((ROWS, COLUMNS, 3), np.uint8), desk.channels
    for y in range(ROWS):
        for x in range(COLUMNS):
            for channel in range(3):
                picture[y, x, channel] = channels[channel, x, y]
    if games.cameras[game, events.READ] > 0.0:
        seed, moment = games.seeds[game, PICTURE_SEED], moment_ns(lane, now, tick_ns)
        add_read_noise(picture.ravel(), games.cameras[game, events.READ], seed, moment)
    for channel in range(3):
        for y in range(frame.shape[1]):
            for x in range(frame.shape[2]):
                total = 0
                for row in range(BLOCK_SIDE):
                    for column in range(BLOCK_SIDE):
                        total += int(picture[BLOCK_SIDE * y + row, BLOCK_SIDE * x + column, channel])
                frame[channel, y, x] = int(np.rint(total / BLOCK_SIDE**2))


@part(error_model="numpy", inline=False)
def draw_depth(lane: int, looks: Looks, games: Games, now: Flights, desk: Any, frame: Any) -> None:
    """Depth (1, 36, 64): means of blocks of 4 x 4 pixels, 0 to SEEN_FAR_M as 0 to 255."""
    state, game = now.state[lane], now.game[lane]
    project(looks, games.scenes, game, state.position, state.quaternion, False, desk.faces)
    depths = np.empty((ROWS, COLUMNS), np.float32)
    draw_depths(desk, depths)
    for y in range(frame.shape[1]):
        for x in range(frame.shape[2]):
            total = np.float32(0.0)
            for row in range(BLOCK_SIDE):
                for column in range(BLOCK_SIDE):
                    total += min(depths[BLOCK_SIDE * y + row, BLOCK_SIDE * x + column], SEEN_FAR_M)
            frame[0, y, x] = int(np.rint(total / np.float32(BLOCK_SIDE**2) * np.float32(255.0 / 50.0)))


class Command(NamedTuple):
    """How a command is flown and seen, the same for all lanes."""

    slices: Any
    """Ticks (S,) of its samples."""
    event_ticks: int
    """Ticks from one of the event camera's frames to the next; 0: it sees the samples alone."""
    tick_ns: int
    hull: Any
    """(3,) (kernels/flight)."""


class View(NamedTuple):
    """What lanes are seen with."""

    looks: Any
    sensor: Any
    pixels: Any


@part(error_model="numpy", inline=False)
def look_at_events(
    lane: int, view: View, games: Games, now: Flights, plan: Command, desk: Any, picture: Any
) -> None:
    """A lane's event camera sees what is in front of it."""
    game = now.game[lane]
    draw_gray(lane, view.looks, games, now, plan.tick_ns, desk, picture)
    time_s = moment_ns(lane, now, plan.tick_ns) * NS
    see(lane, picture, time_s, view.pixels, view.sensor, games.cameras[game], games.seeds[game, EVENT_SEED])


@part
def look_at_nothing(
    lane: int, view: View, games: Games, now: Flights, plan: Command, desk: Any, picture: Any
) -> None:
    """There is no event camera."""


@part
def show_events(
    lane: int, view: View, games: Games, now: Flights, plan: Command, desk: Any, frame: Any
) -> None:
    """The events since they were last shown, as a frame (1, 36, 64)."""
    pixels = view.pixels
    for y in range(frame.shape[1]):
        for x in range(frame.shape[2]):
            frame[0, y, x] = events.level_of(pixels.gathered[lane, y, x])
            pixels.gathered[lane, y, x] = 0


@part(error_model="numpy")
def show_colour(
    lane: int, view: View, games: Games, now: Flights, plan: Command, desk: Any, frame: Any
) -> None:
    """A colour picture as a frame."""
    draw_colour(lane, view.looks, games, now, plan.tick_ns, desk, frame)


@part(error_model="numpy")
def show_depth(
    lane: int, view: View, games: Games, now: Flights, plan: Command, desk: Any, frame: Any
) -> None:
    """A picture of depth as a frame."""
    draw_depth(lane, view.looks, games, now, desk, frame)


@part
def show_nothing(
    lane: int, view: View, games: Games, now: Flights, plan: Command, desk: Any, frame: Any
) -> None:
    """States are observed, not pictures."""


@part(error_model="numpy")
def _begin_unseen(lanes: Any, rows: Any, games: Games, now: Flights) -> None:
    """Let lanes begin the games of these rows."""
    for place in range(len(lanes)):
        begin(lanes[place], rows[place], games, now)


@part(error_model="numpy")
def _begin_seen(lanes: Any, rows: Any, view: View, games: Games, now: Flights, plan: Command) -> None:
    """The same for lanes with event cameras."""
    desk, picture = make_desk(), np.empty((ROWS, COLUMNS), np.uint8)
    _begin_unseen(lanes, rows, games, now)
    for place in range(len(lanes)):
        lane, camera = lanes[place], games.cameras[rows[place]]
        draw_gray(lane, view.looks, games, now, plan.tick_ns, desk, picture)
        start_seeing(lane, picture, view.pixels, view.sensor, camera)


@part(error_model="numpy")
def fly_sample(
    look_at: Any,
    lane: int,
    ticks: int,
    view: View,
    games: Games,
    now: Flights,
    plan: Command,
    desk: Any,
    picture: Any,
) -> bool:
    """Fly to a sample, the event camera looking on; whether it has seen the sample's own moment."""
    left = ticks
    while plan.event_ticks > 0:
        due = plan.event_ticks - now.state[lane].tick % plan.event_ticks
        if due > left or touched(lane, now):
            break
        fly(lane, due, games, now, plan.hull)
        left -= due
        if not touched(lane, now):
            look_at(lane, view, games, now, plan, desk, picture)
    fly(lane, left, games, now, plan.hull)
    return plan.event_ticks > 0 and left == 0


@part
def take_state(lane: int, now: Flights, sample: Any) -> None:
    """A lane's place, attitude, velocity and body rate (SAMPLE_FIELDS,)."""
    state = now.state[lane]
    for axis in range(3):
        sample[axis] = state.position[axis]
        sample[7 + axis] = state.velocity[axis]
        sample[10 + axis] = state.rate[axis]
    for place in range(4):
        sample[3 + place] = state.quaternion[place]


@part(error_model="numpy")
def _fly_lanes(
    look_at: Any,
    show: Any,
    lanes: Any,
    directions: Any,
    view: View,
    games: Games,
    now: Flights,
    plan: Command,
    frames: Any,
    samples: Any,
) -> None:
    """Fly a command each: frames (L, S, ...) of the samples before a touch, states (L, S, SAMPLE_FIELDS) of all."""
    desk, picture = make_desk(), np.empty((ROWS, COLUMNS), np.uint8)
    for lane in lanes:
        command(lane, directions, games, now)
        for sample in range(len(plan.slices)):
            seen = fly_sample(look_at, lane, plan.slices[sample], view, games, now, plan, desk, picture)
            take_state(lane, now, samples[lane, sample])
            if touched(lane, now):
                continue
            if not seen:
                look_at(lane, view, games, now, plan, desk, picture)
            show(lane, view, games, now, plan, desk, frames[lane, sample])


@part(error_model="numpy")
def _show_lanes(
    show: Any, lanes: Any, view: View, games: Games, now: Flights, plan: Command, frames: Any
) -> None:
    """Frames (L, 1, ...) of the present moment, in colour or of depth."""
    desk = make_desk()
    for lane in lanes:
        show(lane, view, games, now, plan, desk, frames[lane, 0])


class EntryPoints(NamedTuple):
    """Machine code, called without the GIL."""

    look_at_starts: Any
    begin: Any
    fly: Any
    show: Any


def _flying(kind: int, stamp: int) -> tuple[Any, Any]:
    """`fly` and `show` of `entry_points`."""
    entry_point = njit(nogil=True, cache=True)

    @entry_point
    def fly_lanes(lanes, directions, view, games, now, plan, frames, samples):  # type: ignore[no-untyped-def]
        if kind == DVS:
            _fly_lanes(
                look_at_events, show_events, lanes, directions, view, games, now, plan, frames, samples
            )
        elif kind == COLOUR:
            _fly_lanes(
                look_at_nothing, show_colour, lanes, directions, view, games, now, plan, frames, samples
            )
        elif kind == DEPTH:
            _fly_lanes(
                look_at_nothing, show_depth, lanes, directions, view, games, now, plan, frames, samples
            )
        elif stamp:
            _fly_lanes(
                look_at_nothing, show_nothing, lanes, directions, view, games, now, plan, frames, samples
            )

    @entry_point
    def show_lanes(lanes, view, games, now, plan, frames):  # type: ignore[no-untyped-def]
        if kind == COLOUR:
            _show_lanes(show_colour, lanes, view, games, now, plan, frames)
        elif stamp:
            _show_lanes(show_depth, lanes, view, games, now, plan, frames)

    return fly_lanes, show_lanes


@cache
def entry_points(kind: int) -> EntryPoints:
    """For lanes of which STATE, DVS, COLOUR or DEPTH is observed; compiled when called, or from numba's cache.

    numba looks for changes in this file alone; that they close over `stamp` makes it see those in the others. It
    compiles only the branch that `kind` takes.
    """
    entry_point, stamp = njit(nogil=True, cache=True), sources(__name__)

    @entry_point
    def look_at_starts(games, rows):  # type: ignore[no-untyped-def]
        if stamp:
            _look_at_starts(games, rows)

    @entry_point
    def begin_lanes(lanes, rows, view, games, now, plan):  # type: ignore[no-untyped-def]
        if kind == DVS:
            _begin_seen(lanes, rows, view, games, now, plan)
        elif stamp:
            _begin_unseen(lanes, rows, games, now)

    return EntryPoints(look_at_starts, begin_lanes, *_flying(kind, stamp))
