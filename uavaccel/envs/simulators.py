"""The choice of a simulator for vectorised environments: the exact one, or kernels on the CPU or a GPU."""

from __future__ import annotations

from functools import partial
from importlib import import_module
from typing import Any, get_args

from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.flyable import CPU, CUDA, Device, Simulator
from uavaccel.envs.values import Batch
from uavaccel.errors import UserError
from uavaccel.resources import require

EXACT, KERNELS = get_args(Simulator)


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
