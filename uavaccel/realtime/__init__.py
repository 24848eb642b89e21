"""Real time for any Gymnasium environment: while an agent thinks, the environment goes on.

Gymnasium and NumPy are all that it needs, and what is imported from here loads only what it needs: `serve` NumPy alone.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uavaccel.realtime.evaluation import Certificate, certify
    from uavaccel.realtime.measuring import Measurement, measure
    from uavaccel.realtime.policies import Policy, RemotePolicy, load_policy
    from uavaccel.realtime.process import RealTimeProcess
    from uavaccel.realtime.server import PolicyServer, serve
    from uavaccel.realtime.thinking import Measured, ThinkingTime, lognormal, samples
    from uavaccel.realtime.wrapper import RealTime, RealTimeVector

__all__ = [  # noqa: RUF022  what a program begins with, in its order
    "RealTime", "RealTimeVector", "RealTimeProcess", "ThinkingTime", "Measured", "lognormal", "samples",
    "load_policy", "Policy", "RemotePolicy", "PolicyServer", "serve",
    "measure", "Measurement", "certify", "Certificate",
]  # fmt: skip

_HOMES = {
    "RealTime": "wrapper",
    "RealTimeProcess": "process",
    "RealTimeVector": "wrapper",
    **dict.fromkeys(("Measured", "ThinkingTime", "lognormal", "samples"), "thinking"),
    **dict.fromkeys(("Policy", "RemotePolicy", "load_policy"), "policies"),
    **dict.fromkeys(("PolicyServer", "serve"), "server"),
    **dict.fromkeys(("Measurement", "measure"), "measuring"),
    "Certificate": "evaluation",
    "certify": "evaluation",
}

if not TYPE_CHECKING:  # which would know any name

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
