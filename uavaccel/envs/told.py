"""What an agent is told beside its pictures, as further planes of them: its last action, and how old each frame is.

Under latency the pictures alone do not say where the vehicle will be when the next command acts; with the last action
and the age of what is seen the task is Markov again (Katsikopoulos and Engelbrecht, IEEE TAC 48, 2003; Xiao et al.,
"Thinking while moving", ICLR 2020; the library rtgym). As planes any learner takes them, and a mirror turns them too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.sensors import SIZE
from uavaccel.envs.values import Number
from uavaccel.sim.saved import SavedState, State
from uavaccel.units import NS_PER_S
from uavaccel.vision.observation import NEUTRAL_LEVEL

Knowledge = Literal["last_action", "frame_age"]
FULL_LEVEL = 255
AGE_LEVEL_NS = NS_PER_S // 50  # of simulated time, for a grey level: 2.54 s are seen as 255
NO_ACTION = -1


class ContextPlanes:
    """Planes (len(knows), 36, 64) uint8, 128 where nothing is said.

    `last_action`: white where the picture's width, cut into as many parts as there are headings, has the last one, the
    westernmost on the left. `frame_age`: a band for each of `frames`, the oldest on top, brighter by a level for each
    20 ms of simulated time that the frame is old.
    """

    def __init__(self, knows: Sequence[Knowledge], headings_deg: Sequence[float], frames: int) -> None:
        self.knows, self._frames = tuple(knows), frames
        ranks = np.argsort(np.argsort(headings_deg))
        self._columns = [_part(SIZE[1], int(rank), len(headings_deg)) for rank in ranks]
        self._bands = np.array_split(np.arange(SIZE[0]), frames)
        self.start(0)

    @property
    def planes(self) -> int:
        return len(self.knows)

    def start(self, time_ns: int) -> None:
        """A game begins: all frames are of its start, and nothing has been flown."""
        self._action, self._now_ns = NO_ACTION, time_ns
        self._taken_ns = deque([time_ns] * self._frames, maxlen=self._frames)

    def flown(self, action: int, taken_ns: Sequence[int], missing: int, now_ns: int) -> None:
        """A command was flown: when its frames were taken, how many are missing, and what time it is now."""
        self._action, self._now_ns = int(action), now_ns
        self._taken_ns.extend([*taken_ns, *[now_ns] * missing])

    def seen(self) -> NDArray[np.uint8]:
        """The planes of this moment."""
        drawn = {"last_action": self._last_action, "frame_age": self._frame_age}
        return np.stack([drawn[each]() for each in self.knows])

    def _last_action(self) -> NDArray[np.uint8]:
        plane = np.full(SIZE, NEUTRAL_LEVEL, np.uint8)
        if self._action != NO_ACTION:
            plane[:, self._columns[self._action]] = FULL_LEVEL
        return plane

    def _frame_age(self) -> NDArray[np.uint8]:
        plane = np.full(SIZE, NEUTRAL_LEVEL, np.uint8)
        for rows, taken_ns in zip(self._bands, self._taken_ns, strict=True):
            level = NEUTRAL_LEVEL + max(self._now_ns - taken_ns, 0) // AGE_LEVEL_NS
            plane[rows] = min(level, FULL_LEVEL)
        return plane

    def actions_shown(self) -> NDArray[np.uint8]:
        """`last_action` after each action (actions + 1, 36, 64), after none the last."""
        planes = np.full((len(self._columns) + 1, *SIZE), NEUTRAL_LEVEL, np.uint8)
        for action, columns in enumerate(self._columns):
            planes[action, :, columns] = FULL_LEVEL
        return planes

    def rows_frames(self) -> NDArray[np.int64]:
        """Which frame's age each row of `frame_age` shows (36,)."""
        return np.repeat(np.arange(self._frames), [len(rows) for rows in self._bands])

    def get_state(self) -> State:
        """What it remembers of the running game, for np.savez."""
        return {"action": self._action, "now_ns": self._now_ns, "taken_ns": list(self._taken_ns)}

    def set_state(self, state: SavedState) -> None:
        """Back to what `get_state` gave."""
        self._action, self._now_ns = int(state["action"]), int(state["now_ns"])
        self._taken_ns.extend(int(each) for each in state["taken_ns"])


def age_levels(ages_ns: Number) -> Number:
    """What `frame_age` shows of ages in simulated ns, an array of them: 128 to 255."""
    return NEUTRAL_LEVEL + (ages_ns // AGE_LEVEL_NS).clip(0, FULL_LEVEL - NEUTRAL_LEVEL)


def _part(width: int, part: int, parts: int) -> slice:
    """Columns of one of so many parts; those of a part from the right are its mirror image's."""
    mirrored = part > (parts - 1) - part
    first = (parts - 1) - part if mirrored else part
    left, right = first * width // parts, (first + 1) * width // parts
    if first == (parts - 1) - first:  # the one in the middle
        right = width - left
    return slice(width - right, width - left) if mirrored else slice(left, right)
