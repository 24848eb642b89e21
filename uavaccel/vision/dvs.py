"""A dynamic vision sensor after v2e's pixel model, as pure functions on arrays.

A pixel memorises a log intensity and emits one event for each whole contrast threshold by which the current
one differs from it. Source: v2e (SensorsINI/v2e, commit cac6384, `EventEmulator.generate_events`); given the
same random numbers, counts and time stamps equal v2e's to the last event. Events of one stamp and polarity
are left in raster order; v2e shuffles them.

    sensor = make_sensor(PRESETS["clean"], (144, 256), seed=0)
    state = init_state(sensor, first_frame)
    state, on, off = step(sensor, state, frame, t_s=0.33)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.camera.pixels import luma
from uavaccel.vision import dvs_kernels as kernels
from uavaccel.vision import noise
from uavaccel.vision.dvs_sensor import (
    HOT_RATE_HZ,
    PRESETS,
    DvsParameters,
    DvsSensor,
    camera_row,
    make_sensor,
    sensor_from_maps,
)

__all__ = [
    "HOT_RATE_HZ",
    "PRESETS",
    "DvsParameters",
    "DvsSensor",
    "DvsState",
    "init_state",
    "luma",
    "make_sensor",
    "sensor_from_maps",
    "step",
    "step_with_events",
    "time_stamps",
]

Frame = NDArray[np.uint8]
Counts = NDArray[np.int32]
Events = NDArray[np.float32]
Floats = NDArray[np.floating]
Mask = NDArray[np.bool_]

LINEAR_UP_TO = 20  # intensity up to which a line replaces the logarithm
SHOT_NOISE_AT_WHITE = 0.25  # shot noise of the brightest pixel relative to that of a black one
MOST_NORMAL = 7.0  # no normal number of vision/noise is as far from 0
NO_STAMPS = np.empty(0, np.float32)
NO_EVENTS = np.empty((0, 4), np.float32)


class DvsState(NamedTuple):
    """A sensor's state between frames; arrays are (H, W) and never modified in place."""

    base_log: Floats
    filtered_log: Floats
    last_event_s: NDArray[np.float32]
    time_s: float
    frame_index: int
    noise_seed: int


_INTENSITY = np.arange(256, dtype=np.float64)
_LINE = _INTENSITY * (math.log(LINEAR_UP_TO) / LINEAR_UP_TO)
_LOG = np.where(_INTENSITY <= LINEAR_UP_TO, _LINE, np.log(np.maximum(_INTENSITY, 1.0)))
LIN_LOG = (np.round(_LOG * 1e8) / 1e8).astype(np.float32)
RELATIVE_INTENSITY = (np.arange(256) + 20) / 275.0


class Tables(NamedTuple):
    """What a pixel's behaviour depends on, by grey level (256,)."""

    logs: NDArray[np.float32]
    """Log intensity."""
    weights: Floats
    """Speed of the low-pass filter."""
    dimming: Floats
    """Rate of shot noise relative to that of a black pixel."""


TABLES = Tables(LIN_LOG, RELATIVE_INTENSITY, (SHOT_NOISE_AT_WHITE - 1) * RELATIVE_INTENSITY + 1)


def init_state(sensor: DvsSensor, frame: Frame, t_s: float = 0.0, noise_seed: int = 0) -> DvsState:
    """Return the state after the first grey frame (H, W), taken at `t_s` seconds, which causes no events.

    `noise_seed` seeds leak jitter and shot noise. In v2e the time of the first frame is 0.
    """
    _check_frame(sensor, frame)
    log = LIN_LOG[np.ascontiguousarray(frame)].astype(sensor.positive_threshold.dtype)
    never_s = np.full(frame.shape, -sensor.parameters.refractory_s, np.float32)
    return DvsState(log, log, never_s, t_s, 0, noise_seed)


def step(sensor: DvsSensor, state: DvsState, frame: Frame, t_s: float) -> tuple[DvsState, Counts, Counts]:
    """Return the new state, and ON and OFF counts (H, W), after the grey frame (H, W) taken at `t_s` seconds.

    Raises ValueError if the frame is not uint8 of the sensor's shape, or is earlier than the previous one.
    """
    new_state, on, off, _ = _advance(sensor, state, frame, t_s, listed=False)
    return new_state, on, off


def step_with_events(
    sensor: DvsSensor, state: DvsState, frame: Frame, t_s: float
) -> tuple[DvsState, Counts, Counts, Events]:
    """Do `step` and also return the events (n, 4) float32: rows (t, x, y, p), t in seconds, p = +1 or -1.

    Their order is v2e's: by stamp, ON before OFF; shot noise last, with the frame's last stamp.
    """
    return _advance(sensor, state, frame, t_s, listed=True)


def time_stamps(t_before_s: float, t_s: float, count: int) -> NDArray[np.float32]:
    """Return a frame's `count` >= 1 time stamps, evenly spaced from `t_before_s` (exclusive) to `t_s`, in seconds.

    They equal v2e's float32 `torch.linspace` on x86-64 with AVX2 bit for bit: filled from both ends, each element by
    one fused multiply-add.
    """
    start = np.float32(t_before_s + (t_s - t_before_s) / count)
    if count == 1:
        return np.array([start])
    end, index = np.float32(t_s), np.arange(count)
    spacing = np.float64((end - start) / np.float32(count - 1))
    rising = _once_rounded(np.float64(start), spacing * index)
    falling = _once_rounded(np.float64(end), -spacing * (count - 1 - index))
    return np.where(index < count // 2, rising, falling)


def can_suppress(sensor: DvsSensor, spacing_s: float) -> bool:
    """Return whether its refractory period can suppress events of frames that are `spacing_s` or more apart.

    It does where it is longer than a frame's time over the largest count of a pixel. Before any is suppressed, a pixel
    memorises what it sees to within a threshold. Its next count is at most the range of log intensities in thresholds,
    plus one, plus the events of its leak and heat; the time over this sum is least where frames are closest.
    """
    of = sensor.parameters
    least = min(sensor.positive_threshold.min(), sensor.negative_threshold.min())
    leak_hz = of.leak_rate_hz * float(sensor.leak_rate_factor.max()) * (1.0 + MOST_NORMAL * of.leak_jitter_fraction)
    driven_hz = leak_hz + HOT_RATE_HZ * (of.hot_share > 0)
    most = float(LIN_LOG[-1] / least) + 2.0 + driven_hz * spacing_s  # one more for what is rounded
    return of.refractory_s * most > spacing_s


def _once_rounded(base: np.float64, offsets: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return `base + offsets`, which may need more than a double's 53 bits, rounded once to float32.

    The double sum is rounded to odd (Boldo and Melquiond 2008): if it is inexact its last bit is set, so that it is
    never mistaken for a tie of float32.
    """
    near = base + offsets
    part = near - base
    lost = (base - (near - part)) + (offsets - part)  # the exact rounding error of the sum (Knuth's TwoSum)
    beyond = np.nextafter(near, np.where(lost > 0, np.inf, -np.inf))
    even = (near.view(np.int64) & 1) == 0
    return np.where((lost != 0) & even, beyond, near).astype(np.float32)


def _advance(
    sensor: DvsSensor, state: DvsState, frame: Frame, t_s: float, listed: bool
) -> tuple[DvsState, Counts, Counts, Events]:
    _check_frame(sensor, frame)
    if not t_s >= state.time_s:
        raise ValueError(f"a frame at {t_s} s cannot follow one at {state.time_s} s")
    parameters, seed, index = sensor.parameters, state.noise_seed, state.frame_index + 1
    frame, dt_s, camera = np.ascontiguousarray(frame), t_s - state.time_s, camera_row(parameters)
    normals, draws = np.empty((2, 0, 0), np.float32)
    if parameters.leak_rate_hz > 0:
        normals = noise.normal(frame.shape, seed, index, noise.LEAK_JITTER)
    if parameters.shot_noise_rate_hz > 0:
        draws = noise.uniform(frame.shape, seed, index, noise.SHOT_NOISE)
    hot = np.empty((0, 0), np.bool_) if sensor.hot is None else sensor.hot
    memory = state.base_log, state.filtered_log
    thresholds = sensor.positive_threshold, sensor.negative_threshold
    log, before, due = kernels.count(
        frame, memory, thresholds, hot, sensor.leak_rate_factor, camera, TABLES, normals, dt_s
    )
    stamp_count = int(max(1, due.max(), -due.min()))
    # v2e suppresses nothing and stores no times where frames follow each other more slowly
    refractory_s = -math.inf if parameters.refractory_s <= dt_s / stamp_count else parameters.refractory_s
    drops, kept, last_event_s = not math.isinf(refractory_s), due, state.last_event_s
    stamps_s = time_stamps(state.time_s, t_s, stamp_count) if listed or drops else NO_STAMPS
    suppressed = due, stamps_s, state.last_event_s, np.float32(refractory_s)
    if drops:
        kept, last_event_s = kernels.drop_refractory(*suppressed)
    base, shots = kernels.memorise(frame, log, before, kept, thresholds, camera, TABLES, draws, dt_s)
    on, off, events = np.maximum(kept, 0), np.maximum(-kept, 0), NO_EVENTS
    if listed:
        events = np.empty((int(np.abs(kept).sum()), 4), np.float32)
        kernels.list_events(*suppressed, events)
    if shots.size:
        fired = (shots > 0, 1, on), ((shots < 0) | (shots == kernels.ON_AND_OFF), -1, off)
        for mask, polarity, counts in fired:
            counts += mask
            if listed:
                events = np.concatenate([events, _at_once(stamps_s[-1], mask, polarity)])
    return DvsState(base, log, last_event_s, t_s, index, seed), on, off, events


def _at_once(stamp_s: np.float32, mask: Mask, polarity: int) -> Events:
    y, x = np.nonzero(mask)
    events = np.empty((len(x), 4), np.float32)
    events[:, 0], events[:, 1], events[:, 2], events[:, 3] = stamp_s, x, y, polarity
    return events


def _check_frame(sensor: DvsSensor, frame: Frame) -> None:
    shape = sensor.positive_threshold.shape
    if frame.dtype != np.uint8 or frame.shape != shape:
        raise ValueError(f"a frame must be uint8 of shape {shape}, not {frame.dtype} of {frame.shape}")


NS = 1e-9


class EventCounter:
    """Counts the events of one sensor since they were last taken; `listed` also keeps the individual events."""

    def __init__(self, sensor: DvsSensor, listed: bool = False) -> None:
        self.sensor = sensor
        self._state: DvsState | None = None
        self._start_ns = 0
        self._counts: tuple[Counts, Counts] | None = None
        self._seen_ns: int | None = None
        self._events: list[Events] | None = [] if listed else None
        self.frames = 0
        """Frames seen since it was made, without each game's first one."""

    def start(self, frame: Frame, time_ns: int, noise_seed: int = 0) -> None:
        """Begin with a frame, which causes no events; time stamps count from it."""
        self._state, self._start_ns = init_state(self.sensor, frame, noise_seed=noise_seed), time_ns
        self._counts = self._seen_ns = None
        self.pop_events()

    def process_frame(self, frame: Frame, time_ns: int) -> None:
        """Process the next frame (H, W)."""
        assert self._state is not None
        self.frames += 1
        time_s = (time_ns - self._start_ns) * NS
        if self._events is None:
            self._state, on, off = step(self.sensor, self._state, frame, time_s)
        else:
            self._state, on, off, events = step_with_events(self.sensor, self._state, frame, time_s)
            self._events.append(events)
        before = self._counts
        self._counts = (on, off) if before is None else (on + before[0], off + before[1])
        self._seen_ns = time_ns

    def has_frame_of(self, time_ns: int) -> bool:
        """Return whether the last frame since `take` was of this time."""
        return self._seen_ns == time_ns

    def take(self) -> tuple[Counts, Counts]:
        """Return the ON and OFF counts (H, W) since the last call."""
        assert self._state is not None
        none = np.zeros(self._state.base_log.shape, np.int32)
        counts, self._counts, self._seen_ns = self._counts or (none, none), None, None
        return counts

    def pop_events(self) -> Events:
        """Return the events (n, 4) since the last call: rows (t in s, x, y, p) as in step_with_events."""
        taken, self._events = self._events, None if self._events is None else []
        return np.concatenate([NO_EVENTS, *(taken or [])])


def count_events(
    images: NDArray[np.uint8], times_ns: NDArray[np.int64], parameters: DvsParameters, sensor_seed: int
) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Return ON and OFF counts (n, H, W) of gray images (n, H, W) taken at times (n,); the first causes no events."""
    counter = EventCounter(make_sensor(parameters, images.shape[1:], sensor_seed))
    counter.start(images[0], int(times_ns[0]), sensor_seed)
    on, off = np.zeros((2, *images.shape), np.uint16)
    for i in range(1, len(images)):
        counter.process_frame(images[i], int(times_ns[i]))
        on[i], off[i] = counter.take()
    return on, off
