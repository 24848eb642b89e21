"""What a policy is worth in real time: its score against latency, as a certificate that anybody can repeat to the byte.

A folder keeps `setup.json`, what is evaluated; `rows.jsonl`, a line for each episode as it ends; and what follows from
these, `certificate.json` and a figure. An evaluation that was interrupted goes on where it stopped, and ends with the
bytes of one that was not.
"""

from __future__ import annotations

import hashlib
import math
import os
import pickle
import statistics
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from itertools import chain, groupby
from pathlib import Path
from typing import Any

import numpy as np

from uavaccel.errors import Interrupted, UsageError, UserError
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
    write_json,
)
from uavaccel.metrics.intervals import Proportion, bootstrap_interval
from uavaccel.own_code import errors_named, file_of, forget_changed
from uavaccel.processes.workers import check_count, on_this_machine
from uavaccel.realtime.measuring import MakesEnv, environment_identity, made, plain_or_text, versions_with
from uavaccel.realtime.plant import counted
from uavaccel.realtime.policies import ANSWER_S, TCP, Policy, load_policy
from uavaccel.realtime.server import one_line
from uavaccel.realtime.thinking import MOST_S, ThinkingTime, calibrated
from uavaccel.realtime.wrapper import RealTime
from uavaccel.resources import require
from uavaccel.units import real, whole

Row = dict[str, Plain]
SHARE = 0.9  # of the score without latency that has to be left
UNITS = SECONDS, FACTORS, STEPS = "seconds", "factors", "steps"
"""What latencies are counted in; factors are those on the times of a calibration file."""


@dataclass(frozen=True)
class Certificate:
    """The result of an evaluation: what was evaluated, and by latency the score with its 95 % interval.

    The score is the share of successes, in Wilson's interval, where the environment's infos tell them, else the mean
    return, in a bootstrap's.
    """

    setup: Mapping[str, Plain]
    rows: Sequence[Row]
    document: dict[str, Plain] = field(init=False)
    """What certificate.json holds."""

    def __post_init__(self) -> None:
        told = all("error" in row or row["success"] is not None for row in self.rows)
        score, count = "success" if told else "return", self.setup["episodes"]
        groups = (self.rows[at : at + count] for at in range(0, len(self.rows), count))
        cells = [_cell(list(rows), score) for rows in groups]
        lines = "".join(f"{to_json(row)}\n" for row in self.rows).encode()
        found = {"score": score, "cells": cells, "holds": _holds(cells, score)}
        object.__setattr__(self, "document", {**self.setup, **found, "rows_sha256": hashlib.sha256(lines).hexdigest()})

    @property
    def failed(self) -> int:
        """How many episodes failed."""
        return sum("error" in row for row in self.rows)

    @property
    def line(self) -> str:
        """The certificate in one line."""
        said, cells, holds = self.document, self.document["cells"], self.document["holds"]
        policy, by = said["policy"], said["calibration"]
        head = f"{policy['name']} in {said['environment']['id']}"
        hashes = {"policy": policy["sha256"], **({"times": by["sha256"]} if by else {}), "rows": said["rows_sha256"]}
        short = ", ".join(f"{name} {'of unknown hash' if of is None else of[:12]}" for name, of in hashes.items())
        tail = f"{said['episodes']} episode{'s' * (said['episodes'] != 1)} a latency from seed {said['seed']}; {short}"
        if self.failed:
            return f"{head}: no certificate: {self.failed} of {len(self.rows)} episodes failed; {tail}"
        if holds["latency"] is None:
            return f"{head}: no certificate: without latency no episode is a success; {tail}"
        best, until = _scored(cells[0]["mean"], said["score"]), f"{1e3 * holds['latency_s']:.4g} ms"
        until += f", {holds['latency']:g} times {by['file']}" if by else ""
        if said["unit"] == STEPS:
            until += f", {holds['latency']} step{'s' * (holds['latency'] != 1)}"
        until += ", the longest tried" if holds["latency"] == cells[-1]["latency"] else ""
        more = f"holds {SHARE:.0%} of its {said['score']} without latency, {best}, up to {until}"
        return f"{head}: {more} ({tail})"

    def table(self) -> tuple[list[str], list[list[str]]]:
        """Return a header and a line for each latency."""
        score = self.document["score"]
        header = [self.setup["unit"], "median ms", score, "95 %", "failed"]
        lines = []
        for cell in self.document["cells"]:
            known = ["-"] * 3
            if cell["mean"] is not None:
                ends = [_scored(cell[end], score) for end in ("low", "high") if cell[end] is not None]
                known = [f"{1e3 * cell['latency_s']:.4g}", _scored(cell["mean"], score), " to ".join(ends) or "-"]
            lines.append([f"{cell['latency']:g}", *known, str(cell["errors"])])
        return header, lines

    def save(self, path: str | Path) -> Path:
        """Write certificate.json."""
        return write_json(Path(path), self.document)

    def figure(self, path: str | Path) -> Path:
        """Draw the score against latency, in its intervals. Raises UserError without Matplotlib."""
        require("matplotlib", "the figure", "realtime")
        from matplotlib.figure import Figure

        figure = Figure((6.4, 4.0), dpi=150, layout="constrained")
        axes = figure.add_subplot()
        cells = [cell for cell in self.document["cells"] if cell["mean"] is not None]
        at = [1e3 * cell["latency_s"] for cell in cells]
        mean, low, high = (np.array([cell[name] for cell in cells], float) for name in ("mean", "low", "high"))
        axes.errorbar(at, mean, [mean - low, high - mean], fmt="o-", capsize=3)
        if (least := self.document["holds"]["least"]) is not None:
            axes.axhline(least, color="0.5", linestyle="--", label=f"{SHARE:.0%} of that without latency")
            axes.legend(frameon=False)
        score = self.document["score"]
        axes.set(xlabel="latency, ms", ylabel="share of successes" if score == "success" else "return")
        axes.set(**{"ylim": (-0.02, 1.02)} if score == "success" else {})
        axes.set_title(f"{self.setup['policy']['name']} in {self.setup['environment']['id']}", fontsize=10)
        with replacing(written := Path(path)) as file:
            figure.savefig(file, format=written.suffix[1:] or "png", metadata={"Software": None})
        return written


def _cell(rows: Sequence[Row], score: str) -> Row:
    """Return what is known of a latency's episodes."""
    whole_rows = [row for row in rows if "error" not in row]
    cell: Row = {"latency": rows[0]["latency"], "episodes": len(rows), "errors": len(rows) - len(whole_rows)}
    if not whole_rows:
        return cell | dict.fromkeys(("latency_s", "mean", "low", "high"))
    values = [float(row[score]) for row in whole_rows]
    if score == "success":
        ends = Proportion(round(sum(values)), len(values)).interval
    else:
        ends = bootstrap_interval((values,), lambda each: np.asarray(each.mean(axis=-1)), seed=0)
    low, high = (None if np.isnan(end) else end for end in ends)
    latency_s = statistics.median(row["thinking_s"] for row in whole_rows)
    return {**cell, "latency_s": latency_s, "mean": statistics.fmean(values), "low": low, "high": high}


def _holds(cells: Sequence[Row], score: str) -> Row:
    """Return up to which latency, of those that were flown, the score stays near that of the first one.

    `latency_s` is by the mean, `surely_s` by the low end of the interval; None where an episode failed, and where there
    is no success to be left. Of single episodes, which have no interval, `surely_s` is None, too.
    """
    if any(cell["errors"] for cell in cells) or (score == "success" and not cells[0]["mean"]):
        return {"share": SHARE, **dict.fromkeys(("least", "latency", "latency_s", "surely_s"))}
    best = cells[0]["mean"]
    least = best - (1 - SHARE) * abs(best)
    far = dict.fromkeys(("mean", "low"), cells[0])
    for name in far:
        for cell in cells[1:]:
            if cell[name] is None or cell[name] < least:
                break
            far[name] = cell
    held, surely = far["mean"], far["low"]
    surely_s = None if surely["low"] is None or surely["low"] < least else surely["latency_s"]
    of = {"latency": held["latency"], "latency_s": held["latency_s"], "surely_s": surely_s}
    return {"share": SHARE, "least": least, **of}


def _scored(value: float, score: str) -> str:
    return f"{value:.1%}" if score == "success" else f"{value:.4g}"


VERSION = 1
USUAL: dict[str, list[float]] = {SECONDS: [0.0, 0.01, 0.02, 0.05, 0.1, 0.2], FACTORS: [0.0, 0.5, 1.0, 2.0, 4.0]}
SUCCESS = ("is_success", "success")
MOST_FAILURES = 3  # in a row
LONGEST = 100_000  # steps of an episode, unless its environment's own time limit is longer
MOST_EPISODES = 1_000_000
Plan = Sequence[tuple[float, int]]
"""Latency and seed of each episode."""
PART = 5  # episodes that a worker process plays at once


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
            setattr(self, name, counted(name, getattr(self, name), least, most))
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

    def plan(self) -> Plan:
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
    jobs: int = 1,
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
    `told` is called with each row. With `jobs` above 1 so many processes fly, with joblib, the same bytes: policy and
    environment are sent to them, and an id that only this program has registered is unknown there.

    Raises UserError for what does not fit, for a folder of another evaluation, after three failures in a row, and where
    a process is lost.
    """
    check_count(jobs)
    forget_changed()
    if jobs > 1 and isinstance(policy, str) and policy.startswith(f"{TCP}:"):
        raise UsageError(f"--jobs must be 1 with {policy}: a server answers one client after the other")
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
        games = _Games(env, policy, sweep, real_time, Path.cwd(), file_of(type(flown.unwrapped)))
    with closing(loaded), _one_thread():
        plan = sweep.plan()
        rows = folder.begin(setup, plan)
        left = plan[len(rows) :]
        try:
            for row in games.rows(loaded, left) if jobs == 1 else games.in_processes(jobs, left):
                rows.append(row)
                folder.append(row)
                told(row)
                if len(rows) >= MOST_FAILURES and all("error" in row for row in rows[-MOST_FAILURES:]):
                    raise UserError(f"{row['error']}: {MOST_FAILURES} episodes in a row have failed{folder.more}")
        except KeyboardInterrupt:
            raise Interrupted(f"interrupted after {len(rows)} of {len(plan)} episodes{folder.more}") from None
    certificate = Certificate(setup, rows)
    if folder.path is not None:
        certificate.save(folder.path / "certificate.json")
    return certificate


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let PyTorch, where it is loaded, compute in one thread: its results depend on their number."""
    if (torch := sys.modules.get("torch")) is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@dataclass
class _Games:
    """What plays the episodes of a plan: in this process, or sent to others, which have its working directory."""

    env: MakesEnv
    policy: Any
    sweep: Sweep
    real_time: Mapping[str, Any]
    folder: Path
    file: Path | None
    """Of the environment."""

    def rows(self, policy: Policy | None, plan: Plan) -> Iterator[Row]:
        """Play the episodes, in an environment for each latency; a policy that is loaded here was trusted before."""
        for latency, games in groupby(plan, lambda game: game[0]):
            with closing(RealTime(made(self.env), **self.sweep.thinking(latency), **self.real_time)) as flown:
                policy = policy or load_policy(self.policy, flown, trust=True)
                for _, seed in games:
                    yield {"latency": latency, "seed": seed, **_episode(flown, policy, seed, self.sweep.success)}

    def in_processes(self, jobs: int, plan: Plan) -> Iterator[Row]:
        """Play the episodes in parallel, in their order."""
        require("joblib", "jobs above 1", "realtime")
        from cloudpickle import dumps  # which Gymnasium needs
        from joblib import delayed

        try:
            packed = dumps(self)
        except Exception as error:  # whatever a policy of anybody's raises
            what = "the policy or the environment cannot be sent to another process"
            raise UsageError(f"--jobs must be 1: {what}: {one_line(error)}") from error
        calls = (delayed(_rows_in_worker)(packed, plan[at : at + PART]) for at in range(0, len(plan), PART))
        return chain.from_iterable(on_this_machine(jobs, 1, calls))


def _rows_in_worker(packed: bytes, plan: Plan) -> list[Row]:
    """Play a part of the episodes, in the parent's working directory."""
    games: _Games = pickle.loads(packed)
    os.chdir(games.folder)
    with errors_named(games.file):
        return list(games.rows(None, plan))


def _episode(env: RealTime, policy: Policy, seed: int, success: str | None) -> Row:
    """Return the row of an episode."""
    thinking_s: list[float] = []
    total, over, terminated = 0.0, False, False
    info: dict[str, Any] = {}
    longest = max(LONGEST, getattr(env.unwrapped.spec, "max_episode_steps", None) or 0)
    try:
        observation, _ = env.reset(seed=seed)
        policy.reset(seed)
        while not over:
            observation, reward, terminated, truncated, info = env.step(policy(observation))
            total, over = total + reward, terminated or truncated
            thinking_s.append(info["thinking_s"])
            if len(thinking_s) >= longest and not over:
                raise UserError(f"the episode has not ended after {longest:,} steps: give the environment a time limit")
        if not math.isfinite(total):
            raise UserError(f"the return of the episode is {total}")
    except UserError as error:
        return {"error": str(error)}
    if success is not None and success not in info:
        known = ", ".join(map(str, info))
        raise UserError(f"success = {success!r}: the last info of an episode has no such key; it has {known}")
    won: Any = next((info[name] for name in (SUCCESS if success is None else (success,)) if name in info), None)
    if np.size(won) != 1:
        raise UserError(f"success: must be true or false in the last info of an episode, not {one_line(won)}")
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

    def begin(self, setup: Mapping[str, Plain], plan: Plan) -> list[Row]:
        """Write the setup, or compare it with that of the rows there, and return these before the first failure.

        Raises UserError for another evaluation's folder, and for rows that are not those of the plan.
        """
        if self.path is None:
            return []
        self.path.mkdir(parents=True, exist_ok=True)
        self._lock, file = lock_of(self.path), self.path / "setup.json"
        if not file.exists():
            if any(self.path.iterdir()):
                raise UserError(f"{self.path}: no evaluation of a policy, but not empty; take another folder")
            write_json(file, setup)
            return []
        drop_cut_line(self.rows)
        rows = read_lines(self.rows)
        if not rows:  # nothing has been flown by it
            write_json(file, setup)
            return []
        begun, here = read_json(file), parse_json(to_json(setup))
        if other := [key for key in here if not isinstance(begun, dict) or begun.get(key) != here[key]]:
            raise UserError(f"{self.path}: is another evaluation: other {', '.join(other)}; take another folder")
        failed = next((place for place, row in enumerate(rows) if "error" in row), len(rows))
        there = [(row.get("latency"), row.get("seed")) for row in rows]
        numbers = [row.get(name) for row in rows[:failed] for name in ("return", "thinking_s")]
        known = all(row.get("success", "missing") in (None, True, False) for row in rows[:failed])
        if there != list(plan[: len(rows)]) or not known or None in map(real, numbers):
            raise UserError(f"{self.rows}: its rows are not those of this evaluation; take another folder")
        if failed < len(rows):
            with replacing(self.rows) as written:
                written.write("".join(f"{to_json(row)}\n" for row in rows[:failed]).encode())
        return rows[:failed]

    def append(self, row: Row) -> None:
        if self.path is not None:
            append_lines(self.rows, [to_json(row)])
