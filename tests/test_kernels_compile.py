"""Every kernel of a GPU compiles for one, which needs none: numba-cuda and the compiler of a CUDA toolkit."""

from __future__ import annotations

from contextlib import closing
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests import host_kernels as host
from tests.host_kernels import host_kernels  # noqa: F401 - a fixture
from uavaccel.envs.gates import Gates
from uavaccel.envs.kernel_games import GameMaker
from uavaccel.envs.navigate import Navigate
from uavaccel.envs.obstacle_lane import ObstacleLane

COMPUTE_CAPABILITY = (9, 0)
NOISY, RESTING = {"dvs_preset": "noisy"}, {"dvs_preset": "command_line", "dvs_rate_hz": 100.0}
ADSC = {"command": "adsc", "timing": "virtual", "profile": "airsim"}
FLOWN: list[tuple[Any, dict[str, Any]]] = [
    *((ObstacleLane, {"observation": kind}) for kind in ("dvs", "colour", "depth", "state")),
    *((ObstacleLane, NOISY | ADSC | {"observation": kind}) for kind in ("dvs", "colour")),
    (ObstacleLane, RESTING),
    (ObstacleLane, {"mediation": {"gap_s": 0.1, "start_speed": 0.5}}),
    *((Navigate, {"observation": kind}) for kind in ("dvs", "colour")),
    *((Navigate, sensor | {"observation": "dvs"}) for sensor in (NOISY, RESTING)),
    (Gates, {"observation": "depth", "action": "rates", "t_move_s": 0.02, "t_sample_s": 0.02}),
]


@pytest.fixture
def launched(host_kernels: None, monkeypatch: pytest.MonkeyPatch) -> set[tuple[str, Any]]:  # noqa: F811
    """What is launched from now on: the kernel's name, and the types of its arguments."""
    pytest.importorskip("numba_cuda")
    from numba import cuda, types
    from numba.cuda.typing.typeof import typeof

    try:
        cuda.compile(lambda: None, types.void(), cc=COMPUTE_CAPABILITY, abi="numba")
    except Exception as error:
        pytest.skip(f"no compiler of a CUDA toolkit: {error}")

    def type_of(argument: Any) -> Any:
        if isinstance(argument, int | np.integer):
            return types.int64
        if isinstance(argument, tuple) and hasattr(argument, "_fields"):
            return types.NamedTuple([*map(type_of, argument)], type(argument))
        return typeof(argument)

    found: set[tuple[str, Any]] = set()
    made = host.Kernels.__getattr__

    def kernel(self: Any, name: str) -> Any:
        def run(*arguments: Any) -> None:
            found.add((name, tuple(map(type_of, arguments))))
            made(self, name)[1](*arguments)

        return host.launch(run)

    monkeypatch.setattr(host.Kernels, "__getattr__", kernel)
    return found


@pytest.mark.slow
def test_every_kernel_compiles_for_a_gpu_where_there_is_none(
    launched: set[tuple[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    from uavaccel.envs.cuda_batch import CudaBatch

    for kind, keys in FLOWN:
        with closing(CudaBatch(kind, 2, max_commands=2, **keys)) as batch:
            batch.reset(seed=0)
            for _ in range(2):
                batch.step(batch.action_space.sample())
    monkeypatch.undo()  # the kernels themselves from here on
    target = SimpleNamespace(compute_capability=COMPUTE_CAPABILITY)
    monkeypatch.setattr("numba.cuda.dispatcher.get_current_device", lambda: target)
    from numba import cuda, types

    from uavaccel.kernels import cuda as kernels

    made = kernels.compiled(GameMaker(Gates().task).nominal)
    for name, arguments in sorted(launched, key=str):
        function = getattr(made, name).py_func
        cuda.compile(function, types.void(*arguments), device=False, cc=COMPUTE_CAPABILITY, output="ptx", abi="numba")
