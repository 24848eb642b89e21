"""The simulation between wall time and ticks: when commands, continue-fors and goals begin and end."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulating import EAST, NORTH, answer, fly_velocity, go_to, position, simulate
from uavaccel.errors import UserError
from uavaccel.sim.profile import AIRSIM, NATIVE

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


def test_a_time_the_step_does_not_divide_is_refused_without_a_trace() -> None:
    simulation = simulate()
    reply = fly_velocity(simulation, NORTH, 0.1, 0)
    with pytest.raises(UserError, match="not a positive multiple of the physics step of 2 ms"):
        fly_velocity(simulation, EAST, 0.333, go_to(simulation, 10))
    go_to(simulation, 50)
    assert answer(reply) is True


# --- pause and continue-for -----------------------------------------------------------------------------


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


@pytest.mark.parametrize(("duration_ns", "ticks"), [(0, 0), (1, 1), (2_999_999, 1), (3_000_000, 1), (6_000_000, 2)])
def test_airsims_continue_for_runs_a_tick_at_least(duration_ns: int, ticks: int) -> None:
    """AirSim looks at its timer after a tick; without a duration it is over at once."""
    simulation = simulate(1.0, AIRSIM)
    simulation.pause(0)
    simulation.continue_for(duration_ns, 0)
    while (due_ns := simulation.next_event_wall_ns()) is not None:
        simulation.advance_to(due_ns)
    assert (simulation.paused, simulation.world.tick) == (True, ticks)


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
