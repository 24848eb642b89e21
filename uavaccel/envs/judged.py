"""How a command ends, for many games at once: what `FlightEnv.step` decides of one."""

from __future__ import annotations

from typing import Any, NamedTuple

from uavaccel.envs.task import Course, Moments, Task


class Judged(NamedTuple):
    """Arrays (n,) of a command's games."""

    course: Course
    reward: Any
    success: Any
    terminated: Any
    truncated: Any


def judge(task: Task, before: Moments, flown: Moments) -> Judged:
    """Of games that were at `before` and have flown a command since."""
    now = flown._replace(course=task.advance(before, flown))
    success = task.success(now)
    terminated = success | task.failure(now)
    truncated = ~terminated & (now.commands >= task.max_commands)
    return Judged(now.course, task.reward(before, now), success, terminated, truncated)
