"""What a policy is worth in real time: its score against latency, as a certificate that anybody can repeat to the byte.

A folder keeps `setup.json`, what is evaluated; `rows.jsonl`, a line for each episode as it ends; and what follows from
these, `certificate.json` and a figure. An evaluation that was interrupted goes on where it stopped, and ends with the
bytes of one that was not.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uavaccel.errors import Interrupted, UserError
from uavaccel.files import (
    Plain,
    append_lines,
    check_new_folder,
    drop_cut_line,
    file_sha256,
    lock_of,
    parse_json,
    read_json,
    read_lines,
    replacing,
    to_json,
)
from uavaccel.realtime.certificate import FACTORS, SECONDS, STEPS, Certificate, Row
from uavaccel.realtime.measuring import MOST_STEPS, MakesEnv, environment_identity, made, plain_or_text, versions_with
from uavaccel.realtime.policies import ANSWER_S, Policy, load_policy
from uavaccel.realtime.thinking import MOST_S, ThinkingTime, calibrated
from uavaccel.realtime.wrapper import RealTime
from uavaccel.units import real, whole

VERSION = 1
USUAL: dict[str, list[float]] = {SECONDS: [0.0, 0.01, 0.02, 0.05, 0.1, 0.2], FACTORS: [0.0, 0.5, 1.0, 2.0, 4.0]}
SUCCESS = ("is_success", "success")
MOST_FAILURES = 3  # in a row
MOST_EPISODES = 1_000_000


@dataclass
class Scaled(ThinkingTime):
    """A factor on the thinking times of another source."""

    source: ThinkingTime
    factor: float

    def sample_ns(self, generator: np.random.Generator) -> int:
        return round(self.factor * self.source.sample_ns(generator))


@dataclass
class Sweep:
    """What is evaluated: latencies, 0 always among them, and episodes, at each latency those with the same seeds.

    Latencies are seconds, with a `calibration` file factors on its times, or `delay_steps`, counts of control periods.
    Raises UserError for values that do not fit.
    """

    latencies: Any = None
    calibration: str | Path | None = None
    delay_steps: Any = None
    episodes: int = 20
    seed: int = 0
    success: str | None = None

    def __post_init__(self) -> None:
        for name, least, most in (("episodes", 1, MOST_EPISODES), ("seed", 0, (1 << 32) - MOST_EPISODES)):
            if (count := whole(given := getattr(self, name))) is None or not least <= count <= most:
                raise UserError(f"{name}: must be {least} to {most:,}, not {given!r}")
            setattr(self, name, count)
        if self.delay_steps is not None and (self.latencies, self.calibration) != (None, None):
            raise UserError("delay_steps: is given beside seconds; leave out latencies and calibration, or this")
        self.unit = STEPS if self.delay_steps is not None else SECONDS if self.calibration is None else FACTORS
        self.source = None if self.calibration is None else calibrated(self.calibration)
        self.latencies = self._sorted()

    def _sorted(self) -> list[float]:
        kind: Callable[[object], float | None] = whole if self.unit == STEPS else real
        name = "delay_steps" if self.unit == STEPS else "latencies"
        if (given := getattr(self, name)) is None:
            return USUAL[self.unit]
        listed = list(given) if isinstance(given, Iterable) else [None]
        known = [each for one in listed if (each := kind(one)) is not None and 0 <= each <= MOST_S]
        if not known or len(known) < len(listed):
            what = "counts" if self.unit == STEPS else "numbers"
            raise UserError(f"{name}: must be {what}, 0 to {MOST_S:g}, not {given!r}")
        return sorted({0 if self.unit == STEPS else 0.0, *known})

    def thinking(self, latency: float) -> dict[str, Any]:
        """Return the arguments of `RealTime` for one of the latencies."""
        if self.unit == STEPS:
            return {"delay_steps": latency}
        return {"latency_s": latency if self.source is None else Scaled(self.source, latency)}

    def plan(self) -> list[tuple[float, int]]:
        """Return the latency and the seed of each episode, in the order of the rows."""
        return [(latency, self.seed + number) for latency in self.latencies for number in range(self.episodes)]

    def setup(self) -> dict[str, Plain]:
        """Return what a certificate says of it."""
        name = self.calibration
        times = None if name is None else {"file": str(name), "sha256": file_sha256(Path(name))}
        swept = {"latencies": self.latencies, "unit": self.unit, "calibration": times}
        return {**swept, "episodes": self.episodes, "seed": self.seed, "success": self.success}


def certify(
    env: MakesEnv,
    policy: Any,
    latencies: Sequence[float] | None = None,
    calibration: str | Path | None = None,
    *,
    delay_steps: Sequence[int] | None = None,
    episodes: int = 20,
    seed: int = 0,
    success: str | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    trust: bool = False,
    answer_s: float = ANSWER_S,
    told: Callable[[Row], object] = lambda row: None,
    **real_time: Any,
) -> Certificate:
    """Evaluate a policy at several latencies, by default 0 to 200 ms, on the same episodes; the same bytes every time.

    `env` is the id of an environment or makes one; `policy`, `trust` and `answer_s` are what `load_policy` takes.
    `latencies` are seconds or, with a `calibration` file, factors on its times, by default 0 to 4; or `delay_steps` are
    counts of control periods. At each of them, 0 always among them, `episodes` with the seeds from `seed` on are
    played. An environment begins anew with `reset(seed=...)`, as Gymnasium has it, and a policy that draws or remembers
    with its own `reset`.
    `success` is the key of the last info that says whether an episode was won, by default is_success or success.
    `real_time` are further arguments of `RealTime`.

    With `out`, a new folder, rows are on disk as they come, and `resume` goes on with it: whole rows stay, failed ones
    are played again. An episode in which the policy fails, as one whose server has ended, has a row with `error`.
    `told` is called with each row.

    Raises UserError for what does not fit, for a folder of another evaluation, and after three failures in a row.
    """
    sweep, folder = Sweep(latencies, calibration, delay_steps, episodes, seed, success), _Folder(out, resume)
    with closing(RealTime(made(env), latency_s=0.0, **real_time)) as flown:
        loaded = load_policy(policy, flown, trust, answer_s)
        setup = {
            "certificate": VERSION,
            "policy": {"name": loaded.name, "sha256": loaded.sha256},
            "environment": environment_identity(flown),
            "real_time": {name: plain_or_text(value) for name, value in real_time.items()},
            **sweep.setup(),
            "versions": versions_with(flown),
        }
    with closing(loaded):
        rows = folder.begin(setup, sweep.plan())
        _play(env, loaded, sweep, rows, folder, told, real_time)
    certificate = Certificate(setup, rows)
    if folder.path is not None:
        certificate.save(folder.path / "certificate.json")
    return certificate


def _play(
    env: MakesEnv,
    policy: Policy,
    sweep: Sweep,
    rows: list[Row],
    folder: _Folder,
    told: Callable[[Row], object],
    real_time: Mapping[str, Any],
) -> None:
    """Play the episodes that have no row yet, in an environment for each latency."""
    plan = sweep.plan()
    try:
        while len(rows) < len(plan):
            latency = plan[len(rows)][0]
            with closing(RealTime(made(env), **sweep.thinking(latency), **real_time)) as flown:
                for seed in [seed for at, seed in plan[len(rows) :] if at == latency]:
                    rows.append({"latency": latency, "seed": seed, **_episode(flown, policy, seed, sweep.success)})
                    folder.append(rows[-1])
                    told(rows[-1])
                    if len(rows) >= MOST_FAILURES and all("error" in row for row in rows[-MOST_FAILURES:]):
                        many = f"{MOST_FAILURES} episodes in a row have failed"
                        raise UserError(f"{rows[-1]['error']}: {many}{folder.more}")
    except KeyboardInterrupt:
        raise Interrupted(f"interrupted after {len(rows)} of {len(plan)} episodes{folder.more}") from None


def _episode(env: RealTime, policy: Policy, seed: int, success: str | None) -> Row:
    """Return the row of an episode."""
    thinking_s: list[float] = []
    total, over, terminated = 0.0, False, False
    info: dict[str, Any] = {}
    try:
        observation, _ = env.reset(seed=seed)
        policy.reset(seed)
        while not over:
            observation, reward, terminated, truncated, info = env.step(policy(observation))
            total, over = total + reward, terminated or truncated
            thinking_s.append(info["thinking_s"])
            if len(thinking_s) >= MOST_STEPS:
                raise UserError(f"the episode has not ended after {MOST_STEPS:,} steps: give it a time limit")
        if not math.isfinite(total):
            raise UserError(f"the return of the episode is {total}")
    except UserError as error:
        return {"error": str(error)}
    if success is not None and success not in info:
        raise UserError(f"success = {success!r}: the last info of an episode has no such key; it has {', '.join(info)}")
    won = next((info[name] for name in (SUCCESS if success is None else (success,)) if name in info), None)
    return {
        "return": total,
        "success": None if won is None else bool(won),
        "steps": len(thinking_s),
        "terminated": bool(terminated),
        "thinking_s": statistics.median(thinking_s),
        "simulated_s": info.get("simulated_s"),
    }


class _Folder:
    """Where an evaluation is kept; nowhere without a path."""

    def __init__(self, out: str | Path | None, resume: bool) -> None:
        self.path = None if out is None else Path(out)
        self.more = "" if out is None else f"; go on with it, in {out}, by --resume (resume=True)"
        if self.path is not None:
            check_new_folder(self.path, resume)
            self.rows = self.path / "rows.jsonl"

    def begin(self, setup: Mapping[str, Plain], plan: Sequence[tuple[float, int]]) -> list[Row]:
        """Write the setup, or compare it with that which is there, and return the rows before the first failure.

        Raises UserError for another evaluation's folder, and for rows that are not those of the plan.
        """
        if self.path is None:
            return []
        self.path.mkdir(parents=True, exist_ok=True)
        self._lock, file = lock_of(self.path), self.path / "setup.json"
        if not file.exists():
            if any(self.path.iterdir()):
                raise UserError(f"{self.path}: no evaluation of a policy, but not empty; take another folder")
            with replacing(file) as written:
                written.write(f"{to_json(setup, indent=1)}\n".encode())
            return []
        begun, here = read_json(file), parse_json(to_json(setup))
        if other := [key for key in here if not isinstance(begun, dict) or begun.get(key) != here[key]]:
            raise UserError(f"{self.path}: is another evaluation, with another {', '.join(other)}; take another folder")
        drop_cut_line(self.rows)
        rows = read_lines(self.rows)
        failed = next((place for place, row in enumerate(rows) if "error" in row), len(rows))
        there = [(row.get("latency"), row.get("seed")) for row in rows]
        if there != list(plan[: len(rows)]) or not all(map(_is_row, rows[:failed])):
            raise UserError(f"{self.rows}: its rows are not those of this evaluation; take another folder")
        if failed < len(rows):
            with replacing(self.rows) as written:
                written.write("".join(f"{to_json(row)}\n" for row in rows[:failed]).encode())
        return rows[:failed]

    def append(self, row: Row) -> None:
        if self.path is not None:
            append_lines(self.rows, [to_json(row)])


def _is_row(row: Row) -> bool:
    """Return whether a row has what a certificate reads."""
    numbers = (row.get("return"), row.get("thinking_s"))
    return all(real(each) is not None for each in numbers) and row.get("success") in (None, True, False)
