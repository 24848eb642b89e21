"""The registry of suites by the key `suite` of their YAML; custom ones are named "module:name"."""

from __future__ import annotations

import sys
from importlib import import_module
from inspect import getattr_static
from pathlib import Path

from uavaccel.errors import UserError, suggestion
from uavaccel.records import RunDirectory
from uavaccel.suites.experiment import Experiment
from uavaccel.suites.report import Report
from uavaccel.suites.suite import AnySuite, Suite

# A line per suite; its module is imported on demand.
SUITES = {
    "dp1": "uavaccel.suites.dp1.suite:Dp1",
    "dp2": "uavaccel.suites.dp2.suite:Dp2",
    "train": "uavaccel.suites.training.suite:Training",
    "ablation": "uavaccel.suites.ablation.suite:Ablation",
    "rl": "uavaccel.suites.rl.suite:Rl",
    "robustness": "uavaccel.suites.robustness.suite:Robustness",
    "sweep": "uavaccel.suites.sweep.suite:Sweep",
    "paper": "uavaccel.suites.paper.suite:Paper",
    "evaluate": "uavaccel.suites.evaluation.suite:Evaluation",
    "realtime": "uavaccel.suites.realtime.suite:Realtime",
}


def find_suite(name: object, source: str, folder: Path | None = None) -> AnySuite:
    """Return the suite of a name; a custom one, "module:name", is searched in `folder` and the working directory.

    Raises UserError, which names `source`, if there is none.
    """
    if isinstance(name, str) and ":" in name:
        return _own_suite(name, source, folder)
    if not isinstance(name, str) or name not in SUITES:
        found = "key 'suite' is missing" if name is None else f"suite = {name!r} is unknown"
        raise UserError(f"{source}: {found}; {suggestion(str(name), [*SUITES, 'module:name'])}")
    return _load(SUITES[name])


def suite_of(run: RunDirectory) -> AnySuite:
    """Return the suite of a run; a custom one is searched where the run found it. Raises UserError."""
    name = run.config().get("suite")
    own = isinstance(name, str) and ":" in name
    folder = run.manifest().get("suite_folder") if own else None
    return find_suite(name, str(run.path / "config.yaml"), None if folder is None else Path(folder))


def own_folder(suite: AnySuite) -> Path | None:
    """Return the folder from which a custom suite's module is imported; None for a suite that ships."""
    module = sys.modules[type(suite).__module__]
    shipped = {place.partition(":")[0] for place in SUITES.values()}
    if module.__name__ in shipped or module.__file__ is None:
        return None
    file = Path(module.__file__).resolve()
    return file.parents[module.__name__.count(".") + (file.name == "__init__.py")]


def _own_suite(name: str, source: str, folder: Path | None) -> AnySuite:
    for path in (Path.cwd(), folder):
        if path is not None and str(path.resolve()) not in sys.path:
            sys.path.insert(0, str(path.resolve()))
    try:
        return _load(name)
    except (ImportError, ValueError, SyntaxError) as error:
        raise UserError(f"{source}: suite = {name!r}: {error}") from error
    except (AttributeError, TypeError) as error:
        raise UserError(
            f"{source}: suite = {name!r}: names no uavaccel.suites.suite.Suite: {error}"
        ) from error


def _load(place: str) -> AnySuite:
    module, _, name = place.partition(":")
    suite = getattr(import_module(module), name)()
    if not isinstance(suite, Suite):
        raise TypeError(f"{name} is a {type(suite).__name__}")
    config = getattr(suite, "config", None)
    if not (isinstance(config, type) and issubclass(config, Experiment)):
        raise TypeError(f"{name}.config has to be a subclass of uavaccel.suites.experiment.Experiment")
    report = getattr_static(suite, "report_class")  # a property would import matplotlib
    if not (isinstance(report, property) or (isinstance(report, type) and issubclass(report, Report))):
        raise TypeError(f"{name}.report_class has to be a subclass of uavaccel.suites.report.Report")
    if not isinstance(getattr(suite, "name", None), str):
        raise TypeError(f"{name}.name has to be a text")
    return suite
