"""Accelerated, time-controlled quadrotor simulation, and what the acceleration costs.

Importing the package loads nothing heavy: each call pays only for the modules that it uses. Imported after Gymnasium,
it registers the environments; `import uavaccel.envs` does that in any order, and so does Gymnasium's own form
`gymnasium.make("uavaccel.envs:uavaccel/ObstacleLane-v0")`, also in a process that imports Gymnasium alone. `make` and
`make_vec` need no registration.
"""

import sys
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uavaccel.commands import AirSimAdapter, adsc, tcsc
    from uavaccel.envs.flight_env import FlightEnv
    from uavaccel.envs.task import Task
    from uavaccel.errors import UserError
    from uavaccel.keywords import evaluate, film, make, make_vec, train
    from uavaccel.kinematics import VelocityGoal
    from uavaccel.records import RunDirectory
    from uavaccel.wire.session import open_session

__version__ = "0.1.0"
__all__ = [  # noqa: RUF022  what a program begins with, in its order
    "make", "make_vec", "train", "evaluate", "film", "Task", "FlightEnv", "RunDirectory", "UserError",
    "open_session", "adsc", "tcsc", "VelocityGoal", "AirSimAdapter",
]  # fmt: skip

_HOMES = {
    "AirSimAdapter": "uavaccel.commands",
    "FlightEnv": "uavaccel.envs.flight_env",
    "RunDirectory": "uavaccel.records",
    "Task": "uavaccel.envs.task",
    "UserError": "uavaccel.errors",
    "VelocityGoal": "uavaccel.kinematics",
    "adsc": "uavaccel.commands",
    "open_session": "uavaccel.wire.session",
    "tcsc": "uavaccel.commands",
    **dict.fromkeys(("evaluate", "film", "make", "make_vec", "train"), "uavaccel.api"),
}


if not TYPE_CHECKING:  # which would know any name

    def __getattr__(name: str) -> Any:
        """The names that a program begins with; each is imported when it is first asked for."""
        if name not in _HOMES:
            raise AttributeError(f"module 'uavaccel' has no attribute {name!r}")
        return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if "gymnasium" in sys.modules and find_spec("uavaccel.envs"):  # which uavaccel.realtime's own wheel has not
    import_module("uavaccel.envs")
