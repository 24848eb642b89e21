"""A lane's game and command in steps, between which a GPU flies and observes all lanes together.

The CPU flies each lane through a whole command instead. The functions are scalar; `lane` is the row in all arrays. The
clock itself is in kernels/timeline.
"""

from __future__ import annotations

import numpy as np

from uavaccel.kernels import lane_games, lanes, timeline
from uavaccel.kernels.fields import COLUMNS, ROWS, Operand
from uavaccel.kernels.lanes import PICTURE_SEED, Flights, Games
from uavaccel.kernels.timeline import Clocks, Timing
from uavaccel.sim.parts import part
from uavaccel.vision.guard import LUMA_WEIGHTS

RED, GREEN, BLUE = LUMA_WEIGHTS
PIXELS = ROWS * COLUMNS


@part
def begin(lane: int, rows: Operand, games: Games, now: Flights) -> None:
    """Begin the game in a row of `rows` (L,)."""
    lanes.begin(lane, rows[lane], games, now)
    lanes.refresh(games.parameters[rows[lane]], now.state[lane], now.body[lane])


@part
def resume(lane: int, before: Flights, share: float, games: Games, now: Flights) -> None:
    """Let a vehicle fly on from where it is as it did `before`."""
    lanes.resume(lane, lane, before.state, before.body, share, games, now)


@part
def begin_clocks(lane: int, rows: Operand, scales: Operand, games: Games, timing: Timing, clocks: Clocks) -> None:
    """Start the clock of the game in a row of `rows` (L,) and run it up to its first image."""
    scale = scales[rows[lane]]
    clocks.scale[lane], clocks.brightness[lane] = scale, np.nan
    timeline.start(clocks.row[lane], scale, timing, games.seeds[rows[lane], PICTURE_SEED])


@part
def show_start(lane: int, levels: Operand, timing: Timing, clocks: Clocks) -> None:
    """Account for a game's first image; `levels` are those of `guard`."""
    suspect = guard(lane, levels, timing, clocks)
    timeline.show_start(clocks.row[lane], clocks.scale[lane], timing, suspect)


@part
def issue(lane: int, now: Flights, timing: Timing, clocks: Clocks, legs: Operand) -> None:
    """Issue a command, and write the ticks until it takes effect to `legs` (L,)."""
    tick = timeline.issue(clocks.row[lane], clocks.scale[lane], timing)
    legs[lane] = tick - now.state[lane].tick


@part
def take(lane: int, hold_ticks: int, goals: Operand, modes: Operand, now: Flights) -> None:
    """Apply the command; position hold takes over after `hold_ticks` unless another one follows."""
    lanes.command(lane, goals, modes, now)
    now.state[lane].hover_tick = now.state[lane].tick + hold_ticks


@part
def reach(
    lane: int, sample: int, now: Flights, timing: Timing, clocks: Clocks, looking: Operand, legs: Operand
) -> None:
    """Wait for a sample: write the ticks until then to `legs`, and whether there is one to `looking` (L,)."""
    row = clocks.row[lane]
    looking[lane] = 1 if row[timeline.LAST] == 0 else 0
    if looking[lane] == 0:
        legs[lane] = 0
        return
    clocks.taken[lane] = sample
    legs[lane] = timeline.reach(row, clocks.scale[lane], timing, sample) - now.state[lane].tick


@part
def leave(lane: int, sample: int, levels: Operand, now: Flights, timing: Timing, clocks: Clocks) -> None:
    """Continue after a sample; after a collision there is no image."""
    row, hit, suspect = clocks.row[lane], lanes.touched(lane, now), False
    if not hit:
        clocks.ticks[lane, sample], clocks.taken[lane] = now.state[lane].tick, sample + 1
        suspect = guard(lane, levels, timing, clocks)
    timeline.leave(row, clocks.scale[lane], timing, hit, suspect)
    if row[timeline.LAST] != 0:
        timeline.switch(row, timeline.NO_PHASE)


@part
def split(lane: int, now: Flights, clocks: Clocks, legs: Operand, to_shown: Operand) -> None:
    """Split `legs` at the pose that images will show: ticks `to_shown` until then, or -1 if it is stored already."""
    shown = clocks.row[lane, timeline.SHOWN]
    to_shown[lane] = shown - now.state[lane].tick if shown >= now.state[lane].tick else -1
    legs[lane] -= max(to_shown[lane], 0)


@part
def save_shown(lane: int, now: Flights, clocks: Clocks) -> None:
    """Store the present pose, which images show until Unreal's next frame."""
    for axis in range(3):
        clocks.shown[lane, axis] = now.state[lane].position[axis]
    for number in range(4):
        clocks.shown[lane, 3 + number] = now.state[lane].quaternion[number]


@part
def turn_to_shown(lane: int, now: Flights, clocks: Clocks) -> None:
    """Swap a lane's pose with the one that images show; a second call restores both."""
    if clocks.row[lane, timeline.SHOWN] < 0:
        return
    state, shown = now.state[lane], clocks.shown[lane]
    for axis in range(3):
        shown[axis], state.position[axis] = state.position[axis], shown[axis]
    for number in range(4):
        shown[3 + number], state.quaternion[number] = state.quaternion[number], shown[3 + number]


@part
def guard(lane: int, levels: Operand, timing: Timing, clocks: Clocks) -> bool:
    """Return whether the guard requests the image again (vision/guard), and remember its brightness.

    `levels` (L, 3) are sums over its pixels: grey, -1, -1, or red, green and blue.
    """
    if timing.rules[timeline.GUARDED] == 0:
        return False
    of_lane = levels[lane]
    bright = of_lane[0] / PIXELS
    if of_lane[1] >= 0:
        bright = RED * bright + GREEN * (of_lane[1] / PIXELS) + BLUE * (of_lane[2] / PIXELS)
    return timeline.is_suspect(lane, bright, clocks)


LAUNCHED = {
    each.py_func.__name__: each
    for each in (
        *(begin, lane_games.deal, lanes.command, resume, begin_clocks, show_start, issue, take, reach, leave, split),
        *(save_shown, turn_to_shown),
    )
}
"""What a GPU launches for a lane a thread, by the kernel's name."""
