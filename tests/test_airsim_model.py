"""The modelled AirSim to the nanosecond, and its fitted latencies: what they were fitted to, and what they predict."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.simulating import NORTH, always, answer, fly_velocity, go_to, position, simulate, start, world_of
from tools import fit_agent, fit_airsim
from uavaccel.commands import COMMANDS
from uavaccel.resources import experiment
from uavaccel.sim.profile import AIRSIM, NATIVE, Executor, Frames, Profile
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.vehicle.vehicle import AddedVehicle, Start
from uavaccel.suites import paper_results
from uavaccel.wire.latency import (
    QUANTILES,
    FaultConfig,
    Latency,
    LatencyConfig,
    PlatformConfig,
    delays_ns,
    shipped_latency,
)
from uavaccel.wire.session import Client, open_session

US, MS = 1_000, 1_000_000


def new_client(clock_speed: float, **platform: Any) -> Client:
    """A game of the profile `airsim` in which a call takes 1 ms there and 1 ms back."""
    call = {"call": always(1000.0)}
    config = LatencyConfig(request_us=call, reply_us=call, platform=PlatformConfig(**platform))
    return start(clock_speed, config, profile=AIRSIM)


# --- ticks --------------------------------------------------------------------------------------------------


def test_the_speed_saturates_where_a_tick_takes_its_cost_and_never_makes_good() -> None:
    """A tick of 3 ms in 48 us is 62.5x; the cast to an integer takes ClockSpeeds above 1 alone."""
    for asked, integer, cost_us, speed in (
        *((5, False, 48, 5), (100, False, 48, 62.5), (100, False, 0, 100)),
        *((2.9, True, 0, 2), (0.5, True, 0, 0.5), (90.5, True, 50, 60)),
    ):
        assert Executor(cost_us * US, integer).speed(Fraction(str(asked)), AIRSIM.tick_ns) == speed
    simulation = simulate(100.0, AIRSIM, executor=Executor(48 * US))
    simulation.advance_to(480 * US - 1)
    assert simulation.world.tick == 9
    simulation.advance_to(480 * US)
    assert simulation.world.tick == 10, "at 100x it would be 16"
    assert simulation.clock_speed == 100, "as it was asked for"


def test_a_continue_for_is_wall_time_at_the_requested_speed() -> None:
    """So one at 100x brings 62.5x of it, and TCSC goes on with the difference."""
    simulation = simulate(100.0, AIRSIM, executor=Executor(48 * US))
    simulation.pause(0)
    start_ns = simulation.time_ns
    reply = simulation.continue_for(900 * MS, 0)
    due_ns = simulation.next_event_wall_ns()
    assert due_ns == 9 * MS
    simulation.advance_to(due_ns)
    assert answer(reply).time_ns - start_ns == 9 * MS // (48 * US) * AIRSIM.tick_ns


def test_a_change_of_speed_keeps_what_a_tick_costs() -> None:
    simulation = simulate(1.0, AIRSIM, executor=Executor(60 * US))
    simulation.set_clock_speed(100.0, 0)
    assert go_to(simulation, 10) == 600 * US


def test_the_game_ticks_once_at_each_frame_for_which_images_and_continue_fors_wait() -> None:
    for period_ns, stale, from_ns, to_ns, expected in (
        *((10, True, 0, 9, []), (10, True, 0, 10, [10]), (10, True, 10, 20, [20]), (10, True, 9, 30, [10, 20, 30])),
        *((10, True, 11, 19, []), (10, False, 0, 30, []), (0, True, 0, 30, [])),
    ):
        assert list(Frames(period_ns, stale).ticks(from_ns, to_ns)) == expected
    for period_ns, after_continue, waited in ((10, True, (107, 107)), (10, False, (107, 100)), (0, True, (100, 100))):
        frames = Frames(period_ns, after_continue=after_continue, wait_ns=lambda: 7)
        assert (frames.ready_ns(100), frames.continued(100)) == waited


# --- the client's connection --------------------------------------------------------------------------------


def test_a_request_behind_an_unanswered_command_is_held() -> None:
    """TCSC at 1x: the command is handled at 1 ms, so its continue-for at 41; it flies 504 ms, and a reply is 1 ms."""
    walls = []
    for stall_us in (0.0, 40_000.0):
        client = new_client(1.0, stall_us=stall_us)
        COMMANDS["tcsc"].begin(client)
        client.kinematics()
        start_ns = client.now_ns()
        client.move_async(NORTH, 0.5)
        client.continue_for(504 * MS)
        walls.append(client.now_ns() - start_ns)
    assert walls == [(1 + 504 + 1) * MS, (1 + 40 + 504 + 1) * MS]


def test_an_answer_lets_the_held_request_through() -> None:
    """The command of 20 ms at 10x ends after 2.1 ms of wall time; what was sent behind it goes then, not at 40 ms."""
    client = new_client(10.0, stall_us=40_000.0)
    client.run()
    start_ns = client.now_ns()
    future = client.move_async(NORTH, 0.02)
    client.join(future)
    client.call("ping")
    assert client.now_ns() - start_ns < 8 * MS


def test_adsc_is_not_stalled() -> None:
    walls = []
    for stall_us in (0.0, 40_000.0):
        client = new_client(10.0, stall_us=stall_us)
        COMMANDS["adsc"].begin(client)
        start_ns = client.now_ns()
        list(COMMANDS["adsc"].fly(client, NORTH, 0.1, 0.1))
        walls.append(client.now_ns() - start_ns)
    assert walls[0] == walls[1]


def test_faults_come_with_their_shares_and_their_delays() -> None:
    faults = FaultConfig(dropped=0.01, stalled=0.04, late=0.15, late_us=7000.0)
    stream = delays_ns(faults, np.random.default_rng(1))
    delays = np.array([next(stream) for _ in range(40_000)])
    shares = {delay: float(np.mean(delays == delay * MS)) for delay in (200, 40, 7, 0)}
    assert sum(shares.values()) == 1
    assert shares == pytest.approx({200: 0.01, 40: 0.04, 7: 0.15, 0: 0.80}, abs=0.01)


# --- frames -------------------------------------------------------------------------------------------------


def test_an_image_and_a_continue_for_wait_for_their_frames_paused() -> None:
    """The request 1 ms, the frame, the reply 1 ms; and no simulated time passes meanwhile."""
    client = new_client(10.0, frames={"hz": 62.5, "after_continue": True})
    waits = iter([5 * MS, 11 * MS])
    client.transport._api.simulation.frames.wait_ns = lambda: next(waits)  # type: ignore[attr-defined]
    client.pause()
    start, start_ns = client.kinematics(), client.now_ns()
    state = client.continue_for(30 * MS)
    assert state.time_ns - start.time_ns == 30 * MS
    assert client.now_ns() - start_ns == (1 + 3 + 5 + 1) * MS
    client.transport.wait(client.transport.send("uavaccelImage", ("none",), blocking=True))
    assert client.now_ns() - start_ns == (1 + 3 + 5 + 1 + 1 + 11 + 1) * MS
    assert client.call("uavaccelState")[0] == state.time_ns


def test_waits_for_a_frame_are_even_up_to_two_periods() -> None:
    config = LatencyConfig(platform=PlatformConfig.model_validate({"frames": {"hz": 50.0}}))
    draws = Latency(config, np.random.SeedSequence(3))
    waits_ms = np.array([draws.frame_ns() for _ in range(20_000)]) / MS
    assert np.quantile(waits_ms, [0.0, 0.25, 0.5, 0.75, 1.0]) == pytest.approx([0, 10, 20, 30, 40], abs=0.6)


def test_images_show_the_pose_of_the_last_frame_before_the_pause() -> None:
    """At 10x with a frame every 16 ms, paused at 40: what was flown by 32, not the 80 simulated ms since."""
    world = world_of(AIRSIM)
    simulation = simulate(10.0, AIRSIM, frames=Frames(16 * MS, stale_pose=True))
    fly_velocity(simulation, NORTH, 2.0, 0)
    assert simulation.frames.scene(world.data) is world.data, "before the first frame there is the start"
    simulation.advance_to(40 * MS)
    simulation.pause(40 * MS)
    paused = position(simulation)
    again = simulate(10.0, AIRSIM)
    fly_velocity(again, NORTH, 2.0, 0)
    again.advance_to(32 * MS)
    shown = simulation.frames.scene(world.data).qpos.copy()
    assert np.array_equal(shown, world.data.qpos), "the world, which both flew, stands at the last frame now"
    assert not np.array_equal(paused, position(again))
    simulation.reset(50 * MS)
    assert simulation.frames.scene(world.data) is world.data, "a new game has shown nothing yet"
    simulation.run(50 * MS)
    simulation.advance_to(80 * MS)
    assert simulation.frames.scene(world.data) is not world.data
    simulation.add_vehicles([AddedVehicle("Second", Start((0.0, 5.0, -10.0)))])
    assert simulation.frames.scene(world.data) is world.data, "what was shown is of a model without the second"


# --- variants for ablations -----------------------------------------------------------------------------------------


def test_the_scalable_clock_stretches_the_step_and_another_timeout_ends_goals() -> None:
    """At 5x a step of 15 ms: the 20 ms loop falls on 30, the timeout beyond 60 on 75, the recorder on 60."""
    assert PlatformConfig().profile("airsim", 50.0) is AIRSIM
    assert PlatformConfig(scalable_clock=True).profile("native", 50.0) is NATIVE
    profile = PlatformConfig(scalable_clock=True).profile("airsim", 5.0)
    tick_ms = profile.tick_ns / MS
    assert tick_ms == 15
    loops = (profile.goal_period_ticks, profile.hover_after_ticks, profile.recorder_ticks)
    assert [loop * tick_ms for loop in loops] == [30, 75, 60]
    assert PlatformConfig(scalable_clock=True).profile("airsim", 0.5) is AIRSIM
    latency = LatencyConfig(platform=PlatformConfig(scalable_clock=True))
    with open_session("virtual", "airsim", latency=latency) as session:
        ticks_ns = [session.start_game(clock_speed).recording().tick_ns for clock_speed in (1.0, 5.0, 1.0)]
    assert ticks_ns == [3 * MS, 15 * MS, 3 * MS]
    profile = PlatformConfig(goal_timeout_s=1.0).profile("airsim", 5.0)
    assert profile.hover_after_ticks == 334, "the first of the 3 ms beyond 1 s"
    assert (profile.tick_ns, profile.goal_period_ticks) == (AIRSIM.tick_ns, AIRSIM.goal_period_ticks)


@pytest.mark.parametrize("profile", [PlatformConfig(exact_pauses=True).profile("airsim", 100.0), NATIVE])
def test_exact_pauses_end_on_the_tick_and_wait_for_all_of_them(profile: Profile) -> None:
    """Ticks that cost 48 us each: 100 of 3 ms take 4.8 ms, where a wall timer at 100x would ring after 3."""
    flown_ns = 300 * MS // profile.tick_ns * 48 * US
    simulation = Simulation(world_of(profile), 100.0, executor=Executor(48 * US))
    simulation.reset(0)
    simulation.pause(0)
    start_ns = simulation.time_ns
    reply = simulation.continue_for(300 * MS, 0)
    assert simulation.next_event_wall_ns() == flown_ns
    simulation.advance_to(flown_ns + 200 * US)
    assert answer(reply).time_ns - start_ns == 300 * MS
    assert reply.due_wall_ns == flown_ns


def test_a_scale_is_of_messages_and_of_nothing_that_the_platform_adds() -> None:
    """1 ms there and 2 ms back, half as long, and 3 ms late; frames of 8 ms, of which a wait is two at most."""
    platform = {"faults": {"late": 1.0, "late_us": 3000.0}, "frames": {"hz": 125.0}, "stall_us": 700.0}
    config = LatencyConfig(
        request_us={"call": always(1000.0)},
        reply_us={"call": always(2000.0)},
        timer_us=always(90.0),
        scale=0.5,
        platform=PlatformConfig.model_validate(platform),
    )
    draws = Latency(config, np.random.SeedSequence(0))
    assert [draws.request_ns("move"), draws.reply_ns("move")] == [3500 * US, 4000 * US]
    assert (draws.timer_ns(), draws.stall_ns) == (90 * US, 700 * US)
    waits_ns = [draws.frame_ns() for _ in range(400)]
    assert 15.5 * MS < max(waits_ns) <= 16 * MS


# --- the fit ----------------------------------------------------------------------------------------------------------


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


PAPERS_WHOLE_SPEEDUPS = {5.0: 3.6, 10.0: 5.2}  # section IV-D, the whole training


def test_the_agents_share_is_that_of_the_papers_two_differences() -> None:
    """Solved by hand for each alone: (1 + o) / (1 / s + o) = w; the fit lies between, nearer to the surer one."""
    simulation = {k: PAPERS_FRAME_SPEEDUPS[k] for k in PAPERS_WHOLE_SPEEDUPS}
    alone = [(1 - w / simulation[k]) / (w - 1) for k, w in PAPERS_WHOLE_SPEEDUPS.items()]
    share = paper_results.THINKING_SHARE
    assert alone == pytest.approx([0.1 / 2.6, 0.1875 / 4.2])
    assert alone[0] < share < alone[1]

    def misfit(at: float) -> float:
        wholes = {k: (1 + at) / (1 / paper_results.SIMULATION_SPEEDUP[k] + at) for k in PAPERS_WHOLE_SPEEDUPS}
        return sum((wholes[k] - whole) ** 2 for k, whole in PAPERS_WHOLE_SPEEDUPS.items())

    assert misfit(share) < min(misfit(share - 1e-5), misfit(share + 1e-5))
    for k, whole in PAPERS_WHOLE_SPEEDUPS.items():
        assert (1 + share) / (1 / simulation[k] + share) == pytest.approx(whole, rel=0.02)
        simulated_h, beside_h = paper_results.phase_hours(k)
        assert 182 / (simulated_h + beside_h) == pytest.approx(whole, rel=0.02)
    assert sum(paper_results.phase_hours(1.0)) == pytest.approx(182)


def test_the_agents_costs_take_the_fitted_share_of_a_command() -> None:
    costs = fit_agent.agent_costs(shipped_latency("airsim"))
    thinking_s = 3 * costs["task.image_processing_s"] + costs["inference_s"] + costs["learning_s"]
    real_s = command_wall_s("adsc", 1.0)
    assert thinking_s / real_s == pytest.approx(paper_results.THINKING_SHARE, abs=0.001)
    assert 0.040 < thinking_s < 0.055
    for k, whole in PAPERS_WHOLE_SPEEDUPS.items():
        speedup = (real_s + thinking_s) / (command_wall_s("tcsc", k) + thinking_s)
        assert speedup == pytest.approx(whole, rel=0.1)
