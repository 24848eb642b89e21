"""Accelerated, time-controlled quadrotor simulation, and what the acceleration costs.

Importing the package loads nothing heavy: each command line call pays only for the modules it uses. Imported after
Gymnasium, it registers the environments; `import uavaccel.envs` does that in any order, and so does Gymnasium's own
form `gymnasium.make("uavaccel.envs:uavaccel/ObstacleLane-v0")`, also in a process that imports Gymnasium alone.
"""

import sys
from importlib import import_module
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


if "gymnasium" in sys.modules:
    import_module("uavaccel.envs")
