"""Context planes: extra observations beside the pictures, as planes of the same size: the last action, frame ages.

Under latency the pictures alone do not say where the vehicle will be when the next command acts; with the last action
and the age of what is seen the task is Markov again (Katsikopoulos and Engelbrecht, IEEE TAC 48, 2003; Xiao et al.,
"Thinking while moving", ICLR 2020; the library rtgym). Any learner can take planes, and mirroring works on them too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.arrays import cast, constant, namespace_of
from uavaccel.envs.sensors import SIZE
from uavaccel.envs.values import Number
from uavaccel.units import NS_PER_S
from uavaccel.vision.dvs_sensor import NEUTRAL_LEVEL

ContextKind = Literal["last_action", "frame_age"]
FULL_LEVEL = 255
AGE_LEVEL_NS = NS_PER_S // 50  # simulated time per grey level: ages of 2.54 s and more are shown as 255
NO_ACTION = -1


class ContextPlanes:
    """Planes (len(knows), 36, 64) uint8, 128 where there is nothing to show.

    `last_action`: the width is divided into one part per heading, the westernmost on the left; the part of the last
    heading is white. `frame_age`: one horizontal band for each of `frames`, the oldest on top, one grey level brighter
    per 20 ms of simulated time that the frame is old.
    """

    def __init__(self, knows: Sequence[ContextKind], headings_deg: Sequence[float], frames: int) -> None:
        self.knows, self._frames = tuple(knows), frames
        count = len(headings_deg)
        self._action_planes = np.full((count + 1, *SIZE), NEUTRAL_LEVEL, np.uint8)
        for action, rank in enumerate(np.argsort(np.argsort(headings_deg)).tolist()):
            self._action_planes[action, :, _part(SIZE[1], rank, count)] = FULL_LEVEL
        bands = np.array_split(np.arange(SIZE[0]), frames)
        self._frame_of_row = np.repeat(np.arange(frames), [len(rows) for rows in bands])
        self.start(0)

    @property
    def planes(self) -> int:
        """Number of planes."""
        return len(self.knows)

    def start(self, time_ns: int) -> None:
        """Begin a game at that simulated time: all frames are from its start, and there is no last action."""
        self._action, self._now_ns = NO_ACTION, time_ns
        self._taken_ns = deque([time_ns] * self._frames, maxlen=self._frames)

    def update(self, action: int, taken_ns: Sequence[int], missing: int, now_ns: int) -> None:
        """Note a command: when its frames were taken, how many are missing, and the present time, all simulated."""
        self._action, self._now_ns = int(action), now_ns
        self._taken_ns.extend([*taken_ns, *[now_ns] * missing])

    def observe(self) -> NDArray[np.uint8]:
        """Return the present planes."""
        ages_ns = self._now_ns - np.array(self._taken_ns)
        planes: NDArray[np.uint8] = self.observe_many(np.array([self._action]), ages_ns[None])[0]
        return planes

    def observe_many(self, actions: Number, ages_ns: Number) -> Number:
        """Return the planes (n, planes, 36, 64) of n games: of their last actions (n,) and frames' ages (n, frames)."""
        xp, shown = namespace_of(actions), constant(self._action_planes, actions)[actions]
        aged = age_levels(ages_ns)[:, constant(self._frame_of_row, actions)][:, :, None]
        both = {"last_action": shown, "frame_age": xp.broadcast_to(cast(aged, "uint8"), shown.shape)}
        return xp.stack([both[know] for know in self.knows], 1)


def age_levels(ages_ns: Number) -> Number:
    """Return the grey levels, 128 to 255, that `frame_age` shows for an array of ages in simulated ns."""
    return NEUTRAL_LEVEL + (ages_ns // AGE_LEVEL_NS).clip(0, FULL_LEVEL - NEUTRAL_LEVEL)


def _part(width: int, part: int, parts: int) -> slice:
    """Columns of one of `parts` parts of a width; part i from the right is the mirror image of part i from the left."""
    mirrored = part > (parts - 1) - part
    first = (parts - 1) - part if mirrored else part
    left, right = first * width // parts, (first + 1) * width // parts
    if first == (parts - 1) - first:  # the one in the middle
        right = width - left
    return slice(width - right, width - left) if mirrored else slice(left, right)
