"""An event counter: it accumulates a DVS's events over several frames until they are taken."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavaccel.vision.dvs import (
    NO_EVENTS,
    Counts,
    DvsParameters,
    DvsSensor,
    DvsState,
    Events,
    Frame,
    init_state,
    make_sensor,
    step,
    step_with_events,
)

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
