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

from uavaccel.units import ceil_div


@dataclass
class Frames:
    """Frames every `period_ns` of wall time; with 0 there are none, and an image shows the moment of its request.

    `wait_ns` samples the wait for a frame. With `stale_pose` images show the pose of the game's last tick, at multiples
    of `period_ns` of wall time unless it is paused. With `after_continue` the reply of a continue-for waits for a frame
    too.
    """

    period_ns: int = 0
    stale_pose: bool = False
    after_continue: bool = False
    wait_ns: Callable[[], int] = lambda: 0
    _shown: mujoco.MjData | None = field(default=None, repr=False)

    def ready_ns(self, asked_ns: int) -> int:
        """Return the wall time at which an image requested at `asked_ns` is ready."""
        return asked_ns + self.wait_ns() if self.period_ns else asked_ns

    def continued(self, paused_ns: int) -> int:
        """Return the wall time at which a continue-for replies that has paused at `paused_ns`."""
        return self.ready_ns(paused_ns) if self.after_continue else paused_ns

    def ticks(self, from_ns: int, to_ns: int) -> range:
        """Return the game's ticks after `from_ns` up to `to_ns`; none unless poses are stale."""
        if not (self.period_ns and self.stale_pose):
            return range(0)
        first = ceil_div(from_ns + 1, self.period_ns) * self.period_ns
        return range(first, to_ns + 1, self.period_ns)

    def show(self, data: mujoco.MjData) -> None:
        """Let images show the pose in `data` from now on: the game has ticked."""
        self._shown = self._shown or mujoco.MjData(data.model)
        self._shown.qpos[:] = data.qpos

    def scene(self, data: mujoco.MjData) -> mujoco.MjData:
        """Return what a camera renders: the pose shown last or, without any, the present `data`."""
        return self._shown or data

    def forget(self) -> None:
        """Forget the pose shown, for a new game."""
        self._shown = None
