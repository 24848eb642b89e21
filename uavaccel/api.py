"""The package from Python: environments by their task, and trainings, evaluations and films as the command line makes.

Type checkers read `keywords.pyi` beside this, which names every key.
"""

from __future__ import annotations

import json
import re
import reprlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uavaccel.config import Config, dotted_keys
from uavaccel.errors import UserError, suggestion
from uavaccel.own_code import check_not_importing, file_of, forget_changed
from uavaccel.records import RunDirectory
from uavaccel.units import plain

if TYPE_CHECKING:  # it loads Gymnasium
    from uavaccel.envs.flight_env import FlightEnv
    from uavaccel.envs.task import Task
    from uavaccel.envs.values import Batch
    from uavaccel.suites.session import RunRequest


def make(
    task: str | type[Task] | type[FlightEnv[Any]], *, render_mode: str | None = None, **keys: Any
) -> FlightEnv[Any]:
    """Make an environment of a task: "hover" or "uavaccel/Hover-v0", or a class of a task or of an environment.

    `keys` are the task's. Raises UserError for an unknown task or key, and for a value that does not fit.
    """
    return _environment(task)(render_mode=render_mode, **_plain(keys))


def make_vec(
    task: str | type[Task] | type[FlightEnv[Any]],
    num_envs: int = 1,
    *,
    device: str = "cpu",
    simulator: str | None = None,
    **keys: Any,
) -> Batch:
    """Make a batch of environments, as `make` makes one: each in the exact simulator, or all as arrays.

    `simulator` is mujoco or kernels, by default the exact one, mujoco, on device cpu, and kernels on device cuda.
    Raises UserError as `make` does, and for a simulator or device that cannot fly the task, or that is missing.
    """
    from uavaccel.envs.simulators import CPU, EXACT, KERNELS, make_batch

    simulator = simulator or (EXACT if device == CPU else KERNELS)
    return make_batch(_environment(task), num_envs, simulator, device, **_plain(keys))  # type: ignore[arg-type]


def train(
    experiment: str | Path | type[Task] | type[FlightEnv[Any]] | None = None,
    *,
    seeds: int | None = None,
    jobs: int = 1,
    out: str | Path | None = None,
    resume: bool = False,
    trust: bool = False,
    **keys: Any,
) -> RunDirectory:
    """Train a policy, as `uavaccel train` does, and return its run directory, which is a policy's folder too.

    `experiment` is one that ships, by default train, a YAML file, or the class of a task in a file of one's own; with
    `resume` the run in `out` needs none. `keys` are those of the YAML; mappings, such as `task`, are merged into its.
    Raises UserError.
    """
    from uavaccel.suites.session import RunRequest

    named = None if experiment is None and resume else experiment or "train"
    named = _file_and_class(named) if isinstance(named, type) else named and _name(named, "the class of a task")
    options = {"seeds": seeds, "games": keys.pop("games", None)}  # of each training, where there are several
    how = jobs, _path(out), resume, False, "train"
    return _flown(RunRequest(named, options, _overrides(keys), *how, trust=trust))


def evaluate(
    agent: str | Path | RunDirectory | None = None,
    *,
    jobs: int = 1,
    out: str | Path | None = None,
    resume: bool = False,
    trust: bool = False,
    **keys: Any,
) -> RunDirectory:
    """Evaluate a policy on games that no training has, as `uavaccel evaluate --no-films`, and return the run directory.

    `agent` is a training, a policy's folder, "default" (the policy that ships), "straight" or "offset:METRES"; `keys`
    and `resume` are as in `train`. Raises UserError.
    """
    from uavaccel.suites.session import RunRequest

    named = None if agent is None and resume else "evaluate"
    options = {"agent": agent and _name(agent, "a run; a function as 'my_file.py:act'")}
    how = jobs, _path(out), resume, False, "evaluate"
    return _flown(RunRequest(named, options, _overrides(keys), *how, trust=trust))


def film(source: str | Path | RunDirectory, case: str | None = None, out: str | Path | None = None) -> Path:
    """Film a game of a run, by default the most interesting, or a lane of a policy's, and return the MP4.

    It is `out` or below films/ in the run, a contact sheet beside it. Raises UserError where there is no such game or
    no images, and where nothing can draw.
    """
    from uavaccel.suites.flight import film_game

    forget_changed()
    return film_game(_folder(source), case, movie=_path(out))[0]


def _environment(task: Any) -> type[FlightEnv[Any]]:
    from uavaccel.envs.flight_env import FlightEnv, environment_of
    from uavaccel.envs.task import Task

    if isinstance(task, type) and issubclass(task, Task | FlightEnv):
        own: Any = task
        return environment_of(own)
    from uavaccel.rl.config import ENVIRONMENTS, SHORT, environment_class

    if not isinstance(task, str) or (env_id := SHORT.get(task, task)) not in ENVIRONMENTS:
        known = suggestion(str(task), [*SHORT, "a class of Task or FlightEnv"])
        raise UserError(f"task {reprlib.repr(task)}: is unknown; {known}")
    return environment_class(env_id)


def _flown(request: RunRequest) -> RunDirectory:
    from uavaccel.suites.session import planned, resumable

    check_not_importing()
    forget_changed()
    with _keywords_named(), planned(request) as plan, resumable(plan):
        run = plan.begin(lambda line: None)
        plan.fly(run, lambda case, row: None)
        plan.suite.report(run).write()
    return run


@contextmanager
def _keywords_named() -> Iterator[None]:
    """Name keywords in what is told of mistakes, where the command line has options."""
    try:
        yield
    except UserError as error:
        said = re.sub(r"^--set:? |^--[a-z]+: (?=\w+ = )", "", str(error))
        error.args = (re.sub(r"--(?=[a-z])", "", said), *error.args[1:])
        raise


def _plain(keys: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value.model_dump(mode="json") if isinstance(value, Config) else value for key, value in keys.items()}


def _as_yaml(value: object) -> object:
    return str(value) if (made := plain(value)) is value else made


def _overrides(keys: Mapping[str, Any]) -> list[str]:
    """Return keys of a YAML file, nested as there, as --set has them: JSON is YAML."""
    return [
        f"{name}={json.dumps(value, default=_as_yaml)}" for name, value in dotted_keys(_plain(keys)).items() if name
    ]


def _file_and_class(task: type) -> str:
    """Return "file.py:Class". Raises UserError for a class without a file of one's own."""
    file = file_of(task)
    if file is not None and "<locals>" not in task.__qualname__:
        return f"{file}:{task.__qualname__}"
    own = "is not in a file of your own: write it into one, or name a training that ships, as hover_ppo"
    raise UserError(f"{task.__name__}: {own}")


def _name(given: object, what: str) -> str:
    """Return a name or a path. Raises UserError for anything else: beside these there is `what`."""
    if isinstance(given, str | Path | RunDirectory):
        return _folder(given)
    raise UserError(f"an object of {type(given).__name__}: must be a name, a path, or {what}")


def _folder(source: str | Path | RunDirectory) -> str:
    return str(source.path if isinstance(source, RunDirectory) else source)


def _path(path: str | Path | None) -> Path | None:
    return None if path is None else Path(path)
