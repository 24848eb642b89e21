"""Between wall time and ticks: when commands and pauses begin and end; what is kept, failures, and repeatability."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.simulating import EAST, NORTH, answer, fly_velocity, go_to, position, simulate
from uavaccel.errors import UserError
from uavaccel.sim import recording as recordings
from uavaccel.sim.profile import AIRSIM, NATIVE, Profile
from uavaccel.sim.simulation import MOST_CATCH_UP_TICKS, Simulation
from uavaccel.sim.vehicle import vehicle as samples
from uavaccel.sim.vehicle.vehicle import AddedVehicle, Start
from uavaccel.sim.world import World

TICK_NS, CATCH_UP_NS = NATIVE.tick_ns, NATIVE.catch_up_wall_ns


@pytest.mark.parametrize("profile", [NATIVE, AIRSIM])
def test_samples_lie_on_exact_ticks_from_the_first_command_on(profile: Profile) -> None:
    """The recorder runs from the game's start and starts again when the first command is accepted."""
    simulation = simulate(100, profile)
    simulation.world.start_recording()
    wall_ns = go_to(simulation, 37)
    assert len(simulation.recording().samples) > 1
    fly_velocity(simulation, NORTH, 1.0, wall_ns)
    simulation.advance_to(wall_ns + 10_000_003)  # 1 s and 0.3 us
    recording = simulation.recording()
    period = profile.recorder_ticks
    ticks = recording.samples[:, 0]
    assert np.array_equal(ticks, np.arange(0, simulation.world.tick - 37 + 1, period))
    assert recording.commands.tolist()[0][0] == 0
    np.testing.assert_allclose(recording.samples[0, 1:4], [0.0, 0.0, -10.0], atol=1e-6)
    fly_velocity(simulation, EAST, 1.0, wall_ns + 10_000_003)
    assert len(simulation.recording().samples) == len(ticks), "a second command starts nothing"


def test_samples_are_the_states_at_their_ticks_and_have_decimal_times() -> None:
    simulation = simulate()
    simulation.world.start_recording()
    go_to(simulation, 5)
    states = []
    for tick in range(0, 1001, 25):
        if tick in (0, 500):
            fly_velocity(simulation, NORTH, 1.0, go_to(simulation, 5 + tick))
        go_to(simulation, 5 + tick)
        now = simulation.kinematics()
        numbers = (now.position_m, now.orientation_wxyz, now.linear_velocity_m_s, now.angular_velocity_rad_s)
        states.append([tick, *(number for vector in numbers for number in vector)])
    assert np.array_equal(simulation.recording().samples, states)
    arrays = simulation.recording().arrays()
    assert arrays["time_s"].tolist() == [round(0.05 * i, 2) for i in range(41)]
    assert arrays["command_start_s"].tolist() == [0.0, 1.0]
    assert arrays["command_end_s"].tolist() == [1.0, 2.0]
    names = ["position_m", "orientation_wxyz", "linear_velocity_m_s", "angular_velocity_rad_s"]
    assert np.array_equal(np.hstack([arrays[name] for name in names]), np.array(states)[:, 1:])


def test_a_full_recorder_drops_and_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(samples, "SAMPLE_CAPACITY", 8)
    simulation = Simulation(World("blocks", NATIVE))
    simulation.world.start_recording()
    go_to(simulation, 11 * NATIVE.recorder_ticks)
    recording = simulation.recording()
    assert recording.samples[:, 0].tolist() == [25 * i for i in range(8)]
    assert recording.dropped == 4
    simulation.world.start_recording()
    assert (len(simulation.recording().samples), simulation.recording().dropped) == (1, 0)


def test_a_full_command_log_keeps_the_first_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recordings, "COMMAND_LOG_LENGTH", 3)
    simulation = simulate()
    simulation.world.start_recording()
    for tick in (10, 30, 50, 70, 90):
        fly_velocity(simulation, NORTH, 0.02, go_to(simulation, tick))
    go_to(simulation, 110)
    kept = simulation.recording()
    assert kept.commands.tolist() == [[0, 10], [20, 30], [40, 50]]
    assert kept.samples[:, 0].tolist() == [0, 25, 50, 75, 100]
    assert kept.commands_dropped == 2
    log = simulation.lead.log
    assert log.last_goal(105, 10) == 100, "of the latest, for which there was no room"
    fly_velocity(simulation, NORTH, 1.0, go_to(simulation, 120))
    simulation.lead.end(False, go_to(simulation, 130))
    assert log.ticks().tolist() == [[10, 20], [30, 40], [50, 60]]
    assert (log.last_goal(130, 7), log.dropped, len(log)) == (127, 3, 3)


@pytest.mark.parametrize(("clock_speed", "vehicles"), [(1_000.0, 1), (10_000.0, 1), (1_000.0, 5)])
def test_no_more_is_made_good_at_once_than_others_can_wait_for(clock_speed: float, vehicles: int) -> None:
    """At a ClockSpeed of 10 000, 0.1 s are half a million ticks, seconds of computing, at every request."""
    simulation = simulate(1.0, catch_up_wall_ns=CATCH_UP_NS)
    simulation.set_clock_speed(clock_speed, 0)
    if vehicles > 1:
        simulation.add_vehicles([AddedVehicle(f"V{n}", Start((3.0 * n, 5.0, -9.0))) for n in range(1, vehicles)])
    simulation.advance_to(CATCH_UP_NS)
    assert simulation.world.tick == MOST_CATCH_UP_TICKS // vehicles + 1
    speed = simulation.speed
    made_good_ns = simulation.world.tick * TICK_NS / clock_speed
    assert speed.wall_ns - speed.lost_wall_ns == pytest.approx(made_good_ns, rel=1e-2)


def test_whoever_watches_is_called_at_its_own_ticks() -> None:
    """Counted from its first one; one that ends itself is called no more, and others at that tick are."""
    world = simulate().world
    seen: dict[str, list[int]] = {"all": [], "once": []}
    ends = [world.watch(13, lambda tick: once(tick)), world.watch(10, seen["all"].append, first_tick=3)]

    def once(tick: int) -> None:
        seen["once"].append(tick)
        ends[0]()

    assert [world.advance(ticks) for ticks in (5, 20, 8)] == [5, 20, 8]
    ends[1]()
    world.advance(20)
    assert seen == {"all": [3, 13, 23, 33], "once": [13]}


held_up = st.lists(st.integers(0, 3 * CATCH_UP_NS), min_size=1, max_size=12)


@settings(max_examples=50)
@given(held_up, st.sampled_from([0.5, 1.0, 1.5]))
def test_what_is_not_flown_is_counted_as_lost(waits_ns: list[int], clock_speed: float) -> None:
    """Simulated time is ClockSpeed times the wall time that was not lost, to a tick, however often some was lost."""
    simulation = simulate(clock_speed, catch_up_wall_ns=CATCH_UP_NS)
    wall_ns = 0
    for wait_ns in waits_ns:
        wall_ns += wait_ns
        before = simulation.world.tick
        simulation.advance_to(wall_ns)
        flown = simulation.world.tick - before
        assert flown <= CATCH_UP_NS * clock_speed / TICK_NS + 1
    speed = simulation.speed
    assert speed.wall_ns == wall_ns
    missing_ns = (speed.wall_ns - speed.lost_wall_ns) * clock_speed - speed.simulated_ns
    assert -len(waits_ns) < missing_ns < TICK_NS + len(waits_ns)  # anchors are whole nanoseconds
    assert (speed.lost_wall_ns > 0) or max(waits_ns) <= CATCH_UP_NS + TICK_NS / clock_speed


def test_lost_time_never_changes_the_step() -> None:
    """The flight of a machine that is held up is the same flight, later."""

    def positions(wait_ns: int) -> tuple[NDArray[np.float64], Simulation]:
        simulation = simulate(10, catch_up_wall_ns=CATCH_UP_NS)
        simulation.world.start_recording()
        fly_velocity(simulation, NORTH, 20.0, 0)
        wall_ns = 0
        while simulation.world.tick < 10_000:
            wall_ns += wait_ns
            simulation.advance_to(wall_ns)
        return simulation.recording().samples[:401], simulation

    prompt, quick = positions(1_000_000)
    assert quick.speed.lost_wall_ns == 0
    assert quick.speed.real_time_factor == 10
    delayed, slow = positions(250_000_000)
    assert slow.speed.lost_wall_ns > 10**9
    assert slow.speed.real_time_factor == pytest.approx(4, rel=0.01)
    assert np.array_equal(prompt, delayed)
    assert slow.world.model.opt.timestep == 0.002


@pytest.mark.parametrize("poison", [np.nan, np.inf, 1e12])
def test_a_flight_that_cannot_be_integrated_is_a_failure_until_a_reset(
    poison: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log
    simulation = simulate(100)
    simulation.world.start_recording()
    command = fly_velocity(simulation, NORTH, 1.0, 0)
    wall_ns = go_to(simulation, 100)
    simulation.world.data.qvel[0] = poison
    go_to(simulation, 200)
    assert simulation.failure is not None
    assert "MuJoCo warned of mjWARN_BAD" in simulation.failure
    assert not simulation.paused
    period = simulation.continue_for(10**9, go_to(simulation, 300))
    simulation.advance_to(wall_ns + 10**10)
    assert answer(command) is False
    assert answer(period).time_ns == simulation.time_of(800)
    assert list(simulation.lead.log) == [(0, 500)]
    simulation.run(2 * 10**10)
    later = fly_velocity(simulation, EAST, 1.0, 2 * 10**10)
    simulation.advance_to(3 * 10**10)
    assert answer(later) is False
    assert len(simulation.recording().samples) > 1000, "time and the recorder go on"
    simulation.reset(3 * 10**10)
    assert not simulation.failure
    assert not simulation.lead.api_control
    assert len(simulation.lead.log) == 0
    simulation.advance_to(4 * 10**10)
    np.testing.assert_allclose(position(simulation), [0.0, 0.0, -10.0], atol=1e-6)


def test_another_speed_goes_on_from_here() -> None:
    simulation = simulate(1)
    simulation.set_clock_speed(100, go_to(simulation, 100))
    simulation.advance_to(100 * TICK_NS + 10 * TICK_NS)
    assert simulation.world.tick == 100 + 1000
    with pytest.raises(UserError, match="clock_speed"):
        simulation.set_clock_speed(0, 10**9)
    assert simulation.clock_speed == 100


looks = st.lists(st.integers(0, 3 * 10**7), max_size=20).map(sorted)


@settings(max_examples=30)
@given(looks, st.sampled_from([0.5, 1.5, 100.0]))
def test_how_often_one_looks_changes_nothing(looks_ns: list[int], clock_speed: float) -> None:
    """Two commands, a gap with position hold, a continue-for: the same samples, bit for bit."""

    def flown(looks_ns: list[int]) -> NDArray[np.float64]:
        simulation = simulate(clock_speed)
        simulation.world.start_recording()
        ends = [simulation.pacer.wall_due(tick) for tick in (100, 180)]
        fly_velocity(simulation, NORTH, 0.2, 0)
        for wall_ns in [look for look in looks_ns if look < ends[1]]:
            simulation.advance_to(wall_ns)
        simulation.advance_to(ends[1])
        fly_velocity(simulation, EAST, 0.2, ends[1])
        simulation.continue_for(400_000_000, ends[1])
        for look_ns in looks_ns:
            simulation.advance_to(ends[1] + look_ns)
        simulation.advance_to(ends[1] + 10**10)
        return simulation.recording().samples

    samples = flown(looks_ns)
    assert len(samples) == 16
    assert np.array_equal(samples, flown([]))
