"""A MODEL of Unreal's frames: images and continue-fors wait for one, and it shows the pose of the last game tick.

Source: AirSim v1.8.1. The rendered pawn is moved in the game's tick alone (ASimModeWorldBase::Tick), which does not
come while the game is paused, so that an image of a paused game shows the pose of the last tick before the pause.
simContinueForTime returns, and pauses the game, once a new frame was rendered since it began
(ASimModeWorldBase::continueForTime); a frame that comes after the physics has stopped brings the pose up to date.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco

from uavaccel.units import ceil_div


@dataclass
class Frames:
    """Frames at every multiple of `period_ns` of wall time; 0: none, images are of the moment they are asked for.

    `stale_pose`: images show the pose of the last frame instead. `after_continue`: a continue-for replies with the
    first frame after its beginning, or when it is over, whichever is later.
    """

    period_ns: int = 0
    stale_pose: bool = False
    after_continue: bool = False
    _shown: mujoco.MjData | None = field(default=None, repr=False)

    def next_ns(self, wall_ns: int) -> int:
        """The first frame after `wall_ns`; without frames that moment itself."""
        return (wall_ns // self.period_ns + 1) * self.period_ns if self.period_ns else wall_ns

    def drawn_after(self, asked_ns: int) -> int:
        """When an image asked for at `asked_ns` is there."""
        return self.next_ns(asked_ns)

    def continue_over(self, begun_ns: int, paused_ns: int) -> int:
        """When a continue-for replies whose physics has stopped at `paused_ns`."""
        return max(paused_ns, self.next_ns(begun_ns)) if self.after_continue else paused_ns

    def between(self, from_ns: int, to_ns: int) -> list[int]:
        """The frames after `from_ns` and not after `to_ns`, in order; none where poses are not stale."""
        if not (self.period_ns and self.stale_pose):
            return []
        first = ceil_div(from_ns + 1, self.period_ns) * self.period_ns
        return list(range(first, to_ns + 1, self.period_ns))

    def show(self, data: mujoco.MjData) -> None:
        """The game has ticked: images show the pose in `data` from now on."""
        if self.stale_pose:
            self._shown = self._shown or mujoco.MjData(data.model)
            self._shown.qpos[:] = data.qpos

    def scene(self, data: mujoco.MjData) -> mujoco.MjData:
        """What a camera draws: the present `data`, or the pose that was shown last."""
        return self._shown or data

    def forget(self) -> None:
        """A new game: nothing has been shown yet."""
        self._shown = None
