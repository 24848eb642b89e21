"""The table of calls that a simulation answers: AirSim's, and a few of this project.

The socket server and the in-process transport share it, so that a call means the same in every timing.
Source of names, parameter orders and error texts: AirSim v1.8.1, RpcLibServerBase.cpp, MultirotorRpcLibServer.cpp.

    python -m uavaccel.wire.api > docs/airsim-calls.md

writes which of AirSim's calls are done, accepted or refused.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

from uavaccel.errors import UserError
from uavaccel.sim.simulation import Simulation
from uavaccel.wire import rpc
from uavaccel.wire.calls import Calls, Refusals, Say, Scenery, WireCall
from uavaccel.wire.flight_api import AttitudeApi, FlightApi
from uavaccel.wire.game_api import GameApi, RecordingApi, SimulatorApi
from uavaccel.wire.image_api import CameraApi, ImageApi
from uavaccel.wire.object_api import DetectionApi, ObjectApi, WorldApi
from uavaccel.wire.rpc import Received
from uavaccel.wire.sensor_api import SensorApi
from uavaccel.wire.settings import Settings
from uavaccel.wire.vehicle_api import VehicleApi, populate

GROUPS: tuple[type[Calls], ...] = (
    *(SimulatorApi, VehicleApi, FlightApi, AttitudeApi, ImageApi, CameraApi, ObjectApi, DetectionApi),
    *(SensorApi, WorldApi, RecordingApi, GameApi),
)
CALLS: dict[str, WireCall] = {name: call for group in GROUPS for name, call in group.calls.items()}
_LOG = logging.getLogger(__name__)


class Api:
    """Answers calls on one simulation. `recordings` is startRecording's folder; `say` shows a line to the user."""

    def __init__(
        self,
        simulation: Simulation,
        settings: Settings | None = None,
        render: bool = True,
        recordings: Path | None = None,
        say: Say = lambda _: None,
    ) -> None:
        self.simulation, self.settings = simulation, settings or Settings()
        populate(simulation, self.settings)
        self.scenery = Scenery(simulation, self.settings, render, recordings, say)
        self.refusals = Refusals()
        self._logged: set[tuple[str, type[Exception]]] = set()
        self.handlers: dict[str, Callable[..., object]] = {}
        for group in GROUPS:
            self.handlers |= group(self.scenery).handlers()

    def call(self, method: str, params: Sequence[object], wall_ns: int) -> Received:
        """Return a call's result, or a DeferredReply. Raises rpc.RpcError with the text for the client."""
        handler, call, count = self.handlers.get(method), CALLS.get(method), len(params)
        if handler is None or call is None:
            self.refusals.add(method, "is not known here")
            raise rpc.RpcError(f"rpclib: server could not find function '{method}' with argument count {count}.")
        if not call.required <= count <= call.most:
            wrong = f"Function '{method}' was called with an invalid number of arguments"
            raise self._refused(call, f"rpclib: {wrong}. Expected: {call.most}, got: {count}")
        self.scenery.wall_ns = wall_ns
        if self.simulation.trace.enabled:
            self.simulation.note(f"handle {method}", wall_ns)
        try:
            return handler(*call.arguments(params)) if params else handler()
        except (ValueError, UserError) as error:
            raise self._threw(call, count, str(error)) from error
        except Exception as error:  # no mistake of the client; fails this call alone, as in rpclib
            if (method, type(error)) not in self._logged:
                self._logged.add((method, type(error)))
                _LOG.error("%s failed", method, exc_info=error)
            raise self._threw(call, count, f"{type(error).__name__}: {error}") from error

    def _threw(self, call: WireCall, count: int, reason: str) -> rpc.RpcError:
        threw = f"function '{call.name}' (called with {count} arg(s)) threw an exception"
        return self._refused(call, f"rpclib: {threw}. The exception contained this information: {reason}.", reason)

    def _refused(self, call: WireCall, text: str, reason: str = "") -> rpc.RpcError:
        """Return the error for the client, in rpclib's words; count it if AirSim's client does not look at it."""
        if call.joined:
            self.refusals.add(call.name, f"was refused: {reason or text}")
        return rpc.RpcError(text)


OWN = "uavaccel"  # prefix of the calls that are not AirSim's
HEAD = """# AirSim's calls

Every call of AirSim v1.8.1's Python client, by its name on the wire. *Done*: it does here what it does there.
*Accepted*: it is answered without effect, and the server names it once on its terminal. *Refused*: the caller gets an
error that names it. Made by `python -m uavaccel.wire.api`.
"""


def sections() -> dict[str, list[WireCall]]:
    """AirSim's calls by section, in the order of the code."""
    found: dict[str, list[WireCall]] = {}
    for group in GROUPS:
        calls = [call for call in group.calls.values() if not call.name.startswith(OWN)]
        if calls:
            found.setdefault(group.title, []).extend(calls)
    return found


def page() -> str:
    answers = [call.status for calls in sections().values() for call in calls]
    done, accepted, refused = (
        sum(answer.startswith(word) for answer in answers) for word in ("done", "accepted", "refused")
    )
    lines = [HEAD, f"Of {len(answers)} calls {done} are done, {accepted} accepted, {refused} refused."]
    for title, calls in sections().items():
        named: dict[str, list[str]] = {}
        for call in calls:
            named.setdefault(call.status, []).append(f"`{call.name}`")
        lines += ["", f"## {title}", "", *(f"- *{status}*: {', '.join(names)}" for status, names in named.items())]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
