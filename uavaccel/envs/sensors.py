"""Sensors of an agent: they turn the samples of a command into frames, arrays for a network.

Pictures are rendered at 256 x 144 and reduced to 64 x 36 by area, from which a network learns ten times faster. Beside
them there may be context planes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.arrays import cast, constant, namespace_of
from uavaccel.envs.values import Course, Frame, Number
from uavaccel.kinematics import Kinematics
from uavaccel.sim.camera.view import HEIGHT, WIDTH, AnyImage
from uavaccel.units import NS_PER_S
from uavaccel.vision.dvs_sensor import BLOCK_SIDE, NEUTRAL_LEVEL, DvsParameters, dvs_observation, make_sensor

SIZE = (HEIGHT // BLOCK_SIDE, WIDTH // BLOCK_SIDE)  # rows, columns
PICTURE_SIZE = (WIDTH, HEIGHT)  # columns, rows
DEPTH_FAR_M = 50.0  # shown as 255
STATE_FIELDS = ("position_m", "orientation_wxyz", "linear_velocity_m_s", "angular_velocity_rad_s")

Features = Callable[[Kinematics, Course], NDArray[np.float32]]


class Sensor(ABC):
    """Turns samples into frames; a sensor with a memory replaces `reset`.

    `picture` is the kind of picture it needs, None for none; `blank` stands for a missing frame.
    """

    picture: str | None = None

    def __init__(self, blank: Frame) -> None:
        self.blank = blank

    def reset(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        """Begin a game; returns the frame of its start."""
        return self.frame(state, image, course)

    @abstractmethod
    def frame(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        """Return the frame of a sample, with the shape and type of `blank`."""


class EventCamera(Sensor):
    """Event images (1, 36, 64): 128 plus ON minus OFF events since the last sample, summed over 4 x 4 pixels.

    `listed` also keeps the individual events. `noise_seed` seeds the next game's leak jitter and shot noise.
    """

    picture = "gray"
    noise_seed = 0

    def __init__(
        self, parameters: DvsParameters, seed: int, listed: bool = False, size: tuple[int, int] = PICTURE_SIZE
    ) -> None:
        from uavaccel.vision.dvs import EventCounter  # compiled

        super().__init__(blank_frame("dvs", size))
        self.counter = EventCounter(make_sensor(parameters, size[::-1], seed), listed)

    def reset(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        """Begin a game with this picture, which causes no events."""
        self.counter.start(image, state.time_ns, self.noise_seed)
        return self.blank

    def frame(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        """Return the events since the last sample, those of pictures that `counter` saw in between included."""
        if not self.counter.has_frame_of(state.time_ns):
            self.counter.process_frame(image, state.time_ns)
        on, off = self.counter.take()
        if on.shape == self.blank.shape[1:]:
            counts: Frame = np.clip(NEUTRAL_LEVEL + on.astype(np.int64) - off, 0, 255).astype(np.uint8)[None]
            return counts
        return dvs_observation(on, off)[None]


class ColourCamera(Sensor):
    """Red, green and blue (3, 36, 64)."""

    picture = "colour"

    def frame(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        return np.ascontiguousarray(_reduced(image, self.blank).transpose(2, 0, 1))


class DepthCamera(Sensor):
    """Distance along the optical axis (1, 36, 64): 0 to 50 m as 0 to 255."""

    picture = "depth"

    def frame(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        depth = _reduced(np.minimum(image, np.float32(DEPTH_FAR_M)), self.blank)
        levels: Frame = np.rint(depth * (255 / DEPTH_FAR_M)).astype(np.uint8)
        return levels[None]


class StateSensor(Sensor):
    """The task's features of the state, without a picture."""

    def __init__(self, features: Features, blank: NDArray[np.float32]) -> None:
        super().__init__(blank)
        self._features = features

    def frame(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        return np.asarray(self._features(state, course), np.float32)


def blank_frame(picture: Literal["dvs", "colour", "depth"], size: tuple[int, int] = PICTURE_SIZE) -> NDArray[np.uint8]:
    """Make a frame without content (C, rows, columns) of pictures of a size: no events, black, or a depth of 0."""
    rows_columns = SIZE if size == PICTURE_SIZE else size[::-1]
    planes = 3 if picture == "colour" else 1
    return np.full((planes, *rows_columns), NEUTRAL_LEVEL if picture == "dvs" else 0, np.uint8)


def _reduced(image: AnyImage, like: Frame) -> AnyImage:
    from uavaccel.sim.camera.pixels import quartered  # compiled

    return image if image.shape[:2] == like.shape[1:] else quartered(image)


ContextKind = Literal["last_action", "frame_age"]
FULL_LEVEL = 255
AGE_LEVEL_NS = NS_PER_S // 50  # simulated time per grey level: ages of 2.54 s and more are shown as 255
NO_ACTION = -1


class ContextPlanes:
    """Planes (len(knows), 36, 64) uint8, 128 where there is nothing to show.

    `last_action`: the width is divided into one part per heading, the westernmost on the left; the part of the last
    heading is white. `frame_age`: one horizontal band for each of `frames`, the oldest on top, one grey level brighter
    per 20 ms of simulated time that the frame is old. Under latency the pictures alone do not say where the vehicle
    will be when the next command acts; with these the task is Markov again (Katsikopoulos and Engelbrecht, IEEE TAC 48,
    2003; Xiao et al., "Thinking while moving", ICLR 2020; the library rtgym). Mirroring works on them too.
    """

    def __init__(self, knows: Sequence[ContextKind], headings_deg: Sequence[float], frames: int) -> None:
        self.knows, count = tuple(knows), len(headings_deg)
        self._action_planes = np.full((count + 1, *SIZE), NEUTRAL_LEVEL, np.uint8)
        for action, rank in enumerate(np.argsort(np.argsort(headings_deg)).tolist()):
            self._action_planes[action, :, _part(SIZE[1], rank, count)] = FULL_LEVEL
        bands = np.array_split(np.arange(SIZE[0]), frames)
        self._frame_of_row = np.repeat(np.arange(frames), [len(rows) for rows in bands])

    def observe(self, actions: Number, ages_ns: Number) -> Number:
        """Return the planes (n, planes, 36, 64) of n games: of their last actions (n,) and frames' ages (n, frames)."""
        xp, shown = namespace_of(actions), constant(self._action_planes, actions)[actions]
        levels = NEUTRAL_LEVEL + (ages_ns // AGE_LEVEL_NS).clip(0, FULL_LEVEL - NEUTRAL_LEVEL)
        aged = levels[:, constant(self._frame_of_row, actions)][:, :, None]
        both = {"last_action": shown, "frame_age": xp.broadcast_to(cast(aged, "uint8"), shown.shape)}
        return xp.stack([both[know] for know in self.knows], 1)


def _part(width: int, part: int, parts: int) -> slice:
    """Columns of one of `parts` parts of a width; part i from the right is the mirror image of part i from the left."""
    mirrored = part > (parts - 1) - part
    first = (parts - 1) - part if mirrored else part
    left, right = first * width // parts, (first + 1) * width // parts
    if first == (parts - 1) - first:  # the one in the middle
        right = width - left
    return slice(width - right, width - left) if mirrored else slice(left, right)
