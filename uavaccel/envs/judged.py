"""How a command ends, for many games at once: what `FlightEnv.step` decides of one."""

from __future__ import annotations

from typing import NamedTuple

from uavaccel.envs.task import Moments, Task
from uavaccel.envs.values import Course, Number


class Judged(NamedTuple):
    """Arrays (n,) of a command's games."""

    course: Course
    reward: Number
    success: Number
    terminated: Number
    truncated: Number


def judge(task: Task, before: Moments, flown: Moments) -> Judged:
    """Of games that were at `before` and have flown a command since."""
    now = flown._replace(course=task.advance(before, flown))
    success = task.success(now)
    terminated = success | task.failure(now)
    truncated = ~terminated & (now.commands >= task.max_commands)
    return Judged(now.course, task.reward(before, now), success, terminated, truncated)
