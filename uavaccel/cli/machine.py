"""The commands that examine this machine and a policy's pace, and init. They import what they need when run."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from uavaccel.cli.options import Latency, Profile, Trust, option
from uavaccel.cli.terminal import console, print_columns, working
from uavaccel.errors import UsageError, UserError
from uavaccel.suites.keys import KEYS

MOST_COMMANDS = 1_000_000
LONGEST_SQUARE_S = 4_000.0  # that advise flies: some minutes, as it flies it 86 times
SCHEMA = "train.schema.json"  # the file that the starter's YAML names


def calibrate(
    out: Annotated[Path, option("FILE", "YAML file to write.")] = Path("latency.yaml"),
    commands: Annotated[int, option("N", "Commands of each kind to fly, about.", min=1, max=MOST_COMMANDS)] = 1500,
    profile: Profile = "native",
    check: Annotated[bool, option(None, "Compare the same flights on both clocks; write nothing.", "--check")] = False,
    latency: Latency = None,
    games: Annotated[int, option("N", "For --check: flights of each kind.", min=1, max=MOST_COMMANDS)] = 20,
) -> None:
    """Measure the latencies of --timing virtual, or check them."""
    from uavaccel.calibration.calibrate import AGREEMENT_HEAD, AGREES, check_agreement, measure, model_file
    from uavaccel.calibration.doctor import check_machine
    from uavaccel.files import check_new_file
    from uavaccel.sim.camera.gl import describe_renderer
    from uavaccel.wire.latency import read_latency, shipped_latency

    if check:
        model = shipped_latency() if latency is None else read_latency(latency)
        console.print(f"machine check: {check_machine()['verdict']}; latency model: {latency or 'the shipped one'}")
        console.print(AGREEMENT_HEAD)
        verdicts = []
        for agreement in check_agreement(model, profile, games):  # some seconds each
            console.print(agreement.line)
            verdicts.append(agreement.verdict)
        console.print(f"{verdicts.count(AGREES)} of {len(verdicts)} agree")
        return
    check_new_file(out)
    verdict, images = check_machine()["verdict"], True
    console.print(f"machine check: {verdict}")
    try:
        describe_renderer()
    except UserError as error:
        console.print(f"without images, whose latencies become those of any call: {error}")
        images = False
    latencies = measure(profile, commands, images)
    out.write_text(model_file(latencies, profile, verdict))
    for line in latencies.lines():
        console.print(line)
    console.print(f"{out}: use it with `uavaccel run dp1 --set latency={out}`,")
    console.print(f"with train and evaluate as `--timing virtual --set task.latency={out}`")


def advise(
    t_move: Annotated[float, option("S", f"{KEYS['t_move_s'].help}.", "--t-move")] = 1.0,
    error: Annotated[float, option("M", "Error that a trajectory may have, in metres.")] = 0.1,
    rounds: Annotated[int, option("N", "Rounds of the square.", min=1, max=1000)] = 4,
    thinking: Annotated[float, option("S", "Wall seconds between two commands: thinking and messages.")] = 0.02,
    latency: Latency = None,
    profile: Profile = "native",
) -> None:
    """Say how fast ADSC may fly within an error, and a policy fly at all."""
    from uavaccel.calibration.calibrate import ADVISED_SPEEDS, policy_sentence, sentence
    from uavaccel.calibration.calibrate import advise as advised
    from uavaccel.commands import velocities
    from uavaccel.config import MOST_SECONDS
    from uavaccel.sim.profile import PROFILES
    from uavaccel.wire.latency import read_latency, shipped_latency

    if not 0.0 < error < math.inf:
        raise UserError(f"--error {error:g}: must be above 0 metres")
    for name, seconds in (("--thinking", thinking), ("--t-move", t_move)):
        if not 0.0 < seconds <= MOST_SECONDS:
            raise UserError(f"{name} {seconds:g}: must be above 0 and at most {MOST_SECONDS:g} seconds")
    PROFILES[profile].check_duration(t_move, "--t-move")
    if (square_s := t_move * len(velocities("square", rounds))) > LONGEST_SQUARE_S:
        said = f"the square takes {square_s:g} simulated seconds; at most {LONGEST_SQUARE_S:g}"
        raise UserError(f"--t-move {t_move:g} --rounds {rounds}: {said}")
    model = shipped_latency(profile) if latency is None else read_latency(latency)
    with working("flights", 2 * len(ADVISED_SPEEDS)) as advance:
        found, rows = advised(model, profile, t_move, rounds, told=advance), []
    header = ("ClockSpeed", "ADSC error m", "STLC", "speed-up", "TCSC error m", "STLC", "speed-up")
    for clock, both in found.groupby("clock_speed"):
        scores = both[["error_m", "stlc", "speedup"]].to_numpy().ravel()
        rows.append((f"{clock:g}x", *(f"{score:.3g}" for score in scores)))
    print_columns(header, rows)
    console.print(sentence(found, error, t_move))
    console.print(policy_sentence(t_move, thinking))


def bench(context: typer.Context) -> None:
    """Measure this machine, in a source checkout: `python -m benchmarks`, with its names and options."""
    import sys
    from importlib import import_module

    checkout = Path(__file__).parents[2]
    if not (checkout / "benchmarks").is_dir():
        raise UserError("bench: benchmarks/ is in the source, not in the installed package: python -m benchmarks there")
    sys.path.insert(0, str(checkout))
    import_module("benchmarks.__main__").app(context.args, prog_name="uavaccel bench", standalone_mode=False)


def doctor() -> None:
    """Examine this machine: versions, timers, hot loop, renderer, GPU."""
    from rich.console import Console
    from rich.table import Table

    from uavaccel.calibration.doctor import findings

    problems, folding = 0, Console(highlight=False, markup=False)
    for finding in findings():
        row = Table.grid(padding=(0, 1))
        row.add_column(min_width=9)
        row.add_column(overflow="fold")
        row.add_row(finding.name, f"{'! ' if finding.problem else ''}{finding.text}")
        folding.print(row)
        problems += finding.problem
    folding.print("nothing to mend" if not problems else f"{problems} to look at, marked with !")


def init(
    folder: Annotated[
        str | None,
        typer.Argument(metavar="FOLDER", help="A new or an empty folder; with --schema a suite, or your YAML or task."),
    ] = None,
    schema: Annotated[
        bool, option(None, "Print the JSON schema of a suite's YAML files, for editors.", "--schema")
    ] = False,
) -> None:
    """Write a folder to begin in: a training, and a task of your own."""
    from uavaccel.resources import asset

    if schema:
        print(schema_text(folder or "train"), end="")
        return
    if folder is None or not folder.strip():  # as a path, this folder
        raise UsageError("init: name a new or an empty folder")
    path = Path(folder)
    try:
        path.mkdir(parents=True, exist_ok=True)
        if present := sorted(entry.name for entry in path.iterdir()):
            raise UserError(f"{folder}: holds {present[0]}; init wants a new or an empty folder")
        for source in sorted(file for file in asset("starter").iterdir() if file.is_file()):
            (path / source.name).write_bytes(source.read_bytes())
        (path / SCHEMA).write_text(schema_text(str(path / "train.yaml")), encoding="utf-8")
    except OSError as error:
        raise UserError(f"{folder}: {error.strerror}") from error
    console.print(f"{folder}: start with its README.md")


def schema_text(suite: str) -> str:
    """Return the JSON schema of a suite's YAML files, or of the one that is named. Raises UserError."""
    from uavaccel.suites.session import schema_of

    return json.dumps(schema_of(suite), indent=2, sort_keys=True) + "\n"


SHOWN = ".zip (SB3), .onnx, .pt (TorchScript), file.py:function, module:function, tcp://host:port, or a run's folder."
Named = Annotated[str, typer.Argument(metavar="POLICY", help=SHOWN)]
Environment = Annotated[str, typer.Argument(metavar="ENV", help="The id of a Gymnasium environment, or module:ID.")]
Answer = Annotated[float, option("S", "Seconds that a policy server has to answer.")]
Seed = Annotated[int, option("N", "Seed of the first episode.", min=0)]
Sets = Annotated[
    list[str] | None, option("KEY=VALUE", "An argument of RealTime, or env.KEY of the environment.", "--set")
]


def measure(
    policy: Named,
    env: Environment,
    steps: Annotated[int, option("N", "Calls to measure.", min=1)] = 1000,
    warm_up: Annotated[int, option("N", "Calls before them, kept apart.", "--warm-up", min=0)] = 20,
    seed: Seed = 0,
    out: Annotated[Path, option("FILE", "Calibration file to write.")] = Path("thinking.json"),
    answer: Answer = 10.0,
    trust: Trust = False,
    overrides: Sets = None,
) -> None:
    """Measure how long a policy thinks, for RealTime and certify."""
    from uavaccel.files import check_new_file
    from uavaccel.own_code import trusting
    from uavaccel.realtime import measure as measured

    check_new_file(out)
    make, keys = _environment(env, policy, overrides)
    with trusting(trust), _own_errors(env):
        found = measured(make, _policy(policy, make), steps, warm_up, seed, answer_s=answer, **keys)
    for line in found.lines():
        console.print(line)
    console.print(
        f"{found.save(out)}: replay it with RealTime(env, latency_s={str(out)!r}), or timing certify --latency"
    )


def certify(
    policy: Named,
    env: Environment,
    latency: Annotated[
        list[str] | None, option("LATENCY", "Seconds; repeat for several. Or a calibration file.")
    ] = None,
    factor: Annotated[list[float] | None, option("X", "Of the file's times; repeat for several.", min=0)] = None,
    delay: Annotated[list[int] | None, option("N", "Control periods; repeat for several.", min=0)] = None,
    episodes: Annotated[int, option("N", "Episodes at each latency.", min=1)] = 20,
    seed: Seed = 0,
    success: Annotated[str | None, option("KEY", "What the last info calls it; default: is_success, success.")] = None,
    out: Annotated[Path, option("DIR", "New folder for setup, rows, certificate and figure.")] = Path("certificate"),
    resume: Annotated[bool, option(None, "Go on with the folder in --out.", "--resume")] = False,
    jobs: Annotated[int, option("N", "Processes that play the episodes.")] = 1,
    answer: Answer = 10.0,
    trust: Trust = False,
    overrides: Sets = None,
) -> None:
    """Certify how much latency a policy bears."""
    from uavaccel.own_code import trusting
    from uavaccel.realtime import certify as certified

    seconds, file = _latencies(latency or [], factor or [], delay or [])
    make, keys = _environment(env, policy, overrides)
    with trusting(trust), _own_errors(env), working("episodes") as advance:
        how: dict[str, Any] = {"episodes": episodes, "seed": seed, "success": success, "out": out, "resume": resume}
        how |= {"delay_steps": delay or None, "answer_s": answer, "jobs": jobs}
        found = certified(make, _policy(policy, make), seconds, file, **how, told=lambda row: advance(), **keys)
    print_columns(*found.table())
    if found.failed:
        raise UserError(f"{found.line}; --resume --out {out} plays them again")
    console.print(found.line)
    console.print(f"certificate: {out / 'certificate.json'}; figure: {found.figure(out / 'certificate.png')}")


def _latencies(
    given: Sequence[str], factors: Sequence[float], delays: Sequence[int]
) -> tuple[list[float] | None, str | None]:
    """Return seconds, or factors and the file that they are of. Raises UsageError for several at once, or too many."""
    from uavaccel.realtime.thinking import MOST_S

    seconds, files = [], []
    for each in given:
        try:
            seconds.append(float(each))
        except ValueError:
            files.append(each)
    if delays and given:
        raise UsageError(f"--delay {delays[0]}: counts control periods; leave out --latency, or this")
    for name, numbers in (("latency", seconds), ("factor", factors), ("delay", delays)):
        if wrong := [each for each in numbers if not 0 <= each <= MOST_S]:
            raise UsageError(f"--{name} {wrong[0]:g}: must be 0 to {MOST_S:g}")
    if len(files) > 1 or (files and seconds):
        raise UsageError(f"--latency {files[0]}: takes seconds, several of them, or one calibration file")
    if factors and not files:
        raise UsageError(f"--factor {factors[0]:g}: is a factor on the times of a calibration file: --latency FILE")
    return list(factors) or seconds or None, files[0] if files else None


def _environment(env_id: str, policy: str, overrides: list[str] | None) -> tuple[Callable[[], Any], dict[str, Any]]:
    """Return what makes an environment, by default as a policy of this project had it, and RealTime's arguments."""
    from dataclasses import fields
    from importlib.util import find_spec

    import gymnasium

    from uavaccel.config import apply_overrides
    from uavaccel.errors import suggestion
    from uavaccel.own_code import own_module
    from uavaccel.realtime.control_loop import LoopOptions

    keys = apply_overrides({}, overrides or ())
    of_env, known = keys.pop("env", {}), [each.name for each in fields(LoopOptions) if each.init]
    if not isinstance(of_env, dict):
        raise UsageError(f"--set env={of_env}: must be env.KEY=VALUE")
    if _is_of_this_project(policy):
        from uavaccel.rl.agents import origin_of

        origin = origin_of(policy)
        if origin.env_id != env_id:
            raise UserError(f"{policy}: flies {origin.env_id}, not {env_id}")
        of_env = {**origin.keys(), **of_env}
    for key in keys.keys() - known:
        raise UserError(f"--set {key}: RealTime has no such argument; {suggestion(key, [*known, 'env.KEY'])}")

    def make() -> Any:
        module, named, _ = env_id.partition(":")
        if env_id.startswith("uavaccel/"):
            import uavaccel.envs  # noqa: F401  registers them
        elif named and find_spec(module.partition(".")[0]) is None:  # nor is it installed
            own_module(module, f"environment {env_id!r}")
        try:
            return gymnasium.make(env_id, **of_env)
        except TypeError as error:
            raise UserError(f"{env_id}: --set env.KEY: {error}") from error

    return make, keys


@contextmanager
def _own_errors(env_id: str) -> Iterator[None]:
    """Name file, line and function of an environment of one's own that fails."""
    from uavaccel.own_code import errors_named

    try:
        yield
    except Exception:
        file = getattr(sys.modules.get(env_id.partition(":")[0]), "__file__", None)
        with errors_named(file and Path(file).resolve()):
            raise


def _policy(name: str, make: Callable[[], Any]) -> Any:
    """Return a policy of this project, in a run's folder, for the environment's task; what else it is, by its name."""
    if not _is_of_this_project(name):
        return name
    from uavaccel.realtime import Policy
    from uavaccel.rl.agents import make_agent, origin_of

    env = make()
    agent = make_agent(name, env.unwrapped.task)
    env.close()
    return Policy(name, origin_of(name).sha256(), lambda seen: agent.act(seen, {}), env.action_space)


def _is_of_this_project(policy: str) -> bool:
    return policy == "default" or Path(policy).is_dir()
