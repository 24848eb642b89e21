"""The simulated wall clocks of lanes on one GPU: which ticks of a command pass, and when it is seen, lane by lane.

The clocks are kernels/timeline's, the same as of lanes on the CPU; here they are walked through sample by sample.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch as th

from uavaccel.envs.cuda_view import LaneView
from uavaccel.envs.kernel_plan import plan_of
from uavaccel.envs.stopwatch import PHASES
from uavaccel.envs.task import Task
from uavaccel.kernels import cuda as kernels
from uavaccel.kernels import cuda_clocks as clock_kernels
from uavaccel.kernels import timeline
from uavaccel.kernels.fields import STATE
from uavaccel.units import NS_PER_S

Advance = Callable[[th.Tensor, th.Tensor], None]
"""Let lanes (L,) uint8 fly so many ticks (L,) int64."""


class DeviceClocks:
    """Clocks of `count` lanes that fly a task's commands.

    `ticks` (L, S) are those of the last command's samples, of which a lane has `taken` (L,); `guards` says whether
    pictures are judged by their brightness.
    """

    def __init__(
        self, task: Task, count: int, device: th.device, hull: Any, now: Any, view: LaneView, advance: Advance
    ) -> None:
        plan = plan_of(task, hull, view.kind != STATE)
        self._timing_kept, self._timing = kernels.on_device(plan.timing, device)
        clocks = timeline.clocks(count, task.frames_per_command)
        self.tensors, self._clocks = kernels.on_device(clocks, device)
        self._kernels, self._now, self._view, self._advance = clock_kernels.compiled(), now, view, advance
        self._count, self._hold_ticks = count, plan.hold_ticks
        rules = plan.timing.rules
        self.guards, self._stale = bool(rules[timeline.GUARDED]), bool(rules[timeline.STALE_POSE])
        self._since_ns = int(rules[timeline.PROCESSING_NS] * rules[timeline.IS_ADSC])
        self._speed, self._tick_ns = float(task.clock_speed), plan.tick_ns
        self._legs = th.zeros(count, dtype=th.int64, device=device)
        self._looking = th.zeros(count, dtype=th.uint8, device=device)
        self._levels = th.zeros((count, 3), dtype=th.int64, device=device)

    # --- a game's start ---------------------------------------------------------------------------

    def begin(self, renewed: th.Tensor, rows: th.Tensor, scales: th.Tensor, games: Any) -> None:
        """Let the clocks of lanes whose games begin stand at their start, up to the first picture."""
        self._run(
            "begin", renewed, kernels.shared(rows), kernels.shared(scales), games, self._timing, self._clocks
        )

    def show_start(self, renewed: th.Tensor) -> None:
        """The first picture is asked for, and the simulation runs."""
        self._run("show_start", renewed, self._brightness(renewed), self._timing, self._clocks)

    # --- a command --------------------------------------------------------------------------------

    def issue(self, going: th.Tensor, directions: th.Tensor, games: Any) -> None:
        """Fly on until the commands act, and let them."""
        self._run("issue", going, self._now, self._timing, self._clocks, kernels.shared(self._legs))
        self._fly(going)
        self._run("take", going, self._hold_ticks, kernels.shared(directions), games, self._now)

    def reach(self, going: th.Tensor, sample: int) -> th.Tensor:
        """Fly to a command's next sample; which lanes (L,) uint8 have one, and are not over it already."""
        reached = (
            self._now,
            self._timing,
            self._clocks,
            kernels.shared(self._looking),
            kernels.shared(self._legs),
        )
        self._run("reach", going, sample, *reached)
        self._fly(self._looking)
        return self._looking

    def look(self, frames: th.Tensor) -> None:
        """See the sample that `reach` flew to, as Unreal's frames show it."""
        self._turn_to_shown()
        self._view.look(self._looking, frames)
        self._turn_to_shown()

    def leave(self, sample: int) -> None:
        """Go on after it."""
        brightness = self._brightness(self._looking)
        self._run("leave", self._looking, sample, brightness, self._now, self._timing, self._clocks)

    # --- what they say ----------------------------------------------------------------------------

    def charge(self, going: th.Tensor, duration_s: float, phase: str) -> None:
        """Work of the agents' between two commands: ADSC flies on meanwhile."""
        spent = going.long() * round(duration_s * NS_PER_S)
        self.tensors.row[:, timeline.NOW] += spent
        self.tensors.row[:, timeline.FIRST_PHASE + PHASES.index(phase)] += spent

    @property
    def wall_ns(self) -> th.Tensor:
        """Since the games began (L,)."""
        return self.tensors.row[:, timeline.NOW] - self.tensors.row[:, timeline.START]

    @property
    def phase_ns(self) -> th.Tensor:
        """(L, phases)."""
        return self.tensors.row[:, timeline.FIRST_PHASE :]

    def present_ns(self, ticks: th.Tensor, free: th.Tensor) -> th.Tensor:
        """Simulated time (L,) at which lanes at these ticks decide: ADSC flies on while pictures are worked on."""
        since_ns = (self._since_ns * free.double() * self._speed).round().long()
        return ticks * self._tick_ns + since_ns

    def taken_ns(self, present_ns: th.Tensor) -> tuple[th.Tensor, th.Tensor]:
        """Which samples (L, S) were seen before a touch, and of which simulated time the frames are."""
        places = th.arange(self.tensors.ticks.shape[1], device=present_ns.device)
        seen = places < self.tensors.taken[:, None]
        return seen, th.where(seen, self.tensors.ticks * self._tick_ns, present_ns[:, None])

    # --- inside -----------------------------------------------------------------------------------

    def _fly(self, which: th.Tensor) -> None:
        """Fly the legs, on the way to the pose that pictures show until the next one of Unreal's frames."""
        if self._stale:
            legs = kernels.shared(self._legs)
            to_shown = th.zeros_like(self._legs)
            self._run("split", which, self._now, self._clocks, legs, kernels.shared(to_shown))
            self._advance(which, to_shown.clamp(min=0))
            self._run("keep", which, self._now, self._clocks, kernels.shared(to_shown))
        self._advance(which, self._legs)

    def _turn_to_shown(self) -> None:
        """Put a lane's pose and the one that pictures show in each other's place; done twice, nothing has changed."""
        if self._stale:
            self._run("turn", self._looking, self._now, self._clocks)

    def _brightness(self, which: th.Tensor) -> Any:
        """What the guard judges pictures by: sums of levels (L, 3)."""
        if self.guards:
            self._view.add_levels(which, self._levels)
        return kernels.shared(self._levels)

    def _run(self, name: str, which: th.Tensor, *arguments: Any) -> None:
        grid = kernels.grid(self._count, kernels.FLYING_THREADS)
        getattr(self._kernels, name)[(*grid, kernels.stream())](kernels.shared(which), *arguments)
