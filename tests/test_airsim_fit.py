"""AirSim's latency model, frozen: what it was fitted to holds on a reduced grid, and what it predicts is near."""

from __future__ import annotations

import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from uavaccel.commands import COMMANDS
from uavaccel.commands.paths import SQUARE
from uavaccel.kinematics import Kinematics, VelocityGoal
from uavaccel.resources import experiment
from uavaccel.wire.client import Client
from uavaccel.wire.latency import shipped_latency
from uavaccel.wire.session import open_session

PAPERS_FRAME_SPEEDUPS = {5.0: 4.0, 10.0: 6.4, 50.0: 14.8, 100.0: 15.4}  # section IV-D, rendering on


@cache
def fit() -> ModuleType:
    """experiments/fit_airsim.py."""
    path = experiment("fit_airsim.py")
    spec = importlib.util.spec_from_file_location("fit_airsim", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["fit_airsim"] = module
    spec.loader.exec_module(module)
    return module


@cache
def best() -> Any:
    """The parameters that the shipped file says it was written for."""
    first = Path(experiment("latency_airsim.yaml")).read_text(encoding="utf-8").splitlines()[0]
    numbers = [float(part.split("=")[1]) for part in first.partition("Parameters(")[2].rstrip(")").split(",")]
    return fit().Parameters(*numbers)


@cache
def outcome() -> dict[str, float]:
    values: dict[str, float] = fit().outcome(best())
    return values


def test_the_shipped_model_is_the_one_that_the_fit_writes() -> None:
    assert fit().model(best()) == shipped_latency("airsim")


def test_a_latency_has_the_mean_that_was_fitted() -> None:
    """Of the quantiles as they are drawn from: linear in between."""
    table = np.array(fit().log_normal_us(1000.0))
    widths = np.diff(fit().QUANTILES)
    assert float(widths @ (table[1:] + table[:-1]) / 2) == pytest.approx(1000.0, rel=0.05)


@pytest.mark.parametrize(
    "name", ["tcsc_speedup", "tcsc_speedup_mean", "tcsc_stlc", "adsc_stlc_1x", "adsc_stlc_5x"]
)
def test_target_of_the_fit(name: str) -> None:
    target = fit().TARGETS[name]
    assert target.low <= outcome()[name] <= target.high, target.source


def test_figure_6_order_and_spread() -> None:
    """TCSC above ADSC at every T_move; ADSC gains from longer commands, by far more at 100x than at 5x."""
    module, (tick_us, call_ms, callback_ms) = fit(), best()
    keys = {"adsc": (tick_us, call_ms, callback_ms), "tcsc": (tick_us, call_ms, 0.0)}
    real = [module.fly_cell((0.0, call_ms, callback_ms), "adsc", 1.0, t).wall_s for t in module.T_MOVES_S]
    walls = {
        (command, k): [module.fly_cell(keys[command], command, k, t).wall_s for t in module.T_MOVES_S]
        for command in keys
        for k in (5.0, 100.0)
    }
    speedup = {
        cell: np.array([r.mean() / w.mean() for r, w in zip(real, own, strict=True)])
        for cell, own in walls.items()
    }
    for k in (5.0, 100.0):
        assert (speedup["tcsc", k] > speedup["adsc", k]).all()
        assert (np.diff(speedup["adsc", k]) > 0).all()
    assert speedup["adsc", 100.0][-1] / speedup["adsc", 100.0][0] > 3
    assert speedup["adsc", 5.0][-1] / speedup["adsc", 5.0][0] < 3


class Asking:
    """A client that asks for an image with every sample and does not look at it: what counts is when it is there."""

    def __init__(self, client: Client) -> None:
        self._client = client

    def __getattr__(self, name: str) -> Any:
        return getattr(self._client, name)

    def gather(self, state: Kinematics) -> Kinematics:
        transport = self._client.transport
        transport.wait(transport.send("uavaccelImage", ("none",), blocking=True))
        return state


@cache
def command_wall_s(command: str, clock_speed: float, commands: int = 300) -> float:
    """Wall seconds of a command of 1 s with three images."""
    with open_session("virtual", "airsim", "blocks", shipped_latency("airsim")) as session:
        client: Any = Asking(session.start_game(clock_speed, np.random.SeedSequence(0)))
        COMMANDS[command].begin(client)
        start_ns = client.now_ns()
        t_th_ns = round(min(1e-3 * clock_speed, 0.033) * 1e9)
        for index in range(commands):
            list(COMMANDS[command].fly(client, VelocityGoal(SQUARE[index % 4]), 1.0, 0.33, t_th_ns))
        return float(client.now_ns() - start_ns) / 1e9 / commands


@pytest.mark.parametrize("clock_speed", PAPERS_FRAME_SPEEDUPS)
def test_speedups_with_rendering_follow_from_the_frame_wait(clock_speed: float) -> None:
    """Nothing was fitted to them: 60 Hz, a frame per sample on average."""
    predicted = command_wall_s("adsc", 1.0) / command_wall_s("tcsc", clock_speed)
    assert predicted == pytest.approx(PAPERS_FRAME_SPEEDUPS[clock_speed], rel=0.1)
