"""The simulated wall clock of lanes over arrays: how long a client's calls take, and which ticks pass meanwhile.

A game's clock is a row of integers. The functions replay the calls of commands.py through wire/transport's
`VirtualTransport` to sim/simulation, in order, without messages and without a flight: which ticks pass depends on the
latencies alone. In `lockstep` all latencies are 0. The functions are scalar, for the CPU and a GPU.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavaccel.kernels.fields import Operand
from uavaccel.sim.parts import part
from uavaccel.vision import noise
from uavaccel.vision.guard import GuardSettings

MOVE, PAUSE, CONTINUE, CONTINUE_FOR, STATE, IMAGE, CALL = range(7)  # channels
CHANNELS = ("move", "pause", "continue", "continue_for", "state", "image", "call")
WAITS = 6  # no wait yet, and one for each of wire/latency's WAITS_MS
REQUEST, REPLY = 0, len(CHANNELS) * WAITS  # first table of each direction
ISSUE = 2 * REPLY
TIMER, FRAME = ISSUE + 1, ISSUE + 2
TABLES = ISSUE + 3
_STEP_53 = 2.0**-53


class Latencies(NamedTuple):
    """The distributions of latencies, the same for all lanes."""

    quantiles: Operand
    """(Q,) float64: cumulative probabilities from 0 to 1."""
    tables_us: Operand
    """(TABLES, Q) float64: quantiles of requests by channel and wait, of replies likewise, of ISSUE, TIMER, FRAME."""
    between_ns: Operand
    """(WAITS - 2,) float64: bounds between classes of waits."""
    faults: Operand
    """(3,) float64: cumulative probabilities of the delays; all 0 without faults."""
    delays_ns: Operand
    """(4,) int64: delays of faulty messages; the last is 0, of all others."""


@part
def uniform(seed: int, number: int) -> float:
    """Return the number-th random number of a seed, uniform in [0, 1)."""
    a, b, _, _ = noise.words(seed, number, noise.LATENCY, 0)
    high, low = np.int64(a) >> 5, np.int64(b) >> 6
    return (high * 67108864.0 + low) * _STEP_53


@part
def sampled_ns(latencies: Latencies, table: int, share: float) -> int:
    """Return the quantile of a table at a cumulative probability `share`, rounded to nanoseconds."""
    at, us = latencies.quantiles, latencies.tables_us
    last = at.shape[0] - 1
    if us[table, last] == 0.0:
        return 0
    place = 0
    while place < last - 1 and share >= at[place + 1]:
        place += 1
    slope = (us[table, place + 1] - us[table, place]) / (at[place + 1] - at[place])
    return round(1e3 * (slope * (share - at[place]) + us[table, place]))


@part
def wait_class(latencies: Latencies, wait_ns: int) -> int:
    """Return the class of tables to use after a command or continue-for that took `wait_ns`."""
    place = 0
    while place < WAITS - 2 and latencies.between_ns[place] < wait_ns:
        place += 1
    return place + 1


DARKEST, MOST_CHANGE = GuardSettings().min_brightness, GuardSettings().max_change
NEVER = 2**62
NO_PHASE = -1
SIMULATION, RENDERING, IMAGE_PROCESSING = range(3)  # the first of envs/stopwatch's PHASES
PHASE_COUNT = 5

# The fields of a row. The client: its clock; the game's start on it; whether it knows the state; for ADSC the time at
# which the command was issued, the time paused since, and the start of the last pause; for TCSC the simulated ns at
# which the present sample is due; whether that is the command's last.
(NOW, START, KNOWN, ISSUED, PAUSED_NS, PAUSED_AT, DUE, LAST) = range(8)
# The connection: when the last message and the command were handled; when the command's reply arrives; whether it is
# unanswered and was the last message; class of the last wait (latencies.wait_class); the generator's seed and count.
(HANDLED, MOVED, MOVE_REPLY, UNANSWERED, WAITED, SEED, SAMPLED) = range(8, 15)
# The simulation: tick, whether it is paused, wall time, and the wall time and tick from which it runs; the command's
# last tick and the time of its end; a continue-for's last tick, or its timer, and the time of its end; the tick that
# images show, -1 for the present one.
(TICK, PAUSED, WALL, WALL0, TICK0, COMMAND_END, COMMAND_OVER) = range(15, 22)
(PERIOD_END, PERIOD_TIMER, PERIOD_OVER, SHOWN) = range(22, 26)
# The stopwatch: present phase and its start, then the time spent in each.
(PHASE, SINCE, FIRST_PHASE) = range(26, 29)
FIELDS = FIRST_PHASE + PHASE_COUNT

# Rules, the same for all lanes: kind of command and pauses; tick; speed as a fraction, SPEED ticks in TICK_WALL ns, and
# as requested, ASKED / ASKED_UNDER; duration of a command; T_th; the platform's; whether images are requested, guarded.
(IS_ADSC, EXACT_PAUSES, TICK_NS, SPEED, TICK_WALL, ASKED, ASKED_UNDER, COMMAND_TICKS, T_TH_NS) = range(9)
(STALL_NS, FRAME_NS, STALE_POSE, AFTER_CONTINUE, IMAGES, GUARDED, PROCESSING_NS, LAYS_OUT) = range(9, 17)
(LATENCY, FAULTS) = range(17, 19)
(GAP_NS, LATE_NS) = range(19, 21)  # simulated: before a command (task.Mediation), and until it acts
RULES = 21


class Timing(NamedTuple):
    """The timing of commands, the same for all lanes."""

    rules: Operand
    """(RULES,) int64."""
    slices_ns: Operand
    """(S,) int64: simulated time from each sample of a command to the next."""
    offsets_ns: Operand
    """(S,) int64: wall time from the issue of an ADSC command to each sample."""
    latencies: Latencies


class Command(NamedTuple):
    """How commands are flown and observed, the same for all lanes."""

    event_ticks: int
    """Ticks between frames of the event camera; 0 if it records the samples alone."""
    tick_ns: int
    hull: Operand
    """(3,) HULL_RADIUS, HULL_HALF_HEIGHT, HULL_REACH."""
    modes: Operand
    """(3,) int64: what the numbers of all goals are (kernels/lanes.command)."""
    hold_ticks: int
    """Ticks after which position hold takes over unless another command has come."""
    start_speed: float
    """Share of the velocity at the last command's end with which the next one begins; NaN: that after the gap."""
    timing: Timing


class Clocks(NamedTuple):
    """The clocks of L lanes."""

    row: Operand
    """(L, FIELDS) int64."""
    scale: Operand
    """(L,) float64: factor on the latencies of requests and replies."""
    brightness: Operand
    """(L,) float64: brightness that the guard compares the next image with; NaN before the first."""
    shown: Operand
    """(L, 7) float64: pose at tick SHOWN."""
    ticks: Operand
    """(L, S) int64: ticks of the last command's samples before a collision."""
    taken: Operand
    """(L,) int64: number of those samples."""


def clocks(lanes: int, samples: int) -> Clocks:
    """Allocate the clocks of `lanes` lanes whose commands have `samples` samples."""
    f8, i8 = np.float64, np.int64
    return Clocks(
        np.zeros((lanes, FIELDS), i8),
        np.zeros((lanes,), f8),
        np.zeros((lanes,), f8),
        np.zeros((lanes, 7), f8),
        np.zeros((lanes, samples), i8),
        np.zeros((lanes,), i8),
    )


# --- latencies --------------------------------------------------------------------------------------


@part
def draw(row: Operand, timing: Timing, table: int) -> int:
    """Sample the next latency of a table, ns."""
    if timing.rules[LATENCY] == 0:
        return 0
    row[SAMPLED] += 1
    return sampled_ns(timing.latencies, table, uniform(row[SEED], row[SAMPLED]))


@part
def message(row: Operand, scale: float, timing: Timing, direction: int, channel: int) -> int:
    """Sample the next latency of a request or reply, with the lane's scale and faults, ns."""
    spent = draw(row, timing, direction + channel * WAITS + row[WAITED])
    spent = round(spent * scale)
    if timing.rules[FAULTS]:
        row[SAMPLED] += 1
        share, place = uniform(row[SEED], row[SAMPLED]), 0
        while place < 3 and share >= timing.latencies.faults[place]:
            place += 1
        spent += timing.latencies.delays_ns[place]
    return spent


@part
def with_frame(row: Operand, timing: Timing, asked_ns: int) -> int:
    """Return the time at which a frame requested at `asked_ns` is ready (sim/profile)."""
    return asked_ns + draw(row, timing, FRAME) if timing.rules[FRAME_NS] > 0 else asked_ns


# --- the simulation (sim/simulation) ------------------------------------------------------------------


@part
def nearest(numerator: int, denominator: int) -> int:
    """Return a fraction rounded as Python does: half to even."""
    whole = numerator // denominator
    twice = 2 * (numerator - whole * denominator)
    return whole + 1 if twice > denominator or (twice == denominator and whole % 2 == 1) else whole


@part
def wall_due(row: Operand, timing: Timing, tick: int) -> int:
    """Return the first nanosecond of wall time at which a tick is due."""
    speed = timing.rules[SPEED]
    return row[WALL0] + ((tick - row[TICK0]) * timing.rules[TICK_WALL] + speed - 1) // speed


@part
def pause(row: Operand, timing: Timing, wall_ns: int) -> None:
    """Pause the simulation, which ends a continue-for."""
    if row[PAUSED] == 0:
        row[PAUSED], row[WALL] = 1, wall_ns
    if row[PERIOD_OVER] == NEVER:
        over = with_frame(row, timing, wall_ns) if timing.rules[AFTER_CONTINUE] else wall_ns
        row[PERIOD_END], row[PERIOD_TIMER], row[PERIOD_OVER] = NEVER, NEVER, over


@part
def let_run(row: Operand, wall_ns: int) -> None:
    """Let the simulation run from `wall_ns` on."""
    if row[PAUSED] == 1:
        row[PAUSED], row[WALL] = 0, wall_ns
        row[WALL0], row[TICK0] = wall_ns, row[TICK]


@part
def advance_through(row: Operand, timing: Timing, wall_ns: int) -> None:
    """Advance by all ticks due at `wall_ns`, and end the command and continue-for that end meanwhile."""
    while row[PAUSED] == 0:
        end = min(row[COMMAND_END], row[PERIOD_END])
        due = row[TICK0] + (wall_ns - row[WALL0]) * timing.rules[SPEED] // timing.rules[TICK_WALL]
        row[TICK] = max(row[TICK], min(due, end))
        if end > due:
            break
        at_ns = wall_due(row, timing, end)
        if row[COMMAND_END] <= row[TICK]:
            row[COMMAND_END], row[COMMAND_OVER] = NEVER, at_ns
        if row[PERIOD_END] <= row[TICK]:
            pause(row, timing, at_ns)
    if row[PAUSED] == 0 and wall_ns >= row[PERIOD_TIMER]:
        pause(row, timing, wall_ns)
    row[WALL] = wall_ns


@part
def advance(row: Operand, timing: Timing, wall_ns: int) -> None:
    """Do as `advance_through`, and update the tick that images show at each of Unreal's frames."""
    if timing.rules[STALE_POSE] and row[PAUSED] == 0:
        period_ns = timing.rules[FRAME_NS]
        frame_ns = (row[WALL] // period_ns + 1) * period_ns
        while frame_ns <= wall_ns and row[PAUSED] == 0:
            advance_through(row, timing, frame_ns)
            if row[PAUSED] == 0:
                row[SHOWN] = row[TICK]
            frame_ns += period_ns
    advance_through(row, timing, wall_ns)


@part
def next_event(row: Operand, timing: Timing) -> int:
    """Return the time at which command or continue-for end unless a message comes first, or NEVER."""
    end = min(row[COMMAND_END], row[PERIOD_END])
    if row[PAUSED] == 1 or end == NEVER:
        return NEVER if row[PAUSED] == 1 else row[PERIOD_TIMER]
    return min(row[PERIOD_TIMER], wall_due(row, timing, end))


# --- the connection (wire/transport) ------------------------------------------------------------------


@part
def run_to(row: Operand, timing: Timing, wall_ns: int) -> None:
    """Let wall time pass up to `wall_ns`; a wall timer ends exactly at its time."""
    if row[PAUSED] == 0 and row[PERIOD_TIMER] <= wall_ns:
        advance(row, timing, row[PERIOD_TIMER])
    row[HANDLED] = max(row[HANDLED], wall_ns)
    advance(row, timing, row[HANDLED])


@part
def ask(row: Operand, scale: float, timing: Timing, channel: int) -> None:
    """Send a request and run up to the moment at which it is handled."""
    arrival = row[NOW] + message(row, scale, timing, REQUEST, channel)
    if timing.rules[STALL_NS] > 0 and row[UNANSWERED] == 1:
        arrival = max(arrival, min(row[MOVED] + timing.rules[STALL_NS], row[COMMAND_OVER]))
    run_to(row, timing, max(row[HANDLED], arrival))
    row[UNANSWERED] = 0


@part
def answer(row: Operand, scale: float, timing: Timing, channel: int) -> None:
    """Wait for the reply."""
    ready = with_frame(row, timing, row[HANDLED]) if channel == IMAGE else row[HANDLED]
    row[NOW] = max(row[NOW], ready + message(row, scale, timing, REPLY, channel))


@part
def call(row: Operand, scale: float, timing: Timing, channel: int) -> None:
    """Make a call that changes nothing."""
    ask(row, scale, timing, channel)
    answer(row, scale, timing, channel)


@part
def move(row: Operand, scale: float, timing: Timing) -> None:
    """Send the command without waiting for its end; it takes effect at `TICK`."""
    ask(row, scale, timing, MOVE)
    row[COMMAND_END], row[COMMAND_OVER] = row[TICK] + timing.rules[COMMAND_TICKS], NEVER
    row[MOVED], row[MOVE_REPLY], row[UNANSWERED] = row[HANDLED], NEVER, 1
    row[NOW] += draw(row, timing, ISSUE)


@part
def join(row: Operand, scale: float, timing: Timing, deadline_ns: int) -> bool:
    """Wait for the command's end; return False if the deadline comes first."""
    while row[COMMAND_OVER] == NEVER:
        event_ns = next_event(row, timing)
        if event_ns > deadline_ns or event_ns == NEVER:
            row[NOW] = max(row[NOW], deadline_ns)
            return False
        run_to(row, timing, event_ns)
    if row[MOVE_REPLY] == NEVER:
        row[WAITED] = wait_class(timing.latencies, row[COMMAND_OVER] - row[MOVED])
        row[MOVE_REPLY] = row[COMMAND_OVER] + message(row, scale, timing, REPLY, MOVE)
    row[NOW] = max(row[NOW], min(row[MOVE_REPLY], deadline_ns))
    return row[MOVE_REPLY] <= deadline_ns


@part
def continue_for(row: Operand, scale: float, timing: Timing, duration_ns: int) -> None:
    """Run for a simulated duration or, in profile `airsim`, for the wall time that it takes, and pause."""
    ask(row, scale, timing, CONTINUE_FOR)
    handled, rules = row[HANDLED], timing.rules
    let_run(row, handled)
    row[PERIOD_OVER] = NEVER
    if rules[EXACT_PAUSES]:
        row[PERIOD_END] = row[TICK] + nearest(duration_ns, rules[TICK_NS])
    else:
        timer = handled + nearest(duration_ns * rules[ASKED_UNDER], rules[ASKED])
        timer += draw(row, timing, TIMER)
        row[PERIOD_TIMER] = max(timer, wall_due(row, timing, row[TICK] + 1))
    advance(row, timing, handled)
    while row[PERIOD_OVER] == NEVER:
        run_to(row, timing, next_event(row, timing))
    row[WAITED] = wait_class(timing.latencies, row[PERIOD_OVER] - handled)
    reply = message(row, scale, timing, REPLY, CONTINUE_FOR)
    row[NOW] = max(row[NOW], row[PERIOD_OVER] + reply)


@part
def call_pause(row: Operand, scale: float, timing: Timing) -> None:
    """Call simPause(True)."""
    ask(row, scale, timing, PAUSE)
    pause(row, timing, row[HANDLED])
    answer(row, scale, timing, PAUSE)


@part
def call_run(row: Operand, scale: float, timing: Timing) -> None:
    """Call simPause(False)."""
    ask(row, scale, timing, CONTINUE)
    let_run(row, row[HANDLED])
    answer(row, scale, timing, CONTINUE)


# --- the client (envs/flight_env, commands.py) -----------------------------------------------------------


@part
def switch(row: Operand, phase: int) -> None:
    """Count the time from now on for `phase`, or for none."""
    if row[PHASE] != NO_PHASE:
        row[FIRST_PHASE + row[PHASE]] += row[NOW] - row[SINCE]
    row[PHASE], row[SINCE] = phase, row[NOW]


@part
def charge(row: Operand, duration_ns: int, phase: int) -> None:
    """Let the agent work for `duration_ns` between two commands."""
    row[NOW] += duration_ns
    row[FIRST_PHASE + phase] += duration_ns


@part
def start(row: Operand, scale: float, timing: Timing, seed: int) -> None:
    """Begin a game, up to its first image, which `show_start` requests."""
    for field in range(FIELDS):
        row[field] = 0
    row[SEED], row[PHASE] = seed, NO_PHASE
    row[COMMAND_END], row[PERIOD_END], row[PERIOD_TIMER] = NEVER, NEVER, NEVER
    row[COMMAND_OVER], row[MOVE_REPLY] = NEVER, NEVER
    if timing.rules[LAYS_OUT]:
        call(row, scale, timing, CALL)
    ask(row, scale, timing, CALL)
    pause(row, timing, row[HANDLED])
    row[TICK], row[SHOWN] = 0, -1
    answer(row, scale, timing, CALL)
    row[START] = row[NOW]
    call(row, scale, timing, STATE)
    call(row, scale, timing, CALL)


@part
def show_start(row: Operand, scale: float, timing: Timing, suspect: bool) -> None:
    """Request a game's first image, and prepare the simulation for the first command."""
    request_image(row, scale, timing, suspect)
    switch(row, NO_PHASE)
    if timing.rules[IS_ADSC]:
        call_run(row, scale, timing)
    else:
        call_pause(row, scale, timing)


@part
def request_image(row: Operand, scale: float, timing: Timing, suspect: bool) -> None:
    """Request an image, a suspect one twice (vision/guard); it is the same again, for the simulation is paused."""
    if timing.rules[IMAGES] == 0:
        return
    switch(row, RENDERING)
    for _ in range(2 if suspect else 1):
        call(row, scale, timing, IMAGE)
    switch(row, SIMULATION)


@part
def issue(row: Operand, scale: float, timing: Timing) -> int:
    """Issue a command and return the tick at which it takes effect."""
    switch(row, SIMULATION)
    if timing.rules[GAP_NS] > 0:
        wait(row, scale, timing, timing.rules[GAP_NS])
    row[ISSUED], row[PAUSED_NS], row[LAST] = row[NOW], 0, 0
    if timing.rules[IS_ADSC] == 0 and row[KNOWN] == 0:
        call(row, scale, timing, STATE)
    row[DUE] = row[TICK] * timing.rules[TICK_NS]
    move(row, scale, timing)
    return int(row[TICK])


@part
def wait(row: Operand, scale: float, timing: Timing, duration_ns: int) -> int:
    """Continue for a simulated duration, after which TCSC's client knows the state, and return the tick."""
    continue_for(row, scale, timing, duration_ns)
    row[KNOWN] = 1
    return int(row[TICK])


@part
def reach(row: Operand, scale: float, timing: Timing, sample: int) -> int:
    """Wait for a command's next sample and return its tick; `LAST` is then 1 if none follows.

    ADSC waits until the sample is due, or the command's end is known, and then pauses.
    """
    last = sample == timing.slices_ns.shape[0] - 1
    if timing.rules[IS_ADSC]:
        deadline = NEVER if last else row[ISSUED] + row[PAUSED_NS] + timing.offsets_ns[sample]
        row[LAST] = 1 if join(row, scale, timing, deadline) or last else 0
        row[PAUSED_AT] = row[NOW]
        call_pause(row, scale, timing)
        call(row, scale, timing, STATE)
    else:
        row[DUE] += timing.slices_ns[sample]
        left = row[DUE] - row[TICK] * timing.rules[TICK_NS]
        while left > timing.rules[T_TH_NS]:
            wait(row, scale, timing, left)
            left = row[DUE] - row[TICK] * timing.rules[TICK_NS]
        row[LAST] = 1 if last else 0
    call(row, scale, timing, CALL)  # the client asks for collisions
    return int(row[TICK])


@part
def leave(row: Operand, scale: float, timing: Timing, touched: bool, suspect: bool) -> None:
    """Take a sample's image and continue; after a collision there is neither an image nor any processing."""
    if not touched:
        request_image(row, scale, timing, suspect)
    if timing.rules[IS_ADSC]:
        call_run(row, scale, timing)
        row[PAUSED_NS] += row[NOW] - row[PAUSED_AT]
    if touched:
        row[LAST] = 1
        return
    switch(row, IMAGE_PROCESSING)
    row[NOW] += timing.rules[PROCESSING_NS]
    switch(row, SIMULATION)


@part
def is_suspect(lane: int, brightness: float, clocks: Clocks) -> bool:
    """Return whether the guard requests an image again (vision/guard), and remember its brightness."""
    reference = clocks.brightness[lane]  # NaN before the first image: the comparison is false
    clocks.brightness[lane] = brightness
    return brightness < DARKEST or abs(brightness - reference) > MOST_CHANGE * reference
