"""What the agent sees: frames of a command's samples, as arrays for a network.

Pictures are rendered at 256 x 144 and reduced to 64 x 36 by area, since a network learns ten times faster from that.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.values import Course, Frame, Number
from uavaccel.kinematics import Kinematics
from uavaccel.sim.camera.view import HEIGHT, WIDTH, AnyImage
from uavaccel.sim.saved import SavedState, State
from uavaccel.vision.dvs_sensor import DvsParameters
from uavaccel.vision.dvs_sensor import make_sensor as make_dvs
from uavaccel.vision.observation import BLOCK_SIDE, NEUTRAL_LEVEL, dvs_observation

SIZE = (HEIGHT // BLOCK_SIDE, WIDTH // BLOCK_SIDE)  # rows, columns
DEPTH_FAR_M = 50.0  # seen as 255
STATE_FIELDS = ("position_m", "orientation_wxyz", "linear_velocity_m_s", "angular_velocity_rad_s")

Features = Callable[[Kinematics, Course], NDArray[np.float32]]


class Sensor(Protocol):
    """Turns samples into frames. `picture`: the kind to ask for, None for none; `blank` stands for a missing frame."""

    picture: str | None
    blank: Frame

    def reset(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        """Begin a game; the frame of its start."""
        ...

    def frame(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        """The frame of a sample, of the shape and type of `blank`."""
        ...

    def get_state(self) -> State:
        """What it remembers of the running game, for np.savez."""
        ...

    def set_state(self, state: SavedState) -> None:
        """Back to what `get_state` gave."""
        ...


class Memoryless(ABC):
    """A sensor whose frames depend on their own sample alone: it has no state."""

    def reset(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        return self.frame(state, image, course)

    @abstractmethod
    def frame(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        """As `Sensor.frame`."""

    def get_state(self) -> State:
        return {}

    def set_state(self, state: SavedState) -> None:
        assert not state


class EventCamera:
    """Event images (1, 36, 64): 128 plus ON minus OFF events since the last sample, summed over 4 x 4 pixels.

    `listed` keeps the events one by one too. `noise_seed` is that of the next game's leak jitter and shot noise.
    """

    picture: str | None = "gray"
    noise_seed = 0

    def __init__(self, parameters: DvsParameters, seed: int, listed: bool = False) -> None:
        from uavaccel.vision.event_counter import EventCounter  # compiled

        self.blank: Frame = blank_frame("dvs")
        self.counter = EventCounter(make_dvs(parameters, (HEIGHT, WIDTH), seed), listed)

    def reset(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        """Nothing has moved: no events."""
        self.counter.start(image, state.time_ns, self.noise_seed)
        return self.blank

    def frame(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        """The events since the last sample, this picture's and those of pictures that `counter` saw between."""
        if not self.counter.has_seen(state.time_ns):
            self.counter.look(image, state.time_ns)
        return dvs_observation(*self.counter.take())[None]

    def get_state(self) -> State:
        return self.counter.get_state()

    def set_state(self, state: SavedState) -> None:
        self.counter.set_state(from_arrays(state))


class ColourCamera(Memoryless):
    """Red, green and blue (3, 36, 64)."""

    picture: str | None = "colour"

    def __init__(self) -> None:
        self.blank: Frame = blank_frame("colour")

    def frame(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        return np.ascontiguousarray(_reduced(image).transpose(2, 0, 1))


class DepthCamera(Memoryless):
    """Distance along the optical axis (1, 36, 64): 0 to 50 m as 0 to 255."""

    picture: str | None = "depth"

    def __init__(self) -> None:
        self.blank: Frame = blank_frame("depth")

    def frame(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        depth = _reduced(np.minimum(image, np.float32(DEPTH_FAR_M)))
        levels: Frame = np.rint(depth * (255 / DEPTH_FAR_M)).astype(np.uint8)
        return levels[None]


class StateSensor(Memoryless):
    """The task's features of the state; no picture."""

    picture: str | None = None

    def __init__(self, features: Features, blank: NDArray[np.float32]) -> None:
        self.blank: Frame = blank
        self._features = features

    def frame(self, state: Kinematics, image: AnyImage, course: Course) -> Frame:
        return self._features(state, course)


def blank_frame(picture: Literal["dvs", "colour", "depth"]) -> NDArray[np.uint8]:
    """A frame without content (C, 36, 64): no events, black, or all at hand."""
    planes = 3 if picture == "colour" else 1
    return np.full((planes, *SIZE), NEUTRAL_LEVEL if picture == "dvs" else 0, np.uint8)


def make_sensor(
    observation: str,
    features: Features,
    blank: NDArray[np.float32],
    dvs: DvsParameters,
    dvs_seed: int,
    listed: bool,
) -> Sensor:
    """The sensor of an observation's name; `features`, and a frame of them without content, are for "state"."""
    if observation == "state":
        return StateSensor(features, blank)
    if observation == "dvs":
        return EventCamera(dvs, dvs_seed, listed)
    cameras: dict[str, type[ColourCamera | DepthCamera]] = {"colour": ColourCamera, "depth": DepthCamera}
    return cameras[observation]()


def from_arrays(state: SavedState) -> State:
    """Arrays as they are, and single numbers, which np.load gives back as arrays without a shape, as numbers."""
    arrays = {name: np.asarray(value) for name, value in state.items()}
    return {name: each if each.ndim else each.item() for name, each in arrays.items()}


def state_fields(state: Kinematics) -> list[Number]:
    """Position, attitude, velocity and body rate, 13 numbers, in the units of `Kinematics`; or 13 arrays."""
    return [number for name in STATE_FIELDS for number in getattr(state, name)]


def _reduced(image: AnyImage) -> AnyImage:
    import cv2

    return np.asarray(cv2.resize(image, (SIZE[1], SIZE[0]), interpolation=cv2.INTER_AREA))
