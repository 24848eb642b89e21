"""From what is asked for to a run that has begun: configuration, plan, manifest, and how an interrupted one goes on."""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_origin

from uavaccel.calibration.doctor import check_machine
from uavaccel.clock import calendar_time
from uavaccel.config import parse_override, schema
from uavaccel.draw.page import counted
from uavaccel.errors import Interrupted, UsageError, UserError, mistake_of
from uavaccel.files import Plain, check_new_folder
from uavaccel.machine import describe_run
from uavaccel.own_code import errors_named, files_of, modules_in, trusting
from uavaccel.processes.workers import LOKY
from uavaccel.records import RunDirectory, refuse_other_config, timing_provenance
from uavaccel.suites.experiment import Experiment, timing_of
from uavaccel.suites.keys import KEYS
from uavaccel.suites.registry import (
    configuration,
    experiments_in,
    find_suite,
    folder_beside,
    is_file,
    is_task,
    merged,
    read_mapping,
    suite_of,
    with_task,
)
from uavaccel.suites.runner import cases_of, check_jobs, run_suite, start_run
from uavaccel.suites.suite import AnySuite, Case, OnGame

PART_OF = {"seeds": "train"}  # suites of whole runs, by the command that resumes them


@dataclass(frozen=True)
class RunRequest:
    """What is to be flown; options that were not given are None."""

    experiment: str | None
    """A name or a file; None for that of the run in `out`, to resume."""
    options: Mapping[str, object] = field(default_factory=dict)
    """By the key of the configuration, or of its task."""
    overrides: Sequence[str] = ()
    jobs: int = 1
    out: Path | None = None
    resume: bool = False
    dry_run: bool = False
    suite: str | None = None
    """The suite that the command is restricted to."""
    engine: str = LOKY
    watch: bool = False
    """Whether a page in the browser shows the flights."""
    trust: bool = False
    """Whether all own code may run, not only what the experiment's YAML file names."""


@contextmanager
def reading(request: RunRequest) -> Iterator[tuple[AnySuite, Any]]:
    """Yield the suite and the configuration of a request; without an experiment those of the run that is resumed.

    A shipped experiment with a single ClockSpeed has its quick keys. In the `with` block own code may run: what the
    experiment's YAML file itself names, or all with `trust`. Raises UserError.
    """
    experiment = request.experiment
    mapping, source = _of_the_run(request) if experiment is None else read_mapping(experiment)
    beside = folder_beside(experiment) if experiment is not None and is_file(experiment) else None
    only = None if request.trust else modules_in(mapping)
    with trusting(request.trust or beside is not None, beside, only), ExitStack() as own:
        if experiment is None:
            suite, mapping, request = _as_begun(suite_of(RunDirectory(source)), mapping, request)
        else:
            suite = find_suite(dict(map(parse_override, request.overrides)).get("suite", mapping.get("suite")), source)
        own.enter_context(errors_named(files_of(type(suite))))
        if request.suite not in (None, suite.name, PART_OF.get(suite.name)):
            named = PART_OF.get(suite.name, suite.name)
            command = named if named in ("train", "evaluate") else "run"
            raise UsageError(f"{source}: is of {suite.name}, not of {request.suite}; take `uavaccel {command}`")
        options = {key: value for key, value in request.options.items() if value is not None}
        env_id, mapping = mapping.get("env_id"), dict(with_task(suite, mapping))
        if env_id is not None and env_id != mapping["env_id"]:
            raise UserError(f"{source}: env_id = {env_id!r} beside a task of {mapping['env_id']}: leave one out")
        if experiment is not None and is_task(experiment):
            from uavaccel.suites.train import first_settings

            mapping = first_settings(mapping)
        mapping = {**mapping, **quick_keys(request, suite)}
        seeds = options.pop("seeds", None) if suite.name == "train" else None
        places = {_option(name): _place(suite, name, value) for name, value in options.items()}
        given = {dotted: option for option, (dotted, _) in places.items()}
        given |= {parse_override(override)[0]: "--set" for override in request.overrides}
        config = configuration(suite, merged(mapping, dict(places.values()), request.overrides), source, given)
        if seeds is None:
            yield suite, config
        else:
            over_seeds = {"seed": config.seed, "seeds": seeds, "training": config.model_dump(mode="json")}
            suite = find_suite("seeds", source)
            yield suite, configuration(suite, over_seeds, source, {"seeds": "--seeds"})


def _as_begun(
    suite: AnySuite, mapping: dict[str, Plain], request: RunRequest
) -> tuple[AnySuite, dict[str, Plain], RunRequest]:
    """Return what is gone on with; of trainings over seeds for `train`, which began them, the training and its keys."""
    training = mapping.get("training")
    if request.suite is None or request.suite != PART_OF.get(suite.name) or not isinstance(training, Mapping):
        return suite, mapping, request
    if training.get("seed") != mapping.get("seed"):  # of a YAML file of one's own
        return suite, mapping, request
    options = {**request.options, "seeds": request.options.get("seeds") or mapping.get("seeds")}
    overrides = [override.removeprefix("training.") for override in request.overrides]
    return find_suite(request.suite, ""), dict(training), replace(request, options=options, overrides=overrides)


def quick_keys(request: RunRequest, suite: AnySuite) -> Mapping[str, object]:
    """Return the keys by which a shipped experiment with a single --clock is short and measured; else none."""
    speeds = _values(request.options.get("clock_speed") or ())
    if request.experiment is None or is_file(request.experiment) or len(speeds) != 1 or suite.quick is None:
        return {}
    return {"timing": "wall", **suite.quick}


def configure(request: RunRequest) -> tuple[AnySuite, Any]:
    """Return the suite and the configuration of a request. Raises UserError as `reading` does."""
    with reading(request) as found:
        return found


def _of_the_run(request: RunRequest) -> tuple[dict[str, Plain], str]:
    """Return the mapping and the folder of the run that is resumed."""
    out = request.out
    if not request.resume or out is None:
        raise UsageError("name an experiment, as in `uavaccel run dp1`, or a run's folder: --out FOLDER --resume")
    if not (out / "config.yaml").is_file():
        raise UserError(f"--out {out}: no run to go on with: no config.yaml in it; name an experiment to begin one")
    return RunDirectory(out).config(), str(out)


def _option(name: str) -> str:
    return KEYS[name].option if name in KEYS else f"--{name}"


def _place(suite: AnySuite, name: str, value: object) -> tuple[str, object]:
    """Return the dotted key of an option, in the configuration or its task, and its value. Raises UsageError."""
    option = _option(name)
    for above in ((), ("task",), ("training",), ("training", "task")):
        fields, prefix = suite.config.model_fields, "".join(f"{key}." for key in above)
        for key in above:
            fields = getattr(getattr(fields.get(key), "annotation", None), "model_fields", {})
        if name in fields:
            if get_origin(fields[name].annotation) is not tuple:
                if len(values := _values(value)) > 1:
                    raise UsageError(f"{option}: {suite.name} takes one value, not {len(values)}")
                value = values[0]
            return f"{prefix}{name}", value
    raise UsageError(f"{option}: {suite.name} has no such option")


def _values(value: object) -> list[object]:
    return list(value) if isinstance(value, list | tuple) else [value]


def as_sweep(request: RunRequest, conditions: Mapping[str, object]) -> RunRequest:
    """Return the request for evaluations under one changed condition each, in place of a single one."""
    given = {name: value for name, value in request.options.items() if value is not None}
    of_sweep = {name: given.pop(name, None) for name in ("agent", "games", "seed")}
    keys = {f"task.{name}": value for name, value in given.items()} | dict(map(parse_override, request.overrides))
    evaluation = {"experiment": "evaluate", "keys": keys}
    options = {**of_sweep, "sweep": dict(conditions), "evaluation": evaluation}
    return replace(request, experiment="sweep", options=options, overrides=(), suite=None)


@dataclass(frozen=True)
class Plan:
    """A run that can be flown: `left` are the cases without a row."""

    suite: AnySuite
    config: Any
    cases: Sequence[Case]
    left: Sequence[Case]
    out: Path
    request: RunRequest

    def lines(self) -> Iterator[str]:
        """Yield games by clock and simulated seconds, and whether some cannot fly in parallel; times are not known."""
        if not self.left:
            yield f"no game is left to be flown in {self.out}"
        else:
            clocks = Counter(case.timing for case in self.left)
            by_clock = ", ".join(f"{count} {timing}" for timing, count in clocks.items())
            games = sum(self.suite.games(self.config, case) for case in self.left)
            what = counted(f"{games:,}", "game")
            if self.suite.unit != "game":
                what += f" in {counted(len(self.left), self.suite.unit)}"
            sources = " and ".join(sorted({timing_provenance(timing) for timing in clocks}))
            simulated_s = sum(case.simulated_s() for case in self.left)
            time = f"{simulated_s:,.0f} simulated s, wall time known after the first"
            yield f"{what} ({by_clock}: {sources}), {time}, into {self.out}"
        if quick := quick_keys(self.request, self.suite):
            keys = ", ".join(f"{key}={getattr(self.config, key)}" for key in quick)
            [speed] = self.config.clock_speed
            yield f"a quick run, since --clock names one ClockSpeed: {keys}; all games: --set clock_speed=[{speed:g}]"
        alone = sum(case.timing == "wall" for case in self.left)
        if alone and (self.request.jobs > 1 or self.request.engine != LOKY):
            fly = "flies" if alone == 1 else "fly"
            yield f"{counted(alone, self.suite.unit)} on the wall clock {fly} alone, in this process, one by one"

    def begin(self, say: Callable[[str], object]) -> RunDirectory:
        """Return the run's folder, new or as it was left; `say` is told of renderer, machine, and what has changed."""
        manifest = manifest_of(self.suite, self.config, say)
        run = start_run(self.suite, self.config, self.out, manifest, self.request.resume)
        if "resumed" in run.manifest():
            for line in resumption_notes(run, counted(len(self.cases), self.suite.unit), manifest):
                say(line)
        return run

    def fly(self, run: RunDirectory, on_game: OnGame) -> None:
        """Fly the games that are left into the run's folder; `on_game` is called after each."""
        run_suite(self.suite, self.config, run, self.request.jobs, on_game, self.request.engine)


@contextmanager
def planned(request: RunRequest) -> Iterator[Plan]:
    """Yield what a request would fly, which may be flown in the `with` block, where own code may run.

    Raises UserError with one line; a dry run may name any folder.
    """
    if request.resume and request.out is None and request.experiment is not None:
        raise UsageError("--resume: say which run to go on with: --out FOLDER")
    with reading(request) as (suite, config):
        check_jobs(suite, config, request.jobs, request.engine)
        cases = cases_of(suite, config)
        if request.out is not None and not request.dry_run:
            check_new_folder(request.out, request.resume)
        name = Path((request.experiment or suite.name).partition(":")[0]).stem
        out = request.out or Path("runs") / f"{name}-{calendar_time()[:19].replace(':', '')}"
        begun = request.resume and (out / "config.yaml").is_file()
        if begun:
            refuse_other_config(out, config, suite.may_grow(out))
            _refuse_other_experiments(out, config)
        flown = RunDirectory(out).done_cases() if begun else set()
        if strange := sorted(flown - {case.id for case in cases}):
            raise UserError(
                f"{out}: has flown {strange[0]}, which is no case of {suite.name} now: its code has to name the same "
                "cases each time; restore it, or take another --out"
            )
        yield Plan(suite, config, cases, [case for case in cases if case.id not in flown], out, request)


def _refuse_other_experiments(out: Path, config: Experiment) -> None:
    """Raise UserError if an experiment that is a part of a run has changed since that was begun."""
    first, now = RunDirectory(out).manifest().get("experiments", {}), experiments_in(config)
    if changed := [name for name, digest in first.items() if now.get(name, digest) != digest]:
        raise UserError(f"{out}: {changed[0]} has changed since the run was begun: restore it, or take another --out")


def manifest_of(suite: AnySuite, config: Experiment, say: Callable[[str], object]) -> dict[str, Plain]:
    """Return the run's manifest, after checks of the machine and of the renderer if the suite needs one."""
    name = None
    if suite.renders(config):
        from uavaccel.sim.camera.gl import describe_renderer

        renderer = describe_renderer()
        name = renderer.name
        say(f"renderer: {name}{' (software)' if renderer.software else ''}")
    manifest = describe_run(sys.argv, config.seed, calendar_time(), gl_renderer=name)
    manifest.update(suite.provenance(config))
    if named := experiments_in(config):
        manifest["experiments"] = named
    if timing_of(config) == "wall":
        manifest["host_check"] = check_machine()
        say(f"machine check: {manifest['host_check']['verdict']}")
    return manifest


def resumption_notes(run: RunDirectory, games: str, now: Mapping[str, Plain]) -> Iterator[str]:
    """Yield lines about a run that is resumed: from where, and which versions have changed since it was begun."""
    yield f"going on with {run.path}: {len(run.rows())} of {games} are flown"
    manifest = run.manifest()
    before = [manifest, *manifest.get("resumed", [])[:-1]][-1].get("versions", {})
    changed = [
        f"{name} {before[name]} then, {version} now"
        for name, version in now.get("versions", {}).items()
        if name in before and before[name] != version
    ]
    if changed:
        yield f"warning: flown so far with other versions: {'; '.join(changed)}"
    first, commit = (each.get("git") or {} for each in (manifest, now))
    if first.get("commit") and commit.get("commit") and first["commit"] != commit["commit"]:
        yield f"warning: begun with another commit of uavaccel: {first['commit'][:12]}, now {commit['commit'][:12]}"
    latest = (manifest.get("resumed") or [manifest])[-1]
    begun, own = (each.get("own_code_sha256") or {} for each in (manifest, latest))
    if edited := [name for name, sha256 in own.items() if begun.get(name, sha256) != sha256]:
        yield f"warning: {', '.join(edited)}: changed since the run was begun"


@contextmanager
def resumable(plan: Plan) -> Iterator[None]:
    """Turn Ctrl-C, and errors of the system such as a full disk, into a line that says how to resume what was begun."""
    try:
        yield
    except KeyboardInterrupt:
        raise Interrupted(f"interrupted{_going_on(plan)}") from None
    except (OSError, MemoryError) as error:
        if (refused := mistake_of(error)) is None:
            raise
        raise UserError(f"{refused}{_going_on(plan)}") from error
    except UserError as error:
        if not isinstance(error.__cause__, OSError):
            raise
        raise UserError(f"{error}{_going_on(plan)}") from error


def _going_on(plan: Plan) -> str:
    command, begun = plan.request.suite or "run", (plan.out / "config.yaml").is_file()
    return f"; go on with: uavaccel {command} --resume --out {shlex.quote(str(plan.out))}" if begun else ""


def schema_of(name: str) -> dict[str, Plain]:
    """Return the JSON schema of a suite's YAML; that of an experiment's own file has the keys of its task.

    Raises UserError for an unknown suite, and as `reading` does.
    """
    if not is_file(name):
        with trusting():
            return schema(find_suite(name, "--schema").config)
    with reading(RunRequest(name)) as (suite, config):
        made, environment = schema(suite.config), getattr(config, "environment_class", None)
    if environment is not None:
        from uavaccel.rl.config import TASK_NAME  # loads Gymnasium

        task = environment.task_class.model_json_schema()
        made["$defs"] |= task.pop("$defs", {})
        task["properties"]["class"] = TASK_NAME
        made["properties"]["task"] = {"anyOf": [TASK_NAME, task]}
    return made
