"""Accelerated, time-controlled quadrotor simulation, and what the acceleration costs.

Importing the package loads nothing heavy: each command line call pays only for the modules it uses. With Gymnasium,
whichever of the two is imported first, `gymnasium.make("uavaccel/ObstacleLane-v0")` works.
"""

import sys
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
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


def _register_environments() -> None:
    from gymnasium.envs.registration import register

    register("uavaccel/ObstacleLane-v0", entry_point="uavaccel.envs.obstacle_lane:ObstacleLane")


class _AfterGymnasium(MetaPathFinder):
    """Registers the environments as soon as somebody else imports Gymnasium."""

    def find_spec(
        self, fullname: str, path: Any = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = PathFinder.find_spec(fullname)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: ModuleType) -> None:
                execute(module)
                _register_environments()

            spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec


if "gymnasium" in sys.modules:
    _register_environments()
else:
    sys.meta_path.insert(0, _AfterGymnasium())
