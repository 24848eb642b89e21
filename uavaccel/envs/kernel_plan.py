"""How lanes over arrays fly a task's commands, and what they cannot fly."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from uavaccel.commands.slices import samples_due
from uavaccel.envs.task import Task
from uavaccel.errors import UserError
from uavaccel.kernels.cpu import Command
from uavaccel.sim.profile import PROFILES
from uavaccel.units import ceil_div, exact

Simulator = Literal["mujoco", "kernels"]
"""Who flies: MuJoCo and OpenGL, exact, or lanes over arrays."""


def check_flyable(task: Task, lanes: int) -> None:
    """Raise UserError, one line, for what only the exact simulator flies."""
    if lanes < 1:
        raise UserError(f"num_envs = {lanes}: must be at least 1")
    why = _why_not(task)
    if why:
        raise UserError(f"simulator = kernels: {why}; use simulator = mujoco")


def _why_not(task: Task) -> str:
    if task.timing == "wall":
        return "timing wall needs a server of its own"
    if task.timing == "virtual" or task.profile != "native":
        return f"timing {task.timing} with profile {task.profile} is not flown there"
    if task.list_events:
        return "list_events keeps no events one by one there"
    if task.scenery != "plain":
        return f"difficulty.scenery = {task.scenery}: meshes are not drawn there"
    if task.scene != "lane" and task.observation != "state":
        return f"observation {task.observation} is drawn in the lane alone"
    for name in ("goal", "features"):
        if getattr(type(task), name).__module__.partition(".")[0] != Task.__module__.partition(".")[0]:
            return f"{type(task).__name__}.{name} is one's own, and flown for one game at a time"
    return ""


def slices_of(task: Task) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Ticks of a command's samples (S,), and nanoseconds of the simulated wall clock that each takes in lockstep."""
    profile = PROFILES[task.profile]
    due_ns = [0, *samples_due(task.t_move_s, task.t_sample_s)]
    ticks = [(later - earlier) // profile.tick_ns for earlier, later in pairwise(due_ns)]
    speed = exact(task.clock_speed)
    wall_ns = [ceil_div(each * profile.tick_ns * speed.denominator, speed.numerator) for each in ticks]
    return np.array(ticks), np.array(wall_ns)


def plan_of(task: Task, hull: Any) -> Command:
    """A command of the task's, for vehicles with this hull."""
    return Command(slices_of(task)[0], task.dvs_ticks or 0, PROFILES[task.profile].tick_ns, hull)
