"""Compile the kernels that tests load: `python -m tests.compile_kernels`.

First the CPU's, for every kind of scene and camera, which otherwise whoever first flies in them does, and then what
stands in for a GPU's. In one process, which keeps their parts: a process for each would compile most of these twice.
"""

from __future__ import annotations

from contextlib import closing
from importlib import import_module
from itertools import product
from typing import Any

import pytest

import uavaccel
from tests.host_kernels import stand_in
from tests.test_kernels_compile import FLOWN

# Of single precision, and of double for a low-pass filter.
CAMERAS: tuple[dict[str, Any], ...] = {"dvs_preset": "clean"}, {"dvs_preset": "noisy"}


def main() -> None:
    for task, camera in product(("lane", "navigate"), CAMERAS):
        fly_a_command(uavaccel.make_vec(task, 1, simulator="kernels", observation="dvs", max_commands=1, **camera))
    with pytest.MonkeyPatch.context() as patch:
        stand_in(patch)
        of_a_gpu = import_module("uavaccel.envs.cuda_batch").CudaBatch
        for kind, keys in FLOWN:
            fly_a_command(of_a_gpu(kind, 1, max_commands=1, **keys))


def fly_a_command(batch: Any) -> None:
    with closing(batch):
        batch.reset(seed=0)
        batch.step(batch.action_space.sample())


if __name__ == "__main__":
    main()
