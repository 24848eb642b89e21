"""Accelerated, time-controlled quadrotor simulation, and what the acceleration costs.

Importing the package loads nothing heavy: each command line call pays only for the modules it uses. The environments
are registered as soon as both this package and Gymnasium have been imported, in whatever order; in processes that
import Gymnasium alone, its own form `gymnasium.make("uavaccel.envs:uavaccel/ObstacleLane-v0")` does that.
"""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "AirSimAdapter": "uavaccel.commands.airsim_adapter",
    "VelocityGoal": "uavaccel.kinematics",
    "adsc": "uavaccel.commands",
    "open_session": "uavaccel.wire.session",
    "tcsc": "uavaccel.commands",
}


def __getattr__(name: str) -> Any:
    """The names that a program begins with; each is imported when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module 'uavaccel' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


class _AfterGymnasium:
    """A finder that registers the environments after the first import of Gymnasium, which reads no entry points."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name != "gymnasium":
            return None
        others = (finder for finder in sys.meta_path if finder is not self)
        found = (finder.find_spec(name, path, target) for finder in others)
        spec = next((spec for spec in found if spec is not None), None)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: ModuleType) -> None:
                sys.meta_path.remove(self)
                execute(module)
                import_module("uavaccel.envs")

            spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec


if "gymnasium" in sys.modules:
    import_module("uavaccel.envs")
else:
    sys.meta_path.insert(0, _AfterGymnasium())
