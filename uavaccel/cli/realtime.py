"""The commands that examine a policy in real time, on any Gymnasium environment: timing measure and certify."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from uavaccel.cli.options import Trust, option
from uavaccel.cli.terminal import console, print_columns, working
from uavaccel.errors import UsageError, UserError

SHOWN = ".zip (SB3), .onnx, .pt (TorchScript), file.py:function, module:function, tcp://host:port, or a run's folder."
Named = Annotated[str, typer.Argument(metavar="POLICY", help=SHOWN)]
Environment = Annotated[str, typer.Argument(metavar="ENV", help="The id of a Gymnasium environment.")]
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
    with trusting(trust):
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

    seconds, file = _latencies(latency or [], factor or [])
    make, keys = _environment(env, policy, overrides)
    with trusting(trust), working("episodes") as advance:
        how: dict[str, Any] = {"episodes": episodes, "seed": seed, "success": success, "out": out, "resume": resume}
        how |= {"delay_steps": delay or None, "answer_s": answer, "jobs": jobs}
        found = certified(make, _policy(policy, make), seconds, file, **how, told=lambda row: advance(), **keys)
    print_columns(*found.table())
    if found.failed:
        raise UserError(f"{found.line}; --resume --out {out} plays them again")
    console.print(found.line)
    console.print(f"certificate: {out / 'certificate.json'}; figure: {found.figure(out / 'certificate.png')}")


def _latencies(given: Sequence[str], factors: Sequence[float]) -> tuple[list[float] | None, str | None]:
    """Return seconds, or factors and the file that they are of. Raises UsageError for both at once."""
    seconds, files = [], []
    for each in given:
        try:
            seconds.append(float(each))
        except ValueError:
            files.append(each)
    if len(files) > 1 or (files and seconds):
        raise UsageError(f"--latency {files[0]}: takes seconds, several of them, or one calibration file")
    if factors and not files:
        raise UsageError(f"--factor {factors[0]:g}: is a factor on the times of a calibration file: --latency FILE")
    return list(factors) or seconds or None, files[0] if files else None


def _environment(env_id: str, policy: str, overrides: list[str] | None) -> tuple[Callable[[], Any], dict[str, Any]]:
    """Return what makes an environment, by default as a policy of this project had it, and RealTime's arguments."""
    from dataclasses import fields

    import gymnasium

    from uavaccel.config import apply_overrides
    from uavaccel.errors import suggestion
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
        if env_id.startswith("uavaccel/"):
            import uavaccel.envs  # noqa: F401  registers them
        try:
            return gymnasium.make(env_id, **of_env)
        except TypeError as error:
            raise UserError(f"{env_id}: --set env.KEY: {error}") from error

    return make, keys


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
