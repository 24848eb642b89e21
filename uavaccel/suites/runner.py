"""The runner: it flies the cases of a suite into a run directory, in order, in parallel where the timing allows.

Parallel games are flown by joblib's own processes (loky), or by clusters of Ray and Dask, whose workers read the run's
folder: all of them must see it, and this package, under the same paths. Without a running cluster (RAY_ADDRESS,
DASK_SCHEDULER_ADDRESS) a local one of this machine's processes is started, on loopback.
"""

from __future__ import annotations

import atexit
import math
import os
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from itertools import count, groupby, islice
from pathlib import Path
from platform import node
from typing import Any, get_args

import numpy as np

from uavaccel.config import MOST_GAMES, MOST_PROCESSES
from uavaccel.errors import UsageError, UserError
from uavaccel.files import check_json, file_sha256, is_file_name, parse_json, to_json
from uavaccel.own_code import errors_named, files_of, folder_of, trusted_folder, trusting
from uavaccel.processes.lifetime import remove_orphaned_files, work_for_parent
from uavaccel.processes.workers import LOKY, Delayed, check_count, on_this_machine
from uavaccel.records import RunDirectory
from uavaccel.resources import require
from uavaccel.suites.experiment import Experiment, Row, Timing, disturbances, timed, timing_of
from uavaccel.suites.registry import own_folder, suite_of
from uavaccel.suites.suite import AnySuite, Case, GameResult, OnGame, Opened
from uavaccel.units import real
from uavaccel.wire.rpc import ServerGoneError

MOST_RESTARTS = 3  # of the server in a game
PACKAGES = {"ray": "ray", "dask": "distributed"}
ENGINES = (LOKY, *PACKAGES)
AHEAD = 2  # batches per worker that a cluster is given at once


def check_engine(engine: str) -> None:
    """Raise UsageError for an unknown engine, UserError for one whose package is missing."""
    if engine not in ENGINES:
        raise UsageError(f"--engine {engine}: is unknown; there are {', '.join(ENGINES)}")
    if engine in PACKAGES:
        require(PACKAGES[engine], f"--engine {engine}", engine)


def check_jobs(suite: AnySuite, config: Experiment, jobs: int, engine: str = LOKY) -> None:
    """Raise UsageError for a number of processes out of range, or that suite or timing exclude, or a bad engine."""
    check_engine(engine)
    check_count(jobs, None if engine == LOKY else MOST_PROCESSES)
    if jobs > 1 and timing_of(config) == "wall":
        raise UsageError("--jobs must be 1 with timing wall: neighbours would spoil the measurement")
    if jobs > 1 and (why := suite.why_serial(config)):
        raise UsageError(f"--jobs must be 1 with {suite.name}: {why}")


def cases_of(suite: AnySuite, config: Experiment) -> list[Case]:
    """Return all cases. Raises UserError for none or too many, equal names, names no file can have, and no cases."""
    with errors_named(files_of(type(suite))):
        made = suite.cases(config)
        if not isinstance(made, Iterable):
            raise UserError(f"{suite.name}: cases returned a {type(made).__name__}, not cases")
        cases = list(islice(made, MOST_GAMES + 1))
    for case in cases:
        _check_case(suite, case)
    if not cases:
        raise UserError(f"{suite.name}: there is no game to fly: cases is empty")
    if len(cases) > MOST_GAMES:
        raise UserError(f"more than {MOST_GAMES} games in all: fewer games, or fewer values to combine")
    for name, number in Counter(case.id for case in cases).items():
        if not is_file_name(name):
            raise UserError(f"{suite.name}: a case cannot be called {name!r}: its name is that of a file")
        if number > 1:
            raise UserError(f"{suite.name}: two cases are called {name!r}")
    return cases


def _check_case(suite: AnySuite, case: Any) -> None:
    """Raise UserError for what is no case of a suite, on no clock, or of no time."""
    if lacking := [name for name in ("id", "timing", "simulated_s") if not hasattr(case, name)]:
        raise UserError(f"{suite.name}: cases has a {type(case).__name__} without {', '.join(lacking)}")
    if case.timing not in (known := get_args(Timing)):
        raise UserError(f"{suite.name}: {case.id} has the timing {case.timing!r}: should be {', '.join(known)}")
    if (seconds := real(case.simulated_s())) is None or not 0 <= seconds < math.inf:
        raise UserError(f"{suite.name}: {case.id} takes {case.simulated_s()!r} simulated s: should be at least 0")


def start_run(
    suite: AnySuite, config: Experiment, out: Path, manifest: Mapping[str, object], resume: bool = False
) -> RunDirectory:
    """Create a run's folder or, with `resume`, bring it to a state from which the run continues. Raises UserError."""
    folder = own_folder(suite, config)  # from which `run --report` imports own code
    found: dict[str, object] = {}
    if folder is not None:
        hashes = {os.path.relpath(file, folder): file_sha256(file) for file in _own_files(suite, config)}
        found = {"own_code": str(folder), "own_code_sha256": hashes}
    run = RunDirectory.create(out, config, {**manifest, **found}, resume, suite.may_grow(out))
    run.form = suite.form
    suite.prepare(config, run)
    return run


def run_suite(
    suite: AnySuite,
    config: Experiment,
    run: RunDirectory,
    jobs: int = 1,
    on_game: OnGame = lambda case, row: None,
    engine: str = LOKY,
) -> None:
    """Fly the cases that have no row yet, append their rows in canonical order, then let the suite finish.

    Games on the machine's own clock are flown one by one, whatever `jobs`, since parallel games would disturb them.
    Where their server dies or hangs it is started again, and the game flown again; the key `restarts` of its row says
    how often. `on_game` is called after each game. Raises UserError, and as `check_jobs` does.
    """
    check_jobs(suite, config, jobs, engine)
    remove_orphaned_files()
    restarts, own = Counter[str](), folder_of(type(suite)) is not None
    flown = f"{node()}-{os.getpid()}", next(_RUNS)
    while True:
        try:
            for case, game in _games(suite, config, run, jobs, engine, flown):
                row = {"suite": suite.name, "case": case.id, **game.row}
                if case.timing == "wall":
                    row |= disturbances(row, restarts[case.id])
                if own:
                    _check_form(suite, row, game.arrays)
                if game.arrays:
                    row |= run.save_arrays(case.id, game.arrays)
                run.append_row(row, on_disk=not game.next_is_ready)
                run.append_timing({"case": case.id, **game.host}, on_disk=not game.next_is_ready)
                on_game(case, row)
            suite.finish(config, run)
            return
        except ServerGoneError as error:
            name = next((case.id for case in _left(suite, config, run)), "after the last game")
            restarts[name] += 1
            if restarts[name] > MOST_RESTARTS:
                raise UserError(f"{name}: {error}, {restarts[name]} times; go on with --resume") from error
            suite.prepare(config, run)
        finally:
            run.write_waiting()


def _check_form(suite: AnySuite, row: Row, arrays: Mapping[str, Any]) -> None:
    """Raise UserError unless row and arrays have the form that is asked of them whenever they are read."""
    where, read = f"{suite.name}: fly of {row['case']}", parse_json(to_json(row))
    if arrays:
        read.update(arrays="", arrays_sha256="")  # which they get as they are saved
        suite.form.check_arrays({name: np.asarray(array) for name, array in arrays.items()}, read, where, "")
    suite.form.check_row(read, f"{where}: its row", "")


def _left(suite: AnySuite, config: Experiment, run: RunDirectory) -> Iterator[Case]:
    """Yield the cases without a row."""
    done = run.done_cases()
    return (case for case in suite.cases(config) if case.id not in done)


def _games(
    suite: AnySuite, config: Experiment, run: RunDirectory, jobs: int, engine: str, flown: Flown
) -> Iterator[tuple[Case, GameResult]]:
    """Fly the cases without a row, in their order, those that follow each other with a timing and a stage at a time."""
    from uavaccel.envs.environment_process import BatchError

    for (timing, _), group in groupby(_left(suite, config, run), lambda case: (case.timing, suite.stage(case))):
        cases = list(group)
        if timing != "wall" and (jobs > 1 or engine != LOKY):
            from joblib import delayed

            folder = run.path.resolve()  # workers may have another working directory
            place = own_folder(suite, config) or trusted_folder()
            calls = (delayed(_fly_in_worker)(config, case, folder, place, flown) for case in cases)
            games = in_parallel(engine, jobs, suite.batch, calls, partial(_leave_in_worker, flown))
            yield from zip(cases, games, strict=True)
            continue
        try:
            with _own_errors(suite, config), _opened(suite, config, timing, run) as opened:
                for case in cases:
                    yield case, fly_case(suite, config, case, opened)
        except BatchError as error:
            raise UserError(f"{error}; go on with --resume") from error


def _opened(suite: AnySuite, config: Experiment, timing: str, run: RunDirectory) -> AbstractContextManager[Opened]:
    """Return what games are flown in. Raises UserError where it is no context manager."""
    opened: Any = suite.open(config, timing, run)
    if not isinstance(opened, AbstractContextManager):
        raise UserError(f"{suite.name}: open returned a {type(opened).__name__}, not a context manager")
    return opened


@contextmanager
def _own_errors(suite: AnySuite, config: Experiment, where: str = "") -> Iterator[None]:
    """Name what goes wrong in a suite or an environment of one's own by `where`, its file, line and function."""
    try:
        yield
    except (Exception, SystemExit) as error:
        from uavaccel.envs.environment_process import BatchError

        if isinstance(error, BatchError | ServerGoneError):
            raise
        with errors_named(_own_files(suite, config), where):
            raise


def _own_files(suite: AnySuite, config: Experiment) -> list[Path]:
    """Return the files of a suite or an environment of one's own."""
    environment = getattr(config, "environment_class", None)
    return files_of(type(suite), *((environment, environment.task_class) if environment else ()))


Flown = tuple[str, int]
"""A run that is flown: the process that flies it, and which of that process's runs it is. Folders are used again."""
_RUNS = count()
_OPENED: dict[tuple[Flown, str], tuple[AnySuite, Opened, ExitStack]] = {}  # by timing, too


def _fly_in_worker(config: Experiment, case: Case, folder: Path, place: Path | None, flown: Flown) -> GameResult:
    """Fly a case in this worker process, which keeps what it opened; own code runs, also of `place`.

    What it opened for the runs before of the same process is closed.
    """
    key = flown, case.timing
    with trusting(beside=place):
        if key not in _OPENED:
            for before, _ in list(_OPENED):
                if before[0] == flown[0] and before != flown:
                    _leave_in_worker(before)
            if threading.current_thread() is threading.main_thread():  # Dask's workers fly in another one
                work_for_parent(os.getppid())
            # software rendering leaves the other cores to the other workers
            os.environ.setdefault("LP_NUM_THREADS", "0")
            run = RunDirectory(folder)
            suite = suite_of(run)
            left = ExitStack()
            with _own_errors(suite, config):
                _OPENED[key] = suite, left.enter_context(_opened(suite, config, case.timing, run)), left
            atexit.register(_leave_in_worker, flown)  # where this process ends with the run
        suite, opened, _ = _OPENED[key]
        with _own_errors(suite, config):
            return fly_case(suite, config, case, opened)


def _leave_in_worker(flown: Flown) -> None:
    """Close what this worker process opened for a run."""
    for key in [key for key in _OPENED if key[0] == flown]:
        _OPENED.pop(key)[-1].close()


def fly_case(suite: AnySuite, config: Experiment, case: Case, opened: Opened) -> GameResult:
    """Fly a case, and add the host's time and load. Raises UserError where a custom suite's result is none."""
    where = f"{suite.name}: fly of {case.id}"
    with _own_errors(suite, config, where if folder_of(type(suite)) else ""):
        game, host = timed(lambda: suite.fly(config, case, opened))
    if own_folder(suite, config) is not None:
        if not isinstance(game, GameResult):
            raise UserError(f"{where} returned a {type(game).__name__}, not a uavaccel.suites.suite.GameResult")
        if not isinstance(game.row, dict) or game.row.get("case", case.id) != case.id:
            raise UserError(f"{where}: its row has to be a mapping, of no other case")
        if wrong := [name for name in game.row if not isinstance(name, str)]:
            raise UserError(f"{where}: its row has {wrong[0]!r} for a name, which has to be a text")
        check_json({**game.row, **game.host}, f"{where}: its row")
        if not isinstance(game.arrays, Mapping) or not all(map(_is_array, game.arrays.values())):
            raise UserError(f"{where}: its arrays have to be a mapping of numbers, in rows of equal length")
    return replace(game, host={**host, **game.host})


def _is_array(value: object) -> bool:
    try:
        return not np.asarray(value).dtype.hasobject
    except (TypeError, ValueError, RuntimeError):  # rows of different lengths, or a tensor that is being trained
        return False


# --- engines --------------------------------------------------------------------------------------------------------


def in_parallel(
    engine: str, jobs: int, batch: int, calls: Iterable[Delayed], leave: Callable[[], None] = lambda: None
) -> Iterator[GameResult]:
    """Yield the results of joblib's delayed calls, in order, from `jobs` workers that take `batch` calls at once.

    Workers that outlive the run, as Dask's may, call `leave` at its end. Raises UserError where a worker is lost.
    """
    if engine == LOKY:
        yield from on_this_machine(jobs, batch, calls)
        return
    from joblib import Parallel, parallel_config

    clusters: dict[str, Callable[[int], AbstractContextManager[None]]] = {"ray": _ray, "dask": partial(_dask, leave)}
    waiting = iter(calls)
    with (
        clusters[engine](jobs),
        parallel_config(backend=engine, n_jobs=jobs),
        Parallel(batch_size=batch) as parallel,  # which keeps its workers, with what they opened
    ):
        while submitted := list(islice(waiting, jobs * batch * AHEAD)):
            try:
                yield from parallel(submitted)
            except Exception as error:
                if type(error).__module__.partition(".")[0] not in PACKAGES.values():
                    raise
                raise UserError(
                    f"a worker of {engine} was lost ({type(error).__name__}); go on with --resume"
                ) from error


@contextmanager
def _ray(jobs: int) -> Iterator[None]:
    """Join or start a cluster, whose worker processes are this run's own, and leave what they opened as they end."""
    import ray
    from ray.util.joblib import register_ray

    register_ray()
    own = {} if "RAY_ADDRESS" in os.environ else {"num_cpus": jobs, "_node_ip_address": "127.0.0.1"}
    try:
        ray.init(include_dashboard=False, log_to_driver=False, logging_level="error", **own)
    except Exception as error:  # Ray has no class of errors for it
        raise UserError(f"ray cannot be started or reached: {str(error).partition(chr(10))[0]}") from error
    try:
        yield
    finally:
        ray.shutdown()


@contextmanager
def _dask(leave: Callable[[], None], jobs: int) -> Iterator[None]:
    """Join a cluster, whose workers outlive the run, or start one, which ends with it."""
    from distributed import Client, LocalCluster, fire_and_forget

    if address := os.environ.get("DASK_SCHEDULER_ADDRESS"):
        with Client(address) as client:
            try:
                yield
            finally:
                for worker in client.nthreads():
                    fire_and_forget(client.submit(leave, workers=[worker], pure=False))
        return
    cluster = LocalCluster(
        n_workers=jobs, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50
    )
    with cluster, Client(cluster):
        yield
