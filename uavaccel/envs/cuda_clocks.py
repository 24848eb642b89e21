"""The simulated wall clocks of lanes on one GPU: which ticks pass in a command, and when its samples are taken.

The clocks are those of lanes on the CPU (kernels/timeline), advanced in all lanes from sample to sample.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch as th

from uavaccel.envs.cuda_view import View
from uavaccel.envs.kernel_games import plan_of
from uavaccel.envs.stopwatch import PHASES
from uavaccel.envs.task import Task
from uavaccel.kernels import cuda as kernels
from uavaccel.kernels import timeline
from uavaccel.kernels.fields import STATE

Advance = Callable[[th.Tensor, th.Tensor], None]
"""Flies the lanes selected by a flag (L,) uint8 for ticks (L,) int64."""


class DeviceClocks:
    """The clocks of `count` lanes that fly a task's commands.

    `tensors` is a kernels/timeline.Clocks of tensors; `guards` says whether the guard checks images (vision/guard).
    """

    def __init__(
        self, task: Task, count: int, device: th.device, modes: Any, now: Any, view: View, advance: Advance
    ) -> None:
        plan = plan_of(task, np.zeros(3), modes, view.kind != STATE)
        self._modes = th.tensor(modes, device=device)
        self._timing_tensors, self._timing = kernels.on_device(plan.timing, device)
        clocks = timeline.clocks(count, task.frames_per_command)
        self.tensors, self._clocks = kernels.on_device(clocks, device)
        self._now, self._view, self._advance = now, view, advance
        self._hold_ticks = plan.hold_ticks
        rules = plan.timing.rules
        self.guards, self._stale = bool(rules[timeline.GUARDED]), bool(rules[timeline.STALE_POSE])
        self._legs = th.zeros(count, dtype=th.int64, device=device)
        self._rendering = th.zeros(count, dtype=th.uint8, device=device)
        self._levels = th.zeros((count, 3), dtype=th.int64, device=device)

    # --- a game's start ---------------------------------------------------------------------------

    def begin(self, renewed: th.Tensor, rows: th.Tensor, scales: th.Tensor, games: Any) -> None:
        """Start the clocks of games in `rows` (L,), with these latency scales, up to their first image."""
        self._run(
            "begin_clocks", renewed, kernels.shared(rows), kernels.shared(scales), games, self._timing, self._clocks
        )

    def show_start(self, renewed: th.Tensor) -> None:
        """Account for the first image, and prepare the simulation for the first command."""
        self._run("show_start", renewed, self._brightness(renewed), self._timing, self._clocks)

    # --- a command --------------------------------------------------------------------------------

    def issue(self, going: th.Tensor, goals: th.Tensor) -> None:
        """Issue commands, fly until they take effect, and apply their goals (L, 4)."""
        self._run("issue", going, self._now, self._timing, self._clocks, kernels.shared(self._legs))
        self._fly(going)
        self._run("take", going, self._hold_ticks, kernels.shared(goals), kernels.shared(self._modes), self._now)

    def reach(self, going: th.Tensor, sample: int) -> th.Tensor:
        """Fly to a command's next sample, and return which lanes (L,) uint8 have one."""
        reached = (self._now, self._timing, self._clocks, kernels.shared(self._rendering), kernels.shared(self._legs))
        self._rendering.zero_()
        self._run("reach", going, sample, *reached)
        self._fly(self._rendering)
        return self._rendering

    def render(self, frames: th.Tensor) -> None:
        """Observe the sample that `reach` flew to, at the pose of Unreal's latest frame."""
        self._swap_displayed_pose()
        self._view.render(self._rendering, frames)
        self._swap_displayed_pose()

    def leave(self, sample: int) -> None:
        """Continue after the sample."""
        brightness = self._brightness(self._rendering)
        self._run("leave", self._rendering, sample, brightness, self._now, self._timing, self._clocks)

    # --- times ----------------------------------------------------------------------------

    def charge(self, spent_ns: th.Tensor, phase: str) -> None:
        """Charge the lanes (L,) for their agents' work between two commands; with ADSC they fly on meanwhile."""
        self.tensors.row[:, timeline.NOW] += spent_ns
        self.tensors.row[:, timeline.FIRST_PHASE + PHASES.index(phase)] += spent_ns

    @property
    def wall_ns(self) -> th.Tensor:
        """Wall time (L,) since the games began."""
        return self.tensors.row[:, timeline.NOW] - self.tensors.row[:, timeline.START]

    @property
    def phase_ns(self) -> th.Tensor:
        """Wall time (L, phases) spent in each phase."""
        return self.tensors.row[:, timeline.FIRST_PHASE :]

    # --- inside -----------------------------------------------------------------------------------

    def _fly(self, which: th.Tensor) -> None:
        """Fly the legs, and on the way store the pose that images show until Unreal's next frame."""
        if self._stale:
            legs = kernels.shared(self._legs)
            to_shown = th.zeros_like(self._legs)
            self._run("split", which, self._now, self._clocks, legs, kernels.shared(to_shown))
            self._advance(which, to_shown.clamp(min=0))
            self._run("save_shown", which * (to_shown >= 0), self._now, self._clocks)
        self._advance(which, self._legs)

    def _swap_displayed_pose(self) -> None:
        """Swap the lanes' poses with those that images show; a second call restores both."""
        if self._stale:
            self._run("turn_to_shown", self._rendering, self._now, self._clocks)

    def _brightness(self, which: th.Tensor) -> Any:
        """Return the sums of levels (L, 3) by which the guard judges images."""
        if self.guards:
            self._view.add_levels(which, self._levels)
        return kernels.shared(self._levels)

    def _run(self, name: str, which: th.Tensor, *arguments: Any) -> None:
        kernels.in_each_lane(getattr(self._view.kernels, name), which, *arguments)
