"""AirSim's latency model, frozen: what it was fitted to holds on a reduced grid, and what it predicts is near."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tools import fit_agent, fit_airsim
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.resources import experiment
from uavaccel.suites import paper_results
from uavaccel.wire.latency import QUANTILES, shipped_latency

PAPERS_FRAME_SPEEDUPS = {5.0: 4.0, 10.0: 6.4, 50.0: 14.8, 100.0: 15.4}  # section IV-D, rendering on


@cache
def best() -> Any:
    """The parameters that the shipped file says it was written for."""
    first = Path(experiment("latency_airsim.yaml")).read_text(encoding="utf-8").splitlines()[0]
    numbers = [float(part.split("=")[1]) for part in first.partition("Parameters(")[2].rstrip(")").split(",")]
    return fit_airsim.Parameters(*numbers)


@cache
def outcome() -> dict[str, float]:
    values: dict[str, float] = fit_airsim.outcome(best())
    return values


def test_the_shipped_model_is_the_one_that_the_fit_writes() -> None:
    assert fit_airsim.model(best()) == shipped_latency("airsim")


def test_a_latency_has_the_mean_that_was_fitted() -> None:
    """Of the quantiles as they are drawn from: linear in between."""
    table = np.array(fit_airsim.log_normal_us(1000.0))
    widths = np.diff(QUANTILES)
    assert float(widths @ (table[1:] + table[:-1]) / 2) == pytest.approx(1000.0, rel=0.05)


@pytest.mark.parametrize("name", ["tcsc_speedup", "tcsc_speedup_mean", "tcsc_stlc", "adsc_stlc_1x", "adsc_stlc_5x"])
def test_target_of_the_fit(name: str) -> None:
    target = fit_airsim.TARGETS[name]
    assert target.low <= outcome()[name] <= target.high, target.source


def test_figure_6_order_and_spread() -> None:
    """TCSC above ADSC at every T_move; ADSC gains from longer commands, by far more at 100x than at 5x."""
    module, (tick_us, call_ms, callback_ms) = fit_airsim, best()
    keys = {"adsc": (tick_us, call_ms, callback_ms), "tcsc": (tick_us, call_ms, 0.0)}
    real = [module.fly_cell((0.0, call_ms, callback_ms), "adsc", 1.0, t).wall_s for t in module.T_MOVES_S]
    walls = {
        (command, k): [module.fly_cell(keys[command], command, k, t).wall_s for t in module.T_MOVES_S]
        for command in keys
        for k in (5.0, 100.0)
    }
    speedup = {
        cell: np.array([r.mean() / w.mean() for r, w in zip(real, own, strict=True)]) for cell, own in walls.items()
    }
    for k in (5.0, 100.0):
        assert (speedup["tcsc", k] > speedup["adsc", k]).all()
        assert (np.diff(speedup["adsc", k]) > 0).all()
    assert speedup["adsc", 100.0][-1] / speedup["adsc", 100.0][0] > 3
    assert speedup["adsc", 5.0][-1] / speedup["adsc", 5.0][0] < 3


@cache
def command_wall_s(command: str, clock_speed: float) -> float:
    """Of the model that ships."""
    return float(fit_agent.command_wall_s(command, clock_speed, shipped_latency("airsim")))


@pytest.mark.parametrize("clock_speed", PAPERS_FRAME_SPEEDUPS)
def test_speedups_with_rendering_follow_from_the_frame_wait(clock_speed: float) -> None:
    """Nothing was fitted to them, but 60 Hz, a frame per sample on average, is a choice."""
    predicted = command_wall_s("adsc", 1.0) / command_wall_s("tcsc", clock_speed)
    assert predicted == pytest.approx(PAPERS_FRAME_SPEEDUPS[clock_speed], rel=0.1)


@pytest.mark.parametrize(("hz", "speedup"), [(30, 9.1), (45, 12.1), (60, 14.6), (90, 18.7), (120, 21.8)])
def test_speedup_at_100x_is_bound_by_the_frame_rate(hz: float, speedup: float) -> None:
    """What docs/results-paper.md says beside the prediction."""
    frames = {"platform": {"frames": {"hz": hz}}}
    latency = LaneTask(profile="airsim", latency=frames).latency
    walls = [fit_agent.command_wall_s(*flown, latency, commands=60) for flown in (("adsc", 1.0), ("tcsc", 100.0))]
    assert walls[0] / walls[1] == pytest.approx(speedup, rel=0.02)


PAPERS_WHOLE_SPEEDUPS = {5.0: 3.6, 10.0: 5.2}  # section IV-D, the whole training


def test_the_agents_share_is_that_of_the_papers_two_differences() -> None:
    """Solved by hand for each alone: (1 + o) / (1 / s + o) = w; the fit lies between, nearer to the surer one."""
    simulation = {k: PAPERS_FRAME_SPEEDUPS[k] for k in PAPERS_WHOLE_SPEEDUPS}
    alone = [(1 - w / simulation[k]) / (w - 1) for k, w in PAPERS_WHOLE_SPEEDUPS.items()]
    share = paper_results.thinking_share()
    assert alone == pytest.approx([0.1 / 2.6, 0.1875 / 4.2])
    assert alone[0] < share < alone[1]
    for k, whole in PAPERS_WHOLE_SPEEDUPS.items():
        assert (1 + share) / (1 / simulation[k] + share) == pytest.approx(whole, rel=0.02)
        simulated_h, beside_h = paper_results.phase_hours(k)
        assert 182 / (simulated_h + beside_h) == pytest.approx(whole, rel=0.02)
    assert sum(paper_results.phase_hours(1.0)) == pytest.approx(182)


def test_the_agents_costs_take_the_fitted_share_of_a_command() -> None:
    costs = fit_agent.agent_costs(shipped_latency("airsim"))
    thinking_s = 3 * costs["task.image_processing_s"] + costs["inference_s"] + costs["learning_s"]
    real_s = command_wall_s("adsc", 1.0)
    assert thinking_s / real_s == pytest.approx(paper_results.thinking_share(), abs=0.001)
    assert 0.040 < thinking_s < 0.055
    for k, whole in PAPERS_WHOLE_SPEEDUPS.items():
        speedup = (real_s + thinking_s) / (command_wall_s("tcsc", k) + thinking_s)
        assert speedup == pytest.approx(whole, rel=0.1)
