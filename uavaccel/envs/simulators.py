"""The choice of a simulator, the exact one or kernels on the CPU or a GPU, and which tasks the kernels can fly."""

from __future__ import annotations

from fractions import Fraction
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from uavaccel.config import MOST_GAMES, Config
from uavaccel.envs.agreement import check_agreement
from uavaccel.envs.arrays import full, joined, stacked
from uavaccel.envs.checks import Functions, as_sampled, whole_number
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.sensors import PICTURE_SIZE
from uavaccel.envs.task import Task
from uavaccel.envs.values import Batch, Collisions, Moments
from uavaccel.errors import UserError
from uavaccel.kernels.fields import COLOUR, DEPTH, DVS, STATE
from uavaccel.kinematics import FlightGoal, Kinematics
from uavaccel.resources import require
from uavaccel.sim.profile import Profile
from uavaccel.sim.scene import PLAIN
from uavaccel.units import exact
from uavaccel.wire.latency import ZERO_LATENCY, LatencyConfig

if TYPE_CHECKING:  # which compiles
    from uavaccel.sim.clutter import Clutter

# Largest numerator or denominator of a ClockSpeed: products with hours of nanoseconds must fit in 64 bits.
MOST_DIGITS = 1_000_000

KINDS = {"state": STATE, "dvs": DVS, "colour": COLOUR, "depth": DEPTH}

SHARED = ("clock_speed", "dvs_rate_hz", "image_processing_s", "mediation", "t_move_s", "t_sample_s", "t_th_wall_s")
"""Keys in which the games of a batch do not differ, though they are fractions or mappings."""

Simulator = Literal["mujoco", "kernels"]
"""The exact simulator, with MuJoCo and OpenGL, or lanes over arrays."""
Device = Literal["cpu", "cuda"]
"""Where lanes over arrays are flown."""
CPU, CUDA = get_args(Device)
EXACT, KERNELS = get_args(Simulator)


def check_flyable(task: Task, lanes: int, device: str) -> None:
    """Raise UserError for a task that only the exact simulator flies, or on "cuda" only the CPU."""
    whole_number("num_envs", lanes, MOST_GAMES)
    kind, size, scene = kind_of(task), task.picture_size, task.scene
    digits = max(max(speed.as_integer_ratio()) for speed in (speed_of(task), exact(task.clock_speed)))
    reasons = {
        "timing wall needs a server of its own": task.timing == "wall",
        "list_events needs single events, which the kernels do not keep": task.list_events,
        f"difficulty.scenery = {task.scenery}: its looks are textured meshes; depth and state fly there": (
            task.scenery != PLAIN and kind in (DVS, COLOUR)
        ),
        "scene = clutter needs a task with the key clutter, the distribution of its worlds": (
            scene == "clutter" and clutter_of(task) is None
        ),
        f"picture_size = {list(size)}: the lane is rendered in [256, 144] only": (
            scene == "lane" and size != PICTURE_SIZE and kind != STATE
        ),
        f"the action space {task.action_space()} is not of arrays": task.action_space().shape is None,
        f"clock_speed = {task.clock_speed} has more digits than lanes' clocks": digits > MOST_DIGITS,
    }
    if why := next((reason for reason, holds in reasons.items() if holds), None):
        raise UserError(f"simulator = kernels: {why}; use simulator = mujoco")
    if not device.startswith(CUDA) or passes_together(task):
        return
    if task.dvs_ticks:
        raise UserError(
            "device = cuda: dvs_rate_hz needs command = tcsc, timing = lockstep and profile = native; use device = cpu"
        )
    if task.timing == "virtual" and kind in (DVS, COLOUR) and scene != "lane":
        raise UserError(
            "device = cuda: in timing = virtual event cameras and colour images need the guard, which a GPU has in the "
            "lane only; use device = cpu"
        )


def check_conditions(task: Task, under: Task) -> None:
    """Raise UserError for a task under a game's conditions that differs in a key which all games over arrays share."""
    for name, key in task:
        if (now := getattr(under, name)) is key or now == key:
            continue
        if name in SHARED or not isinstance(key, float | Config):
            what = f"changes {name}: over arrays games differ in keys of type float, but not in {', '.join(SHARED)}"
            raise Functions(task).wrong("with_conditions", f"{what}; or use simulator = mujoco")


def kind_of(task: Task) -> int:
    """Return what lanes observe: STATE, DVS, COLOUR or DEPTH."""
    return STATE if task.blank_images else KINDS[task.observation]


def clutter_of(task: Task) -> Clutter | None:
    """Return the distribution that the worlds of a task's games are sampled from; None where all fly in one."""
    return getattr(task, "clutter", None) if task.scene == "clutter" else None


def passes_together(task: Task) -> bool:
    """Return whether all lanes advance by the same ticks, since messages take no time."""
    return (task.timing, task.profile, task.command) == ("lockstep", "native", "tcsc")


def latency_of(task: Task) -> LatencyConfig:
    """Return the latency model of the task; zero in lockstep."""
    return task.latency if task.timing == "virtual" else ZERO_LATENCY


def profile_of(task: Task) -> Profile:
    """Return the profile of the task's simulation."""
    return latency_of(task).platform.profile(task.profile, task.clock_speed)


def speed_of(task: Task) -> Fraction:
    """Return the simulated seconds per wall second that are reached."""
    return latency_of(task).platform.executor().speed(exact(task.clock_speed), profile_of(task).tick_ns)


def flies_over_arrays(task: Task) -> bool:
    """Return whether the kernels can fly a task: its functions, too, compute with arrays as with numbers."""
    space, like = task.action_space(), np.zeros(2)
    none, actions = like.astype(np.int64), np.zeros((2, *(space.shape or ())), space.dtype)
    state = Kinematics(none, *([like] * size for size in (3, 4, 3, 3, 3, 3)))  # type: ignore[arg-type]
    try:
        check_flyable(task, 1, CPU)
        check_agreement(task)
        check_conditions(task, task.with_conditions(task.sample_conditions(np.random.default_rng(0), 0)))
        course = stacked([task.sample(np.random.default_rng(game), {}) for game in range(2)])
        begun = Moments(state, list(state.position_m), Collisions(none - 1, ()), none, course)
        goal = task.goal(actions.T)
        now = begun._replace(course=as_sampled(task, task.advance(begun, begun), course))
        seen = task.fields(state, course) if type(task).features is Task.features else ()
        numbers = [task.reward(begun, now), task.success(now), task.failure(now), *seen]
        flat = joined([full(number, like) for number in numbers], like)
        return isinstance(goal, get_args(FlightGoal)) and flat.shape[0] == 2
    except Exception:  # whatever own code does with an array that it did not expect
        return False


def make_batch(
    environment: type[FlightEnv[Any]],
    num_envs: int = 1,
    simulator: Simulator = "mujoco",
    device: Device = "cpu",
    **keys: Any,
) -> Batch:
    """Make `num_envs` environments of a class, flown by `simulator` on `device`, with their keywords.

    Raises UserError for an unknown or missing simulator or device, and as the batches themselves.
    """
    check_simulator(simulator, device)
    if simulator == EXACT:
        from uavaccel.envs.batch import EnvironmentBatch

        return EnvironmentBatch(environment, num_envs, **keys)
    if keys.pop("processes", None) is not None:
        raise UserError("processes: needs simulator = mujoco; the kernels fly in one process")
    if keys.pop("render_mode", None) is not None:
        raise UserError("render_mode: needs simulator = mujoco; the kernels render observations only")
    if device == CUDA:
        from uavaccel.envs.cuda_batch import CudaBatch

        return CudaBatch(environment, num_envs, **keys)
    from uavaccel.envs.kernel_batch import KernelBatch

    return KernelBatch(environment, num_envs, **keys)


def check_simulator(simulator: str, device: str) -> None:
    """Raise UserError for an unknown simulator or device, and if this machine has no GPU or lacks numba-cuda."""
    check_names(simulator, device)
    if device == CPU:
        return
    require("numba_cuda", "device = cuda", "gpu", "numba-cuda")
    import torch as th

    if not th.cuda.is_available():
        raise UserError("device = cuda: PyTorch finds no GPU here; take device = cpu")


def check_names(simulator: str, device: str) -> None:
    """Raise UserError for an unknown simulator or device, whatever this machine has."""
    for name, value, known in (("simulator", simulator, Simulator), ("device", device, Device)):
        if value not in get_args(known):
            raise UserError(f"{name} = {value!r} is unknown; there are {', '.join(get_args(known))}")
    if simulator == EXACT and device != CPU:
        raise UserError("device = cuda: simulator = mujoco flies on the CPU; take simulator = kernels for a GPU")


def flown_by(simulator: str, device: str) -> str:
    """Name simulator and device in words; empty for the exact simulator, which is assumed if nothing is said."""
    return "" if simulator == EXACT else f"simulator kernels on {'a GPU' if device == CUDA else 'the CPU'}"


def _batch_of(place: str, num_envs: int = 1, **keys: Any) -> Batch:
    """Make what `gymnasium.make_vec` makes of an environment that ships, by its module and class."""
    module, _, name = place.partition(":")
    return make_batch(getattr(import_module(f"uavaccel.envs.{module}"), name), num_envs, **keys)


obstacle_lanes, hovers, gates, navigations = (
    partial(_batch_of, place)
    for place in ("obstacle_lane:ObstacleLane", "hover:Hover", "gates:Gates", "navigate:Navigate")
)
