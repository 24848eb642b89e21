"""What the agent sees: frames of a command's samples, as arrays for a network.

Pictures are rendered at 256 x 144 and reduced to 64 x 36 by area, since a network learns ten times faster from that.
"""

from __future__ import annotations

from typing import Any, Protocol

import cv2
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from uavaccel.envs.task import LaneTask
from uavaccel.kinematics import Kinematics
from uavaccel.vision.dvs import PRESETS, DvsState, init_state, make_sensor, step
from uavaccel.vision.observation import BLOCK_SIDE, NEUTRAL_LEVEL, dvs_observation
from uavaccel.wire.image_api import HEIGHT, WIDTH

SIZE = (HEIGHT // BLOCK_SIDE, WIDTH // BLOCK_SIDE)  # rows, columns
DEPTH_FAR_M = 50.0  # seen as 255
STATE_FIELDS = ("position_m", "orientation_wxyz", "linear_velocity_m_s", "angular_velocity_rad_s")


class Sense(Protocol):
    """Turns samples into frames; `kind` of picture to ask for, None for none; `blank` stands for a missing frame."""

    kind: str | None
    blank: NDArray[Any]

    def begin(self, state: Kinematics, image: NDArray[Any]) -> None:
        """Take the picture of a game's start."""
        ...

    def frame(self, state: Kinematics, image: NDArray[Any]) -> NDArray[Any]:
        """The frame of a sample, of the shape and type of `blank`."""
        ...


class DvsSense:
    """Event images (1, 36, 64): 128 plus ON minus OFF events, summed over 4 x 4 pixels."""

    kind: str | None = "gray"

    def __init__(self, preset: str, seed: int) -> None:
        self.blank: NDArray[Any] = np.full((1, *SIZE), NEUTRAL_LEVEL, np.uint8)
        self._sensor = make_sensor(PRESETS[preset], (HEIGHT, WIDTH), seed)
        self._state: DvsState | None = None
        self._start_ns = 0

    def begin(self, state: Kinematics, image: NDArray[Any]) -> None:
        self._start_ns = state.time_ns
        self._state = init_state(self._sensor, image)

    def frame(self, state: Kinematics, image: NDArray[Any]) -> NDArray[Any]:
        assert self._state is not None
        time_s = (state.time_ns - self._start_ns) * 1e-9
        self._state, on, off = step(self._sensor, self._state, image, time_s)
        return dvs_observation(on, off)[None]


class ColourSense:
    """Red, green and blue (3, 36, 64)."""

    kind: str | None = "colour"

    def __init__(self) -> None:
        self.blank: NDArray[Any] = np.zeros((3, *SIZE), np.uint8)

    def begin(self, state: Kinematics, image: NDArray[Any]) -> None:
        pass

    def frame(self, state: Kinematics, image: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(_reduced(image).transpose(2, 0, 1))


class DepthSense:
    """Distance along the optical axis (1, 36, 64): 0 to 50 m as 0 to 255."""

    kind: str | None = "depth"

    def __init__(self) -> None:
        self.blank: NDArray[Any] = np.zeros((1, *SIZE), np.uint8)

    def begin(self, state: Kinematics, image: NDArray[Any]) -> None:
        pass

    def frame(self, state: Kinematics, image: NDArray[Any]) -> NDArray[Any]:
        depth = _reduced(np.minimum(image, np.float32(DEPTH_FAR_M)))
        return np.rint(depth * (255 / DEPTH_FAR_M)).astype(np.uint8)[None]


class StateSense:
    """Position, attitude, velocity and body rate (1, 13), in the units of `Kinematics`; no picture."""

    kind: str | None = None

    def __init__(self) -> None:
        self.blank: NDArray[Any] = np.zeros((1, 13), np.float32)

    def begin(self, state: Kinematics, image: NDArray[Any]) -> None:
        pass

    def frame(self, state: Kinematics, image: NDArray[Any]) -> NDArray[Any]:
        return np.concatenate([getattr(state, name) for name in STATE_FIELDS]).astype(np.float32)[None]


def make_sense(task: LaneTask) -> Sense:
    """The sense that a task names."""
    if task.observation == "dvs":
        return DvsSense(task.dvs_preset, task.dvs_seed)
    senses: dict[str, type[Sense]] = {"colour": ColourSense, "depth": DepthSense, "state": StateSense}
    return senses[task.observation]()


def observation_space(sense: Sense, frames: int) -> spaces.Box:
    """The space of `frames` frames, stacked along the first axis."""
    shape = (frames * sense.blank.shape[0], *sense.blank.shape[1:])
    if sense.blank.dtype == np.uint8:
        return spaces.Box(0, 255, shape, np.uint8)
    return spaces.Box(-np.inf, np.inf, shape, np.float32)


def _reduced(image: NDArray[Any]) -> NDArray[Any]:
    return np.asarray(cv2.resize(image, (SIZE[1], SIZE[0]), interpolation=cv2.INTER_AREA))
