"""A MODEL of Unreal's frames: images and continue-fors wait for one, and an image shows the pose of the last game tick.

Source: AirSim v1.8.1. An image is asked for in the game's next tick and read back by the render thread, which is up to
a frame behind (RenderRequest.cpp); frames keep no exact grid, so that the wait is taken as even between none and two
periods, one on average. simContinueForTime, too, returns with a frame (ASimModeWorldBase::continueForTime). The
rendered pawn is moved in the game's tick alone (ASimModeWorldBase::Tick), which does not come while the game is paused:
an image of a paused game shows the pose of the last tick before the pause.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco

from uavaccel.sim.saved import SavedState, State
from uavaccel.units import ceil_div


@dataclass
class Frames:
    """Frames of a game; with `period_ns` 0 there are none, and images are of the moment at which they are asked for.

    `wait_ns` draws how long a frame is waited for. `stale_pose`: images show the pose of the last tick of the game,
    which ticks at every multiple of `period_ns` of wall time unless paused. `after_continue`: the reply of a
    continue-for waits for a frame too.
    """

    period_ns: int = 0
    stale_pose: bool = False
    after_continue: bool = False
    wait_ns: Callable[[], int] = lambda: 0
    _shown: mujoco.MjData | None = field(default=None, repr=False)

    def drawn(self, asked_ns: int) -> int:
        """When an image asked for at `asked_ns` is there."""
        return asked_ns + self.wait_ns() if self.period_ns else asked_ns

    def continued(self, paused_ns: int) -> int:
        """When a continue-for replies that has paused at `paused_ns`."""
        return self.drawn(paused_ns) if self.after_continue else paused_ns

    def ticks(self, from_ns: int, to_ns: int) -> range:
        """The game's ticks after `from_ns` and not after `to_ns`; none where poses are not stale."""
        if not (self.period_ns and self.stale_pose):
            return range(0)
        first = ceil_div(from_ns + 1, self.period_ns) * self.period_ns
        return range(first, to_ns + 1, self.period_ns)

    def show(self, data: mujoco.MjData) -> None:
        """The game has ticked: images show the pose in `data` from now on."""
        self._shown = self._shown or mujoco.MjData(data.model)
        self._shown.qpos[:] = data.qpos

    def scene(self, data: mujoco.MjData) -> mujoco.MjData:
        """What a camera draws: the present `data`, or the pose that was shown last."""
        return self._shown or data

    def get_state(self) -> State:
        """The pose that is shown; empty where nothing has been shown yet."""
        return {"shown": [] if self._shown is None else self._shown.qpos.tolist()}

    def set_state(self, state: SavedState, data: mujoco.MjData) -> None:
        """Back to what `get_state` gave; `data` is of the same scene."""
        self.forget()
        if len(state["shown"]):
            self._shown = mujoco.MjData(data.model)
            self._shown.qpos[:] = state["shown"]

    def forget(self) -> None:
        """A new game: nothing has been shown yet."""
        self._shown = None
