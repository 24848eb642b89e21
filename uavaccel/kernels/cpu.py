"""Lanes on the CPU: each is flown and observed through a whole command, in threads that share read-only data alone."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numba import njit

from uavaccel.kernels import casting, events, pictures, timeline
from uavaccel.kernels.fields import COLOUR, DEPTH, DVS, SEEN_FAR_M, STATE, Launchable, Looks, Operand
from uavaccel.kernels.lane_clocks import save_shown, turn_to_shown
from uavaccel.kernels.lanes import (
    EVENT_SEED,
    PICTURE_SEED,
    Flights,
    Games,
    begin,
    command,
    fly,
    refresh,
    resume,
    touched,
)  # fmt: skip
from uavaccel.kernels.pictures import make_scratch
from uavaccel.kernels.timeline import Clocks, Command
from uavaccel.sim.camera.pixels import luma_of
from uavaccel.sim.parts import chosen_by_types, part
from uavaccel.sim.vehicle.hotloop import sources
from uavaccel.vision import dvs_kernels as dvs
from uavaccel.vision.guard import LUMA_WEIGHTS
from uavaccel.vision.noise import LEAK_JITTER, READ_NOISE, SHOT_NOISE, fill_normal, fill_uniform

Size: TypeAlias = tuple[int, int]


@part
def fill_thresholds(nominal: float, sigma: float, normal: Operand, out: Operand) -> None:
    """Write the thresholds (rows, columns) of a lane's pixels."""
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            out[y, x] = events.threshold(out[y, x], nominal, sigma, normal[y, x])


@part(error_model="numpy")
def suppress(signed: Operand, camera: Operand, last_s: Operand, before_s: float, time_s: float) -> None:
    """Take the events within the refractory period away from signed counts."""
    most, refractory_s = max(1, signed.max(), -signed.min()), camera[events.REFRACTORY]
    if refractory_s <= (time_s - before_s) / most:
        return
    for y in range(signed.shape[0]):
        for x in range(signed.shape[1]):
            if signed[y, x] != 0:
                signed[y, x], last_s[y, x] = events.kept_events(
                    signed[y, x], last_s[y, x], np.float32(refractory_s), before_s, time_s, most
                )


@part(error_model="numpy")
def start(lane: int, picture: Operand, pixels: events.Pixels, sensor: Operand, camera: Operand) -> None:
    """Initialise a lane's event camera with a game's first frame, which causes no events."""
    for y in range(picture.shape[0]):
        for x in range(picture.shape[1]):
            log = sensor.logs[picture[y, x]]
            pixels.base[lane, y, x] = log
            if pixels.filtered.size:
                pixels.filtered[lane, y, x] = log
    pixels.clock[lane], pixels.time_s[lane], pixels.gathered[lane] = 0, 0.0, 0
    if pixels.last_s.size:
        pixels.last_s[lane] = -np.float32(camera[events.REFRACTORY])


@part(error_model="numpy")
def see(
    lane: int, picture: Operand, time_s: float, pixels: events.Pixels, sensor: Operand, camera: Operand, seed: int
) -> None:
    """Update a lane's event camera for a frame (rows, columns) at `time_s`."""
    before_s, index = pixels.time_s[lane], pixels.clock[lane] + 1
    base, gathered, dt_s = pixels.base[lane], pixels.gathered[lane], time_s - before_s
    filtered = pixels.filtered[lane] if pixels.filtered.size > 0 else base
    thresholds = np.empty_like(base), np.empty_like(base)
    fill_thresholds(camera[events.POSITIVE], camera[events.SIGMA], sensor.up, thresholds[0])
    fill_thresholds(camera[events.NEGATIVE], camera[events.SIGMA], sensor.down, thresholds[1])
    none = 0, 0
    normals = np.empty(base.shape if camera[events.LEAK] > 0.0 else none, np.float32)
    fill_normal(normals.ravel(), np.uint64(seed), np.uint64(index), LEAK_JITTER)
    draws = np.empty(base.shape if camera[events.SHOT] > 0.0 else none, np.float32)
    fill_uniform(draws.ravel(), np.uint64(seed), np.uint64(index), SHOT_NOISE)
    hot = sensor.heat < camera[events.HOT] if camera[events.HOT] > 0.0 else np.empty(none, np.bool_)
    log, before, signed = dvs.count(
        picture, (base, filtered), thresholds, hot, sensor.leak_factor, camera, sensor, normals, dt_s
    )
    if pixels.last_s.size:
        suppress(signed, camera, pixels.last_s[lane], before_s, time_s)
    base, noise = dvs.memorise(picture, log, before, signed, thresholds, camera, sensor, draws, dt_s)
    side = signed.shape[0] // gathered.shape[0]
    for y in range(signed.shape[0]):
        for x in range(signed.shape[1]):
            gathered[y // side, x // side] += signed[y, x]
            pixels.base[lane, y, x] = base[y, x]
            if pixels.filtered.size > 0:
                pixels.filtered[lane, y, x] = log[y, x]
    for y in range(noise.shape[0]):
        for x in range(noise.shape[1]):
            gathered[y // side, x // side] += 0 if noise[y, x] == dvs.ON_AND_OFF else noise[y, x]
    pixels.clock[lane], pixels.time_s[lane] = index, time_s


@part(error_model="numpy")
def moment_ns(lane: int, now: Flights, tick_ns: int) -> int:
    """Return the simulated time since the game's start, ns."""
    return now.state[lane].tick * tick_ns


@part(error_model="numpy")
def add_camera_noise(lane: int, games: Games, now: Flights, tick_ns: int, picture: Operand) -> None:
    """Add the read noise of a lane's camera to an image of 8-bit levels, in place (vision/noise)."""
    game, values = now.game[lane], picture.ravel()
    if games.cameras[game, events.READ] > 0.0:
        drawn, deviation = np.empty(len(values), np.float32), np.float32(games.cameras[game, events.READ])
        moment = moment_ns(lane, now, tick_ns)
        fill_normal(drawn, np.uint64(games.seeds[game, PICTURE_SEED]), np.uint64(moment), READ_NOISE)
        for value in range(len(values)):
            values[value] = events.noisy(values[value], deviation, drawn[value])


@part(error_model="numpy")
def gray_in_scene(lane: int, looks: Looks, games: Games, now: Flights, scratch: Operand, out: Operand) -> None:
    world, eye = casting.seen_by(lane, looks, games, now)
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            red, green, blue = casting.colour_at(games.scenes, world, looks, eye, row, column, out.shape)
            out[row, column] = luma_of(red, green, blue)
    scratch.bright[0] = out.mean()


@part(error_model="numpy")
def colour_in_scene(lane: int, looks: Looks, games: Games, now: Flights, scratch: Operand, out: Operand) -> None:
    world, eye = casting.seen_by(lane, looks, games, now)
    size = out.shape[0], out.shape[1]
    for row in range(size[0]):
        for column in range(size[1]):
            colour = casting.colour_at(games.scenes, world, looks, eye, row, column, size)
            for channel in range(3):
                out[row, column, channel] = colour[channel]
    scratch.bright[0] = 0.0
    for channel in range(3):
        scratch.bright[0] += LUMA_WEIGHTS[channel] * out[:, :, channel].mean()


@part(error_model="numpy")
def depths_in_scene(lane: int, looks: Looks, games: Games, now: Flights, scratch: Operand, out: Operand) -> None:
    world, eye = casting.seen_by(lane, looks, games, now)
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            out[row, column] = casting.depth_at(games.scenes, world, looks, eye, row, column, out.shape)


@part(error_model="numpy")
def paint_in_lane(lane: int, looks: Operand, games: Games, now: Flights, scratch: Operand, out: Operand) -> None:
    state = now.state[lane]
    pictures.paint(looks, games.scenes, now.game[lane], state.position, state.quaternion, scratch, out)


@chosen_by_types
def paint(lane, looks, games, now, scratch, out):  # type: ignore[no-untyped-def]
    """Render what a lane's front camera sees, without noise: the kind of image that `out` has room for."""
    if looks.instance_class is not Looks:
        return paint_in_lane
    return pictures.of_picture(out, gray_in_scene, colour_in_scene, depths_in_scene)


@part(error_model="numpy")
def render_gray(
    lane: int, looks: Operand, games: Games, now: Flights, tick_ns: int, scratch: Operand, picture: Operand
) -> None:
    """Render a lane's front camera in grey levels (rows, columns), with the camera's noise."""
    paint(lane, looks, games, now, scratch, picture)
    add_camera_noise(lane, games, now, tick_ns, picture)


@part(error_model="numpy")
def render_colour(
    lane: int, looks: Operand, games: Games, now: Flights, tick_ns: int, scratch: Operand, size: Size, frame: Operand
) -> None:
    """Render red, green and blue (3, rows, columns) of pictures of a size: means over blocks of pixels."""
    picture = np.empty((*size, 3), np.uint8)
    paint(lane, looks, games, now, scratch, picture)
    add_camera_noise(lane, games, now, tick_ns, picture)
    side = size[0] // frame.shape[1]
    for channel in range(3):
        for y in range(frame.shape[1]):
            for x in range(frame.shape[2]):
                total = 0
                for row in range(side):
                    for column in range(side):
                        total += int(picture[side * y + row, side * x + column, channel])
                frame[channel, y, x] = int(np.rint(total / side**2))


@part(error_model="numpy")
def render_depth(
    lane: int, looks: Operand, games: Games, now: Flights, scratch: Operand, size: Size, frame: Operand
) -> None:
    """Render depth (1, rows, columns): means over blocks of pixels, with 0 to SEEN_FAR_M encoded as 0 to 255."""
    depths = np.empty(size, np.float32)
    paint(lane, looks, games, now, scratch, depths)
    side = size[0] // frame.shape[1]
    for y in range(frame.shape[1]):
        for x in range(frame.shape[2]):
            total = np.float32(0.0)
            for row in range(side):
                for column in range(side):
                    total += min(depths[side * y + row, side * x + column], SEEN_FAR_M)
            frame[0, y, x] = int(np.rint(total / np.float32(side**2) * np.float32(255.0 / 50.0)))


class View(NamedTuple):
    """The cameras of all lanes: kind of observation, rows and columns, looks, event sensor and its state."""

    kind: int
    size: Size
    looks: Operand
    sensor: Operand
    pixels: Operand


class Work(NamedTuple):
    """What a thread works with: cameras, games, flights, commands, and room of its own for a picture."""

    cameras: View
    games: Games
    now: Flights
    plan: Command
    clocks: Clocks
    scratch: Operand
    picture: Operand


@part(error_model="numpy")
def observe_events(lane: int, work: Work) -> None:
    """Render a lane's front camera and update its event camera."""
    view, games, now, tick_ns = work.cameras, work.games, work.now, work.plan.tick_ns
    game = now.game[lane]
    render_gray(lane, view.looks, games, now, tick_ns, work.scratch, work.picture)
    time_s = moment_ns(lane, now, tick_ns) * events.NS
    see(lane, work.picture, time_s, view.pixels, view.sensor, games.cameras[game], games.seeds[game, EVENT_SEED])


@part(error_model="numpy")
def render_frame(lane: int, work: Work, frame: Operand) -> None:
    """Render a lane's present frame, in colour or of depth; other kinds have none."""
    view, games, now, scratch = work.cameras, work.games, work.now, work.scratch
    if view.kind == COLOUR:
        render_colour(lane, view.looks, games, now, work.plan.tick_ns, scratch, view.size, frame)
    elif view.kind == DEPTH:
        render_depth(lane, view.looks, games, now, scratch, view.size, frame)


@part(error_model="numpy")
def brightness_in_lane(kind: int, looks: Operand, scratch: Operand) -> float:
    bright = 0.0
    if kind == DVS:
        bright = scratch.channels[0].mean()
    else:
        for channel in range(3):
            bright += LUMA_WEIGHTS[channel] * scratch.channels[channel].mean()
    return bright


@part(error_model="numpy")
def brightness_in_scene(kind: int, looks: Operand, scratch: Operand) -> float:
    return float(scratch.bright[0])


@chosen_by_types
def brightness(kind, looks, scratch):  # type: ignore[no-untyped-def]
    """Return the mean luma of the latest image, without noise."""
    return brightness_in_scene if looks.instance_class is Looks else brightness_in_lane


@part(error_model="numpy")
def guard(lane: int, work: Work) -> bool:
    """Return whether the guard requests the latest image again (vision/guard), and remember its brightness."""
    if work.plan.timing.rules[timeline.GUARDED] == 0:
        return False
    return timeline.is_suspect(lane, brightness(work.cameras.kind, work.cameras.looks, work.scratch), work.clocks)


@part(error_model="numpy")
def begin_game(lane: int, work: Work) -> None:
    """Begin the game of a lane's row: its initial state is completed with its accelerations in the wind."""
    view, games, now, plan, clocks = work.cameras, work.games, work.now, work.plan, work.clocks
    refresh(games.parameters[lane], games.start[lane], games.body[lane])
    begin(lane, lane, games, now)
    row, scale, timing = clocks.row[lane], clocks.scale[lane], plan.timing
    timeline.start(row, scale, timing, games.seeds[lane, PICTURE_SEED])
    clocks.brightness[lane] = np.nan
    if view.kind == DVS:
        render_gray(lane, view.looks, games, now, plan.tick_ns, work.scratch, work.picture)
        start(lane, work.picture, view.pixels, view.sensor, games.cameras[lane])
    elif timing.rules[timeline.GUARDED]:
        render_frame(lane, work, np.empty((3, *view.size), np.uint8))
    timeline.show_start(row, scale, timing, guard(lane, work))


@part(error_model="numpy")
def fly_sample(lane: int, ticks: int, work: Work) -> bool:
    """Fly to a sample with the event camera recording; return whether it has a frame of the sample's own tick."""
    games, now, plan, left = work.games, work.now, work.plan, ticks
    while plan.event_ticks > 0 and work.cameras.kind == DVS:
        to_frame = plan.event_ticks - now.state[lane].tick % plan.event_ticks
        if to_frame > left or touched(lane, now):
            break
        fly(lane, to_frame, games, now, plan.hull)
        left -= to_frame
        if not touched(lane, now):
            observe_events(lane, work)
    fly(lane, left, games, now, plan.hull)
    return plan.event_ticks > 0 and now.state[lane].tick % plan.event_ticks == 0


@part(error_model="numpy")
def fly_to(lane: int, tick: int, work: Work) -> bool:
    """Do as `fly_sample` up to a tick, and store the pose that images show until Unreal's next frame."""
    now, shown = work.now, work.clocks.row[lane, timeline.SHOWN]
    if work.plan.timing.rules[timeline.STALE_POSE] and shown >= now.state[lane].tick:
        fly_sample(lane, shown - now.state[lane].tick, work)
        save_shown(lane, now, work.clocks)
    return fly_sample(lane, tick - now.state[lane].tick, work)


@part
def take_state(lane: int, now: Flights, sample: Operand) -> None:
    """Copy a lane's kinematics to `sample` (KINEMATICS,), in the order of FLIGHT_DTYPE."""
    state = now.state[lane]
    for axis in range(3):
        sample[axis] = state.position[axis]
        sample[7 + axis] = state.velocity[axis]
        sample[10 + axis] = state.rate[axis]
        sample[13 + axis] = state.acceleration[axis]
        sample[16 + axis] = state.angular_acceleration[axis]
    for number in range(4):
        sample[3 + number] = state.quaternion[number]


@part(error_model="numpy")
def fly_command(lane: int, goals: Operand, work: Work, frames: Operand, samples: Operand) -> None:
    """Fly one command in a lane, with its goal of `goals` (L, 4).

    Writes `frames` (L, S, ...) of the samples before a collision, and all states: `samples` (L, S, KINEMATICS).
    """
    view, games, now, plan, clocks = work.cameras, work.games, work.now, work.plan, work.clocks
    row, scale, timing = clocks.row[lane], clocks.scale[lane], plan.timing
    before, body = now.state[lane : lane + 1].copy(), now.body[lane : lane + 1].copy()
    taken, tick = before[0].tick, timeline.issue(row, scale, timing)
    fly_to(lane, tick, work)
    if not np.isnan(plan.start_speed):
        resume(lane, 0, before, body, plan.start_speed, games, now)
    acts_ns, sample = row[timeline.DUE] + timing.rules[timeline.LATE_NS], 0
    while row[timeline.LAST] == 0:
        if acts_ns < row[timeline.DUE] + timing.slices_ns[sample]:
            left_ns = acts_ns - tick * plan.tick_ns
            if left_ns > 0:
                tick = timeline.wait(row, scale, timing, left_ns)
                fly_to(lane, tick, work)
            command(lane, goals, plan.modes, now)
            now.state[lane].hover_tick = tick + plan.hold_ticks
            acts_ns = timeline.NEVER
        tick = timeline.reach(row, scale, timing, sample)
        seen = fly_to(lane, tick, work) and tick > taken  # a second sample of one tick sees a frame of its own
        taken = tick
        take_state(lane, now, samples[lane, sample])
        hit, suspect = touched(lane, now), False
        if not hit:
            clocks.ticks[lane, sample] = tick
            if view.kind != STATE:
                observe_sample(lane, seen, work, frames[lane, sample])
                suspect = guard(lane, work)
        timeline.leave(row, scale, timing, hit, suspect)
        sample += 1
    clocks.taken[lane] = sample - 1 if touched(lane, now) else sample
    timeline.switch(row, timeline.NO_PHASE)


@part(error_model="numpy")
def observe_sample(lane: int, seen: bool, work: Work, frame: Operand) -> None:
    """Write the frame of a sample; `seen` says that the event camera has recorded its tick already.

    The guard judges the sample's picture, of a stale pose where there are any, which the event camera may not see.
    """
    view, rules = work.cameras, work.plan.timing.rules
    is_dvs, stale = view.kind == DVS, rules[timeline.STALE_POSE]
    if not seen or (stale and rules[timeline.GUARDED]):
        if stale:
            turn_to_shown(lane, work.now, work.clocks)
        if seen:
            render_gray(lane, view.looks, work.games, work.now, work.plan.tick_ns, work.scratch, work.picture)
        elif is_dvs:
            observe_events(lane, work)
        else:
            render_frame(lane, work, frame)
        if stale:
            turn_to_shown(lane, work.now, work.clocks)
    if is_dvs:
        pop_events(lane, work.cameras.pixels, frame)


@part
def pop_events(lane: int, pixels: events.Pixels, frame: Operand) -> None:
    """Move the events since the last call to a frame (1, 36, 64)."""
    for y in range(frame.shape[1]):
        for x in range(frame.shape[2]):
            frame[0, y, x] = events.level_of(pixels.gathered[lane, y, x])
            pixels.gathered[lane, y, x] = 0


@part(error_model="numpy")
def _run(
    asked: int,
    lanes: Operand,
    goals: Operand,
    view: View,
    games: Games,
    now: Flights,
    plan: Command,
    clocks: Clocks,
    frames: Operand,
    samples: Operand,
) -> None:
    work = Work(view, games, now, plan, clocks, make_scratch(), np.empty(view.size, np.uint8))
    for lane in lanes:
        if asked == BEGIN:
            begin_game(lane, work)
        elif asked == FLY:
            fly_command(lane, goals, work, frames, samples)
        else:
            render_frame(lane, work, frames[lane, 0])


BEGIN, FLY, SHOW = range(3)
"""What lanes do: begin their games, fly a command, or render present frames (L, 1, ...), in colour or of depth."""


def _compile(stamp: int) -> Launchable:
    """Compile `run_lanes`, or load it from numba's cache; `stamp` as in kernels/pictures."""

    @njit(nogil=True, cache=True)
    def run_lanes(asked, lanes, goals, view, games, now, plan, clocks, frames, samples):  # type: ignore[no-untyped-def]
        if stamp:
            _run(asked, lanes, goals, view, games, now, plan, clocks, frames, samples)

    return run_lanes


run_lanes = _compile(sources(__name__))
"""Compiled, without the GIL: each of some `lanes` does what is `asked`. One for all, or each would compile cameras."""
