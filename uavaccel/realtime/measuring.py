"""How long a policy thinks: measured in its environment, kept as a calibration file that `RealTime` replays."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from uavaccel.clock import calendar_time
from uavaccel.errors import UserError
from uavaccel.files import Plain, file_sha256
from uavaccel.machine import host, version_of, versions
from uavaccel.own_code import forget_changed
from uavaccel.realtime.plant import counted
from uavaccel.realtime.policies import ANSWER_S, load_policy
from uavaccel.realtime.server import one_line
from uavaccel.realtime.thinking import MEASURED, Measured
from uavaccel.realtime.wrapper import RealTime

Env = gymnasium.Env[Any, Any]
MakesEnv = str | Callable[[], Env]
"""The id of an environment, or what makes one, such as functools.partial(gymnasium.make, ID, render_mode=None)."""
MOST_STEPS = 1_000_000
PARTS = 10  # of a run, in which drift is looked for
SHOWN = (0.5, 0.9, 0.99, 1.0)


@dataclass(frozen=True)
class Measurement:
    """Thinking times in nanoseconds, in their order: the first ones, which warm up, and the others."""

    warm_up_ns: Sequence[int]
    taken_ns: Sequence[int]
    about: dict[str, Plain]
    """The policy, the environment, the machine, the versions and the date."""

    @property
    def drift_us(self) -> list[float]:
        """The medians of the run's tenths, in microseconds."""
        return [_us(np.median(part)) for part in np.array_split(self.taken_ns, min(PARTS, len(self.taken_ns)))]

    def save(self, path: str | Path) -> Path:
        """Write the calibration file, as `Measured.save` does, without the warm-up; under `measured` is the rest."""
        times = Measured()
        times.taken_ns = list(self.taken_ns)
        name = f"thinking times of {self.about['policy']['name']} in {self.about['environment']['id']}"
        measured = {"warm_up_us": [_us(each) for each in self.warm_up_ns], "drift_us": self.drift_us}
        return times.save(path, name, measured={**self.about, **measured})

    def lines(self) -> Iterator[str]:
        """Yield what was measured, in words."""
        shares = (f"{'median' if share == 0.5 else f'{share:.0%}'} {_ms(self.taken_ns, share)}" for share in SHOWN)
        yield f"{len(self.taken_ns)} thinking times: {', '.join(shares)}"
        if len(self.warm_up_ns):
            first, middle = self.warm_up_ns[0] / 1e6, _ms(self.warm_up_ns, 0.5)
            yield f"warm-up, left out: the first {first:.3g} ms, {len(self.warm_up_ns)} calls in the median {middle}"
        begin, end = self.drift_us[0], self.drift_us[-1]
        yield f"drift: median {begin / 1e3:.3g} ms in the first tenth, {end / 1e3:.3g} ms in the last"


def _us(taken_ns: Any) -> float:
    return round(float(taken_ns) / 1e3, 3)


def _ms(taken_ns: Sequence[int], share: float) -> str:
    return f"{np.quantile(taken_ns, share) / 1e6:.3g} ms"


def measure(
    env: MakesEnv,
    policy: Any,
    steps: int = 1000,
    warm_up: int = 20,
    seed: int = 0,
    trust: bool = False,
    answer_s: float = ANSWER_S,
    **real_time: Any,
) -> Measurement:
    """Let a policy act in an environment which goes on while it thinks, and measure each thinking time on this machine.

    `policy`, `trust` and `answer_s` are what `load_policy` takes; a policy server's time is that of the round trip. The
    first `warm_up` calls are kept apart. `real_time` are further arguments of `RealTime`. Raises UserError as these do,
    and for counts that do not fit.
    """
    steps = counted("steps", steps, 1, MOST_STEPS, " calls")
    warm_up = counted("warm_up", warm_up, 0, MOST_STEPS, " calls")
    forget_changed()
    inside = made(env)
    flown = RealTime(inside, latency_s=MEASURED, **real_time)
    loaded = load_policy(policy, flown, trust, answer_s)
    assert isinstance(flown.thinking, Measured)
    try:
        over = True
        for step in range(warm_up + steps):
            if over:
                episode_seed = seed if step == 0 else None
                observation, _ = flown.reset(seed=episode_seed)
                loaded.reset(episode_seed)
                flown.thinking.observed()  # a reset is no thinking
            observation, _, terminated, truncated, _ = flown.step(loaded(observation))
            over = terminated or truncated
        about = {
            "policy": {"name": loaded.name, "sha256": loaded.sha256},
            "environment": environment_identity(inside),
            "machine": host(),
            "versions": versions_with(inside),
            "date": calendar_time(),
        }
    finally:
        loaded.close()
        flown.close()
    taken_ns = flown.thinking.taken_ns
    return Measurement(taken_ns[:warm_up], taken_ns[warm_up:], about)


def made(env: MakesEnv) -> Env:
    """Make an environment. Raises UserError for an id that Gymnasium does not know, or cannot make."""
    if not isinstance(env, str) and not callable(env):
        raise UserError(f"env: must be the id of an environment, or a function that makes one, not {env!r}")
    try:
        return gymnasium.make(env) if isinstance(env, str) else env()
    except (gymnasium.error.Error, ImportError) as error:
        name = f"environment {env!r}" if isinstance(env, str) else "environment"
        raise UserError(f"{name}: {one_line(error)}") from error


def environment_identity(env: Env) -> dict[str, Plain]:
    """Return an environment's id and keywords, or the name of its class, and the hash of the file of the class."""
    kind, spec = type(env.unwrapped), env.spec
    try:
        code = file_sha256(Path(inspect.getfile(kind)))
    except (OSError, TypeError, UserError):  # it has no file
        code = None
    keys = {} if spec is None else {name: plain_or_text(value) for name, value in spec.kwargs.items()}
    return {"id": kind.__qualname__ if spec is None else spec.id, "kwargs": keys, "sha256": code}


def plain_or_text(value: object) -> Plain:
    """Return a plain value as it is, another as Python prints it."""
    return value if isinstance(value, str | bool | int | float | None) else repr(value)


def versions_with(env: Env) -> dict[str, str]:
    """Return the versions of what is installed of this project's packages, and of the package of the environment."""
    package = type(env.unwrapped).__module__.partition(".")[0]
    found = versions() | {package: version_of(package)}
    return {name: version for name, version in found.items() if version is not None}
