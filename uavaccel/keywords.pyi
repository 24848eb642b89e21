"""The functions of api.py as type checkers see them: their keywords are the keys of the task or of the YAML.

These are read off the classes of tasks and configurations; what may be a mapping or a file's name, too, is Any here.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Concatenate, Literal, ParamSpec, TypeVar, overload

from uavaccel.config import Config
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.gates import Gates, GatesTask
from uavaccel.envs.hover import Hover, HoverTask
from uavaccel.envs.navigate import Navigate, NavigateTask
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.envs.simulators import Device, Simulator
from uavaccel.envs.task import Task
from uavaccel.envs.values import Batch
from uavaccel.records import RunDirectory
from uavaccel.suites.evaluate import EvaluateConfig
from uavaccel.suites.train import TrainConfig

P = ParamSpec("P")
Id = TypeVar("Id")
Made = TypeVar("Made")
TaskT = TypeVar("TaskT", bound=Task)
EnvT = TypeVar("EnvT", bound=FlightEnv[Any])

def _with_keys(of: Callable[P, Any]) -> Callable[[Callable[[Id], Made]], Callable[Concatenate[Id, P], Made]]: ...
def _counted(of: Callable[P, Any]) -> Callable[[Callable[[Id], Made]], Callable[Concatenate[Id, int, P], Made]]: ...
def _keys_alone(of: Callable[P, Any]) -> Callable[[Callable[[], Made]], Callable[P, Made]]: ...

class _One(Config):
    render_mode: Literal["rgb_array"] | None = None
    latency: Any = None

class _Many(_One):
    num_envs: int = 1
    device: Device = "cpu"
    simulator: Simulator | None = None
    processes: int | None = None
    autoreset_mode: str = "NextStep"

class _OfLane(LaneTask):
    difficulty: Any = None
    lane: Any = None
    randomise: Any = None

class _Lane(_One, _OfLane): ...
class _Lanes(_Many, _OfLane): ...
class _Hover(_One, HoverTask): ...
class _Hovers(_Many, HoverTask): ...
class _Gates(_One, GatesTask): ...
class _ManyGates(_Many, GatesTask): ...
class _Navigate(_One, NavigateTask): ...
class _Navigates(_Many, NavigateTask): ...

@overload
@_with_keys(_Lane)
def make(task: Literal["lane", "uavaccel/ObstacleLane-v0"]) -> ObstacleLane: ...
@overload
@_with_keys(_Hover)
def make(task: Literal["hover", "uavaccel/Hover-v0"]) -> Hover: ...
@overload
@_with_keys(_Gates)
def make(task: Literal["gates", "uavaccel/Gates-v0"]) -> Gates: ...
@overload
@_with_keys(_Navigate)
def make(task: Literal["navigate", "uavaccel/Navigate-v0"]) -> Navigate: ...
@overload
def make(task: type[EnvT], *, render_mode: Literal["rgb_array"] | None = None, **keys: Any) -> EnvT: ...
@overload
def make(task: type[TaskT], *, render_mode: Literal["rgb_array"], **keys: Any) -> FlightEnv[TaskT]: ...
@overload
def make(task: Callable[P, TaskT], *args: P.args, **keys: P.kwargs) -> FlightEnv[TaskT]: ...
@overload
@_with_keys(_Lanes)
def make_vec(task: Literal["lane", "uavaccel/ObstacleLane-v0"]) -> Batch: ...
@overload
@_with_keys(_Hovers)
def make_vec(task: Literal["hover", "uavaccel/Hover-v0"]) -> Batch: ...
@overload
@_with_keys(_ManyGates)
def make_vec(task: Literal["gates", "uavaccel/Gates-v0"]) -> Batch: ...
@overload
@_with_keys(_Navigates)
def make_vec(task: Literal["navigate", "uavaccel/Navigate-v0"]) -> Batch: ...
@overload
@_counted(_Lanes)
def make_vec(task: Literal["lane", "uavaccel/ObstacleLane-v0"]) -> Batch: ...
@overload
@_counted(_Hovers)
def make_vec(task: Literal["hover", "uavaccel/Hover-v0"]) -> Batch: ...
@overload
@_counted(_ManyGates)
def make_vec(task: Literal["gates", "uavaccel/Gates-v0"]) -> Batch: ...
@overload
@_counted(_Navigates)
def make_vec(task: Literal["navigate", "uavaccel/Navigate-v0"]) -> Batch: ...
@overload
def make_vec(
    task: type[FlightEnv[Any]] | type[Task],
    num_envs: int = 1,
    *,
    device: Device = "cpu",
    simulator: Simulator | None = None,
    **keys: Any,
) -> Batch: ...

class _Train(TrainConfig):
    seeds: int | None = None
    jobs: int = 1
    out: str | Path | None = None
    resume: bool = False
    trust: bool = False
    task: Any = None

class _Evaluate(EvaluateConfig):
    agent: Any = None
    jobs: int = 1
    out: str | Path | None = None
    resume: bool = False
    trust: bool = False
    task: Any = None

@overload
@_keys_alone(_Train)
def train() -> RunDirectory: ...
@overload
@_with_keys(_Train)
def train(experiment: str | Path | type[Task] | type[FlightEnv[Any]]) -> RunDirectory: ...
@overload
@_keys_alone(_Evaluate)
def evaluate() -> RunDirectory: ...
@overload
@_with_keys(_Evaluate)
def evaluate(agent: str | Path | RunDirectory) -> RunDirectory: ...
def film(source: str | Path | RunDirectory, case: str | None = None, out: str | Path | None = None) -> Path: ...
