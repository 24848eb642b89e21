"""What an experiment's name or YAML file means: its mapping, its suite by the key `suite`, its configuration.

Custom suites are named "module:name" (own_code.py).
"""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from hashlib import sha256
from importlib import import_module
from itertools import chain
from pathlib import Path

from uavaccel.config import Config, apply_overrides, assign, load_yaml, validate
from uavaccel.errors import UserError, suggestion
from uavaccel.files import Plain
from uavaccel.forms import RowForm
from uavaccel.own_code import folder_of, imported_from, look_also_in, looked_up_in, own_class
from uavaccel.records import RunDirectory
from uavaccel.resources import experiment, experiments
from uavaccel.suites.experiment import Experiment, GameRow
from uavaccel.suites.suite import AnySuite, CaseType, ConfigType, Suite

# A line per suite; its module is imported on demand.
SUITES = {
    "dp1": "uavaccel.suites.dp1:Dp1",
    "dp2": "uavaccel.suites.dp2:Dp2",
    "train": "uavaccel.suites.train:Training",
    "seeds": "uavaccel.suites.seeds:Seeds",
    "ablation": "uavaccel.suites.grid:Ablation",
    "rl": "uavaccel.suites.rl:Rl",
    "mediation": "uavaccel.suites.mediation:Mediation",
    "robustness": "uavaccel.suites.grid:Robustness",
    "sweep": "uavaccel.suites.grid:Sweep",
    "paper": "uavaccel.suites.paper:Paper",
    "evaluate": "uavaccel.suites.evaluate:Evaluation",
    "realtime": "uavaccel.suites.realtime:Realtime",
}

CLASS = "task.class"
NAMED = re.compile(r"^task=(?=[^{\[\s]*$)")
"""Begins what sets a task by its name, which is its class: the keys of the task stay."""


def read_mapping(name: str) -> tuple[dict[str, Plain], str]:
    """Return the mapping of an experiment and its name in messages: one that ships, such as "dp1", or a YAML file.

    A task of one's own, "file.py" or "file.py:Class", is to be trained.
    """
    if is_task(name):
        if not Path(file := name.partition(":")[0]).is_file():
            raise UserError(f"{file}: no such file")
        own = Path(file).resolve()
        return {"suite": "train", "task": f"{own.relative_to(folder_beside(name))}{name.removeprefix(file)}"}, name
    if is_file(name):
        return load_yaml(Path(name)), name
    if name not in (known := experiments()):
        is_run = (Path(name) / "config.yaml").is_file()
        what = "a run, which --report computes again" if is_run else suggestion(name, known)
        raise UserError(f"{name}: no such experiment; {what}")
    return load_yaml(experiment(f"{name}.yaml")), f"{name}.yaml"


def folder_beside(name: str) -> Path:
    """Return the folder in which own code is looked up that the YAML file, or the file of a task, `name` names.

    It is that of the YAML file, and that from which the file of a task is imported.
    """
    file = Path(name.partition(":")[0] if is_task(name) else name).resolve()
    return imported_from(file) if is_task(name) else file.parent


def experiments_in(config: Config) -> dict[str, Plain]:
    """Return a hash of each experiment that a configuration names as its part, and of those that these name.

    An own suite may have a key `experiment` of another meaning.
    """
    found: dict[str, Plain] = {}

    def look(value: object) -> None:
        if isinstance(value, Mapping):
            if isinstance(name := value.get("experiment"), str) and name not in found:
                with suppress(UserError):
                    mapping, _ = read_mapping(name)
                    sortable = json.loads(json.dumps(mapping))  # numbers and texts among keys are not
                    found[name] = sha256(json.dumps(sortable, sort_keys=True).encode()).hexdigest()
                    look(mapping)
            value = [*value.values()]
        for each in value if isinstance(value, list | tuple) else ():
            look(each)

    look(config.model_dump())
    return found


def is_file(name: str) -> bool:
    """Return whether an experiment is named by its YAML file, or by that of its task."""
    return is_yaml(name) or is_task(name)


def is_yaml(name: str) -> bool:
    """Return whether an experiment is named by its YAML file."""
    return Path(name).suffix in (".yaml", ".yml")


def is_task(name: str) -> bool:
    """Return whether an experiment is named by a file of Python, in which its task is."""
    return name.partition(":")[0].endswith(".py")


def merged(
    mapping: Mapping[str, object], keys: Mapping[str, object], overrides: Iterable[str] = ()
) -> dict[str, Plain]:
    """Return a mapping with `keys` by dotted key, then each "dotted.key=value" of --set, applied. Raises UserError."""
    result = copy.deepcopy(dict(mapping))
    for key, value in keys.items():
        place = CLASS if key == "task" and isinstance(value, str) else key
        assign(result, place, copy.deepcopy(value), key)  # later keys may change it
    return apply_overrides(result, (NAMED.sub(f"{CLASS}=", override) for override in overrides))


def configuration(
    suite: Suite[ConfigType, CaseType],
    mapping: Mapping[str, Plain],
    source: str,
    given: Mapping[str, str] | None = None,
) -> ConfigType:
    """Return a suite's checked configuration from a YAML's mapping, omitted keys completed.

    Raises UserError, which names `source` or what has `given` a key, as `validate` does.
    """
    config = validate(suite.config, suite.complete(with_task(suite, mapping)), source, given)
    suite.check(config)
    return config


def with_task(suite: AnySuite, mapping: Mapping[str, Plain]) -> Mapping[str, Plain]:
    """Return a YAML's mapping with the keys of the task that it names, where the suite has any: more may go into it."""
    if "env_id" not in suite.config.model_fields:
        return mapping
    from uavaccel.rl.config import with_env_id  # loads Gymnasium

    return with_env_id(mapping)


def find_suite(name: object, source: str) -> AnySuite:
    """Return the suite of a name; a custom one, "module:name", as `own_module` finds it.

    Raises UserError, which names `source`, if there is none, and if nobody has told to run its code.
    """
    if isinstance(name, str) and ":" in name:
        where = f"{source}: suite = {name!r}"
        own: type[AnySuite] = own_class(name, where, Suite)
        try:
            return _checked(own())
        except (AttributeError, TypeError) as error:
            raise UserError(f"{where}: names no uavaccel.suites.suite.Suite: {error}") from error
    if not isinstance(name, str) or name not in SUITES:
        found = "key 'suite' is missing" if name is None else f"suite = {name!r} is unknown"
        raise UserError(f"{source}: {found}; {suggestion(str(name), [*SUITES, 'module:name'])}")
    module, _, name = SUITES[name].partition(":")
    return _checked(getattr(import_module(module), name)())


def suite_of(run: RunDirectory) -> AnySuite:
    """Return the suite of a run; a custom one also where the run found it, if trusted there. Raises UserError."""
    name = run.config().get("suite")
    look_also_in(run.manifest().get("own_code"))
    suite = find_suite(name, str(run.path / "config.yaml"))
    run.form = suite.form
    return suite


def open_run(path: str | Path) -> RunDirectory:
    """Return the run at `path`; its rows and arrays are checked as its suite declares them, whenever they are read.

    Those of a custom suite are checked for the keys of every suite: its code is not loaded. Raises UserError,
    also where there is no manifest.
    """
    run = RunDirectory(path)
    run.manifest()
    if ":" in str(run.config().get("suite")):
        run.form = RowForm(GameRow)
    else:
        suite_of(run)
    return run


def own_folder(suite: AnySuite, config: Experiment) -> Path | None:
    """Return the folder in which a run's own code, its environment, agent or suite, is looked up; None without any."""
    names = (getattr(config, name, "") for name in ("env_id", "agent"))
    owners = (type(suite), getattr(config, "environment_class", None))
    found = chain(map(looked_up_in, names), (folder_of(owner) for owner in owners if owner))
    return next(filter(None, found), None)


def _checked(suite: AnySuite) -> AnySuite:
    """Return a suite. Raises TypeError if it lacks what every suite has."""
    name = type(suite).__name__
    config = getattr(suite, "config", None)
    if not (isinstance(config, type) and issubclass(config, Experiment)):
        raise TypeError(f"{name}.config has to be a subclass of uavaccel.suites.experiment.Experiment")
    if not isinstance(getattr(suite, "name", None), str):
        raise TypeError(f"{name}.name has to be a text")
    return suite
