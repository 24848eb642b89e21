"""Which tasks the kernels can fly, on the CPU and on a GPU, and how they fly them."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Literal, get_args

from uavaccel.config import MOST_GAMES
from uavaccel.envs.checks import whole_number
from uavaccel.envs.sensors import PICTURE_SIZE
from uavaccel.envs.task import Task
from uavaccel.errors import UserError
from uavaccel.kernels.fields import COLOUR, DEPTH, DVS, STATE
from uavaccel.sim.lane.layout import PLAIN
from uavaccel.sim.profile import Profile
from uavaccel.units import exact
from uavaccel.wire.latency import ZERO_LATENCY, LatencyConfig

if TYPE_CHECKING:  # which compiles
    from uavaccel.sim.clutter import Clutter

# Largest numerator or denominator of a ClockSpeed: products with hours of nanoseconds must fit in 64 bits.
MOST_DIGITS = 1_000_000

KINDS = {"state": STATE, "dvs": DVS, "colour": COLOUR, "depth": DEPTH}

Simulator = Literal["mujoco", "kernels"]
"""The exact simulator, with MuJoCo and OpenGL, or lanes over arrays."""
Device = Literal["cpu", "cuda"]
"""Where lanes over arrays are flown."""
CPU, CUDA = get_args(Device)


def check_flyable(task: Task, lanes: int, device: str) -> None:
    """Raise UserError for a task that only the exact simulator flies, or on "cuda" only the CPU."""
    whole_number("num_envs", lanes, MOST_GAMES)
    if why := _why_not(task) or _why_no_clock(task):
        raise UserError(f"simulator = kernels: {why}; use simulator = mujoco")
    if device.startswith(CUDA) and (why := _why_not_on_gpu(task)):
        raise UserError(f"device = cuda: {why}; use device = cpu")


def kind_of(task: Task) -> int:
    """Return what lanes observe: STATE, DVS, COLOUR or DEPTH."""
    return STATE if task.blank_images else KINDS[task.observation]


def clutter_of(task: Task) -> Clutter | None:
    """Return the distribution that the worlds of a task's games are sampled from; None where all fly in one."""
    return getattr(task, "clutter", None) if task.scene == "clutter" else None


def passes_together(task: Task) -> bool:
    """Return whether all lanes advance by the same ticks, since messages take no time."""
    return (task.timing, task.profile, task.command) == ("lockstep", "native", "tcsc")


def _why_not(task: Task) -> str:
    if task.timing == "wall":
        return "timing wall needs a server of its own"
    if task.list_events:
        return "list_events needs single events, which the kernels do not keep"
    if task.scenery != PLAIN and kind_of(task) in (DVS, COLOUR):
        return f"difficulty.scenery = {task.scenery}: its looks are textured meshes; depth and state fly there"
    if task.scene == "clutter" and clutter_of(task) is None:
        return "scene = clutter needs a task with the key clutter, the distribution of its worlds"
    if task.scene == "lane" and task.picture_size != PICTURE_SIZE and kind_of(task) != STATE:
        return f"picture_size = {list(task.picture_size)}: the lane is rendered in [256, 144] only"
    return ""


def _why_not_on_gpu(task: Task) -> str:
    if passes_together(task):
        return ""
    if task.dvs_ticks:
        return "dvs_rate_hz needs command = tcsc, timing = lockstep and profile = native"
    if task.timing == "virtual" and kind_of(task) in (DVS, COLOUR) and task.scene != "lane":
        return "in timing = virtual event cameras and colour images need the guard, which a GPU has in the lane only"
    return ""


def _why_no_clock(task: Task) -> str:
    speeds = speed_of(task), exact(task.clock_speed)
    if any(max(speed.as_integer_ratio()) > MOST_DIGITS for speed in speeds):
        return f"clock_speed = {task.clock_speed} has more digits than lanes' clocks"
    return ""


def latency_of(task: Task) -> LatencyConfig:
    """Return the latency model of the task; zero in lockstep."""
    return task.latency if task.timing == "virtual" else ZERO_LATENCY


def profile_of(task: Task) -> Profile:
    """Return the profile of the task's simulation."""
    return latency_of(task).platform.profile(task.profile, task.clock_speed)


def speed_of(task: Task) -> Fraction:
    """Return the simulated seconds per wall second that are reached."""
    return latency_of(task).platform.executor().speed(exact(task.clock_speed), profile_of(task).tick_ns)
