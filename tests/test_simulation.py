"""The simulation between wall time and ticks: when commands, continue-fors and goals begin and end."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulating import EAST, NORTH, answer, fly_velocity, go_to, position, simulate
from uavaccel.errors import UserError
from uavaccel.kinematics import Kinematics
from uavaccel.sim.profile import AIRSIM, NATIVE, Profile
from uavaccel.sim.vehicle import autopilot
from uavaccel.wire.api import Api

TICK_NS = NATIVE.tick_ns


# --- commands -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("clock_speed", [0.5, 1.0, 1.5, 100.0])
def test_a_command_ends_at_its_tick_and_not_a_nanosecond_before(clock_speed: float) -> None:
    simulation = simulate(clock_speed)
    reply = fly_velocity(simulation, NORTH, 0.1, 0)
    end_ns = simulation.pacer.wall_due(50)
    simulation.advance_to(end_ns - 1)
    assert (simulation.world.tick, reply.due_wall_ns) == (49, None)
    assert simulation.next_event_wall_ns() == end_ns
    simulation.advance_to(end_ns)
    assert (simulation.world.tick, answer(reply), reply.due_wall_ns) == (50, True, end_ns)
    assert simulation.next_event_wall_ns() is None


@pytest.mark.parametrize("looked_at", [50, 500])
def test_an_end_is_seen_before_the_next_tick_however_late_one_looks(looked_at: int) -> None:
    simulation = simulate()
    seen = []
    reply = fly_velocity(simulation, NORTH, 0.1, 0)
    reply.on_due = lambda reply: seen.append((simulation.world.tick, reply.due_wall_ns))
    go_to(simulation, looked_at)
    assert seen == [(50, 50 * TICK_NS)]
    assert simulation.world.tick == looked_at


def test_the_latest_command_wins() -> None:
    simulation = simulate()
    first = fly_velocity(simulation, NORTH, 1.0, 0)
    second = fly_velocity(simulation, EAST, 1.0, 0)
    assert (answer(first), first.due_wall_ns) == (False, 0)
    third = fly_velocity(simulation, NORTH, 0.5, go_to(simulation, 500 - 1))
    assert (answer(second), second.due_wall_ns) == (False, 499 * TICK_NS)
    go_to(simulation, 499 + 249)
    assert third.due_wall_ns is None
    go_to(simulation, 499 + 250)
    assert answer(third) is True
    assert [tuple(command) for command in simulation.lead.log] == [(0, 0), (0, 499), (499, 749)]


def test_commands_of_one_instant_take_effect_in_their_order() -> None:
    last_east = simulate()
    fly_velocity(last_east, NORTH, 0.1, 0)
    fly_velocity(last_east, EAST, 0.1, 0)
    go_to(last_east, 100)
    there = position(last_east)
    only_east = simulate()
    fly_velocity(only_east, EAST, 0.1, 0)
    go_to(only_east, 100)
    assert np.array_equal(there, position(only_east))


def test_cancel_and_reset_answer_false() -> None:
    simulation = simulate()
    cancelled = fly_velocity(simulation, NORTH, 1.0, 0)
    simulation.lead.end(False, go_to(simulation, 10))
    assert (answer(cancelled), cancelled.due_wall_ns) == (False, 10 * TICK_NS)
    assert list(simulation.lead.log) == [(0, 10)]
    forgotten = fly_velocity(simulation, NORTH, 1.0, go_to(simulation, 20))
    waiting = simulation.continue_for(10**9, 20 * TICK_NS)
    before_ns = simulation.time_ns
    simulation.reset(go_to(simulation, 30))
    assert answer(forgotten) is False
    assert isinstance(answer(waiting), Kinematics)
    assert (simulation.world.tick, simulation.lead.api_control, len(simulation.lead.log)) == (0, False, 0)
    assert simulation.time_ns == before_ns + 10 * TICK_NS  # simulated time never goes back
    simulation.lead.end(False, 31 * TICK_NS)  # of nothing


def test_a_goal_acts_from_the_next_tick() -> None:
    simulation = simulate()
    wall_ns = go_to(simulation, 7)
    hovering = np.array(simulation.world.lead.state["rotor_input"])
    fly_velocity(simulation, NORTH, 0.1, wall_ns)
    assert np.array_equal(simulation.world.lead.state["rotor_input"], hovering)
    go_to(simulation, 8)
    front, rear = simulation.world.lead.state["rotor_input"][[0, 1]]
    assert front < hovering[0] < rear  # nose down


@pytest.mark.parametrize("gap_ticks", [0, 1, 29, 30, 31])
def test_position_hold_sets_in_60_ms_after_the_last_goal(gap_ticks: int) -> None:
    """At tick 30 after the end, unless a new goal came before that tick; the goal that holds until then is the last."""
    simulation = simulate()
    fly_velocity(simulation, NORTH, 0.2, 0)
    go_to(simulation, 100 + 29)
    assert simulation.world.lead.state["xy_mode"] == autopilot.VELOCITY
    simulation = simulate()
    fly_velocity(simulation, NORTH, 0.2, 0)
    wall_ns = go_to(simulation, 100 + gap_ticks)
    held = bool(simulation.world.lead.state["xy_mode"] == autopilot.POSITION)
    assert held == (gap_ticks >= 30)
    fly_velocity(simulation, NORTH, 0.2, wall_ns)
    go_to(simulation, 100 + gap_ticks + 99)
    assert simulation.world.lead.state["xy_mode"] == autopilot.VELOCITY


@pytest.mark.parametrize(
    ("profile", "cancelled", "held"), [(NATIVE, 40, 70)] + [(AIRSIM, 42 + n, 63) for n in range(7)] + [(AIRSIM, 49, 70)]
)
@pytest.mark.parametrize("call", ["cancelLastTask", "hover"])
def test_after_a_cancel_position_hold_counts_from_the_last_goal(
    profile: Profile, cancelled: int, held: int, call: str
) -> None:
    """Every tick sets it anew in `native`, every seventh after the acceptance in `airsim`: 20 ms on a grid of 3 ms."""
    simulation = simulate(1.0, profile)
    wall_ns = go_to(simulation, 5)
    fly_velocity(simulation, NORTH, 5.0, wall_ns)
    Api(simulation).call(call, [], go_to(simulation, 5 + cancelled))
    go_to(simulation, 5 + held - 1)
    assert simulation.world.lead.state["xy_mode"] == autopilot.VELOCITY
    go_to(simulation, 5 + held)
    assert simulation.world.lead.state["xy_mode"] == autopilot.POSITION


def test_position_hold_brings_the_drone_to_rest() -> None:
    simulation = simulate()
    fly_velocity(simulation, NORTH, 1.0, 0)
    go_to(simulation, 530)
    held_at = position(simulation)
    go_to(simulation, 10_000)
    np.testing.assert_allclose(position(simulation), held_at, atol=2e-2)
    np.testing.assert_allclose(simulation.world.lead.state["velocity"], 0.0, atol=1e-2)


def test_without_api_control_a_command_only_takes_its_time() -> None:
    hovering = simulate()
    go_to(hovering, 300)
    expected = position(hovering)
    ignored = simulate()
    ignored.lead.api_control = False
    reply = fly_velocity(ignored, NORTH, 0.1, 0)
    go_to(ignored, 300)
    assert (answer(reply), reply.due_wall_ns) == (True, 50 * TICK_NS)
    assert np.array_equal(position(ignored), expected)
    assert ignored.lead.arm(False) is False
    assert ignored.world.lead.state["armed"] == 1


def test_giving_up_api_control_ends_the_command_and_the_vehicle_stops() -> None:
    simulation = simulate()
    api = Api(simulation)
    reply = fly_velocity(simulation, NORTH, 5.0, 0)
    wall_ns = go_to(simulation, 500)
    api.call("enableApiControl", [False], wall_ns)
    assert answer(reply) is False
    go_to(simulation, 5000)
    assert abs(simulation.world.lead.state["velocity"][0]) < 0.05


def test_disarmed_rotors_stop() -> None:
    simulation = simulate()
    assert simulation.lead.arm(False) is True
    go_to(simulation, 100)
    assert simulation.world.lead.state["velocity"][2] > 1.5
    assert not simulation.world.lead.state["rotor_input"].any()


def test_a_time_the_step_does_not_divide_is_refused_without_a_trace() -> None:
    simulation = simulate()
    reply = fly_velocity(simulation, NORTH, 0.1, 0)
    with pytest.raises(UserError, match="not a positive multiple of the physics step of 2 ms"):
        fly_velocity(simulation, EAST, 0.333, go_to(simulation, 10))
    go_to(simulation, 50)
    assert answer(reply) is True


# --- pause and continue-for -----------------------------------------------------------------------------


def test_a_paused_world_stands_still_and_its_command_goes_on() -> None:
    simulation = simulate()
    reply = fly_velocity(simulation, NORTH, 0.1, 0)
    simulation.pause(go_to(simulation, 20))
    simulation.advance_to(10**12)
    assert (simulation.world.tick, simulation.next_event_wall_ns()) == (20, None)
    simulation.run(10**12)
    simulation.advance_to(10**12 + 30 * TICK_NS - 1)
    assert reply.due_wall_ns is None
    simulation.advance_to(10**12 + 30 * TICK_NS)
    assert answer(reply) is True


@pytest.mark.parametrize("clock_speed", [0.1, 1.5, 100.0])
def test_a_continue_for_ends_paused_at_the_exact_tick(clock_speed: float) -> None:
    simulation = simulate(clock_speed)
    simulation.pause(0)
    reply = simulation.continue_for(330_000_000, 5_000)
    end_ns = simulation.next_event_wall_ns()
    assert end_ns == simulation.pacer.wall_due(165)
    simulation.advance_to(end_ns + 10**9)
    assert simulation.paused
    assert simulation.world.tick == 165
    assert (answer(reply), reply.due_wall_ns) == (simulation.kinematics(), end_ns)


@pytest.mark.parametrize(
    ("duration_ns", "ticks"), [(0, 0), (999_999, 0), (1_000_001, 1), (2_999_999, 1), (3_000_001, 2)]
)
def test_a_continue_for_is_rounded_to_a_tick(duration_ns: int, ticks: int) -> None:
    simulation = simulate()
    simulation.pause(0)
    reply = simulation.continue_for(duration_ns, 0)
    assert (reply.due_wall_ns == 0) == (ticks == 0)
    simulation.advance_to(10**9)
    answer(reply)
    assert simulation.world.tick == ticks


@pytest.mark.parametrize(("duration_ns", "ticks"), [(0, 0), (1, 1), (2_999_999, 1), (3_000_000, 1), (6_000_000, 2)])
def test_airsims_continue_for_runs_a_tick_at_least(duration_ns: int, ticks: int) -> None:
    """AirSim looks at its timer after a tick; without a duration it is over at once."""
    simulation = simulate(1.0, AIRSIM)
    simulation.pause(0)
    simulation.continue_for(duration_ns, 0)
    while (due_ns := simulation.next_event_wall_ns()) is not None:
        simulation.advance_to(due_ns)
    assert (simulation.paused, simulation.world.tick) == (True, ticks)


@pytest.mark.parametrize("resume", [False, True])
def test_pausing_or_running_in_a_continue_for_releases_its_reply(resume: bool) -> None:
    simulation = simulate()
    reply = simulation.continue_for(10**9, 0)
    wall_ns = go_to(simulation, 100)
    (simulation.run if resume else simulation.pause)(wall_ns)
    assert reply.due_wall_ns == wall_ns
    assert answer(reply).time_ns == simulation.time_ns
    simulation.advance_to(10**10)
    assert simulation.world.tick == (5000 if resume else 100)


def test_a_second_continue_for_replaces_the_first() -> None:
    simulation = simulate()
    first = simulation.continue_for(10**9, 0)
    second = simulation.continue_for(10**9, go_to(simulation, 100))
    assert (first.due_wall_ns, second.due_wall_ns) == (100 * TICK_NS, None)
    simulation.advance_to(10**10)
    assert answer(second).time_ns - answer(first).time_ns == 10**9
    assert simulation.world.tick == 600


def test_a_command_and_a_continue_for_end_together() -> None:
    simulation = simulate(100)
    simulation.pause(0)
    command = fly_velocity(simulation, NORTH, 0.5, 0)
    period = simulation.continue_for(500_000_000, 0)
    simulation.advance_to(10**9)
    assert answer(command) is True
    assert command.due_wall_ns == period.due_wall_ns
    assert simulation.world.tick == 250


def test_airsims_continue_for_time_counts_wall_seconds() -> None:
    simulation = simulate(50)
    simulation.continue_for_wall(0.01, 0)
    simulation.advance_to(10**9)
    assert simulation.world.tick == 250


@pytest.mark.parametrize(("late_ns", "ticks"), [(0, 33), (90_000, 33), (300_000, 34), (3_000_000, 43)])
def test_in_airsim_a_continue_for_is_a_wall_timer(late_ns: int, ticks: int) -> None:
    simulation = simulate(10, AIRSIM, timer_lateness_ns=lambda: late_ns)
    simulation.pause(0)
    reply = simulation.continue_for(100_000_000, 0)
    due_ns = 10_000_000 + late_ns
    assert simulation.next_event_wall_ns() == due_ns
    simulation.advance_to(due_ns - 1)
    assert not simulation.paused
    simulation.advance_to(due_ns)
    answer(reply)
    assert (reply.due_wall_ns, simulation.world.tick) == (due_ns, ticks)
    assert simulation.paused
