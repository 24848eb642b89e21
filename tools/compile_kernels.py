"""Compile the CPU's kernels for every kind of scene and camera: `python -m tools.compile_kernels`.

Otherwise whoever first flies in them does. `make test` compiles them on one core while another checks types.
"""

from __future__ import annotations

from contextlib import closing
from itertools import product
from typing import Any

import uavaccel

# Of single precision, and of double for a low-pass filter.
CAMERAS: tuple[dict[str, Any], ...] = {"dvs_preset": "clean"}, {"dvs_preset": "noisy"}


def main() -> None:
    for task, camera in product(("lane", "navigate"), CAMERAS):
        with closing(
            uavaccel.make_vec(task, 1, simulator="kernels", observation="dvs", max_commands=1, **camera)
        ) as batch:
            batch.reset(seed=0)
            batch.step(batch.action_space.sample())


if __name__ == "__main__":
    main()
