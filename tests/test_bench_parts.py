"""What the benches of kernels, cameras and machine make of times that are given here, and the traces of a command."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uavaccel.bench import images, kernels, machine, square
from uavaccel.bench.speed import Measurement
from uavaccel.bench.traces import record_trace
from uavaccel.metrics.trajectory import command_gaps_s
from uavaccel.wire.session import VirtualSession


def by_name(measured: Iterator[Measurement]) -> dict[str, Measurement]:
    return {each.name: each for each in measured}


# --- kernels ---------------------------------------------------------------------------------------------------------


def test_a_command_of_the_kernels_is_held_against_its_ticks_and_its_pictures(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A command of a second has 500 ticks of 2 ms and three frames."""
    ticks_s, seen_s = iter([3e-6, 1e-6, 2e-6]), iter([0.02, 0.05, 0.03])
    advanced: list[int] = []
    exact = SimpleNamespace(advance=advanced.append, close=lambda: None)
    for name, value in (
        ("REPEATS", 3), ("TICKS", 1000), ("_tick_s", lambda: next(ticks_s)), ("World", lambda *_: exact),
        ("elapsed_s", lambda work: (work(), 0.5)[1]), ("_picture_s", lambda: (0.004, 0.016)),
        ("_seen_s", lambda: next(seen_s)), ("usable_cores", lambda: 8), ("_commands_s", lambda lanes: 0.25 * lanes),
        ("COMMANDS", 4), ("CPU_LANES", (64, 128)),
    ):  # fmt: skip
        monkeypatch.setattr(kernels, name, value)
    found = by_name(kernels.bench_on_cores())
    flight, both = found["kernels: flight, one thread"], found["kernels: picture and DVS"]
    assert (flight.value, flight.bound) == pytest.approx((500_000, 2000.0))
    assert advanced == [1000]
    assert found["kernels: picture, one thread"].value == 250.0
    assert found["kernels: DVS, one thread"].value == 62.5
    assert (both.value, both.bound) == pytest.approx((1 / 0.03, 50.0))
    for lanes in (64, 128):
        commands = found[f"kernels: commands, {lanes} lanes"]
        assert commands.value == 16.0
        assert commands.bound == pytest.approx(8 / (500 * 2e-6 + 3 * 0.03))


def test_a_gpus_lanes_are_held_against_one_lanes_chain_and_against_their_parts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As if a flight took 1 ms with one lane and 2 with many, a picture of 50 in colour 0.1 ms and of events 0.3."""
    torch = SimpleNamespace(cuda=SimpleNamespace(get_device_name=lambda: "a card"))
    monkeypatch.setitem(sys.modules, "torch", torch)

    def round_s(lanes: int, task: Any) -> float:
        if task.observation == "state":
            return 0.001 if lanes == 1 else 0.002
        if task.t_sample_s < 0.1:
            return 50 * {"colour": 0.0001, "dvs": 0.0003}[str(task.observation)]
        return 0.004

    monkeypatch.setattr(kernels, "_round_s", round_s)
    found = by_name(kernels.bench_on_gpu())
    for lanes in (512, 4096):
        flight, pictures = found[f"GPU: flight, {lanes} lanes"], found[f"GPU: picture and DVS, {lanes} lanes"]
        commands = found[f"GPU: commands, {lanes} lanes"]
        assert (flight.value, flight.bound) == pytest.approx((lanes * 500 / 0.002, lanes * 500 / 0.001))
        assert (pictures.value, pictures.bound) == pytest.approx((lanes / 0.0003, lanes / 0.0001))
        assert found[f"GPU: a command of {lanes} lanes"].value == pytest.approx(4.0)  # ms
        assert (commands.value, commands.bound) == pytest.approx(
            (lanes / 0.004, lanes / (0.002 + 3 * 0.0003))
        )


def test_a_lane_and_a_batch_are_timed_per_tick_per_picture_and_per_round(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    flown: list[int] = []
    monkeypatch.setattr(kernels, "TICKS", 200)
    monkeypatch.setattr(
        kernels, "one_lane", lambda task: SimpleNamespace(games=0, now=0, plan=SimpleNamespace(hull=0))
    )
    monkeypatch.setattr("uavaccel.kernels.lanes.fly", lambda lane, ticks, *_: flown.append(ticks))
    monkeypatch.setattr(kernels, "elapsed_s", lambda work: (work(), 0.5)[1])
    assert kernels._tick_s() == 0.5 / 200
    assert flown == [1, 200]  # the first one compiles
    worked: list[int] = []
    took_s = iter([9.0, 1.0, 2.0])
    monkeypatch.setattr(kernels, "PICTURES", 3)
    monkeypatch.setattr(kernels, "elapsed_s", lambda work: (work(), next(took_s))[1])
    assert kernels._each_s(worked.append) == 2.0
    assert worked == [1, 2, 3]


# --- cameras ---------------------------------------------------------------------------------------------------------


def test_frame_rates_are_of_the_best_pass_and_their_ratio_of_the_middle_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """150 frames a pass; bare and ours took so many seconds."""
    passes = iter([(3, 4), (1, 5), (2, 2)])
    camera = nullcontext(SimpleNamespace(renderer="a card"))
    monkeypatch.setattr(images, "Camera", lambda model: camera)
    monkeypatch.setattr(images, "_pass", lambda *_: tuple(seconds * 10**9 for seconds in next(passes)))
    *found, renderer = images.frame_rates(3)
    assert (found, str(renderer)) == ([75.0, 150.0, 0.75], "a card")
    monkeypatch.setattr(images, "frame_rates", lambda: (90.0, 120.0, 0.7, SimpleNamespace(name="a card")))
    frames, over = images.bench_camera()
    assert (frames.value, frames.bound, over.value) == (90.0, 120.0, 0.7)


def test_a_pass_times_the_bare_loop_apart_from_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if a bare frame took 2 ns and one of ours 5, at fifteen places with ten frames each."""
    now = SimpleNamespace(ns=0)
    places: list[float] = []

    class Camera:
        height, width = 144, 256

        def colour(self, data: Any) -> None:
            now.ns += 5
            places.append(float(data.qpos[0]))

        def render_again(self, picture: Any) -> None:
            now.ns += 2

    monkeypatch.setattr(images, "MonotonicClock", lambda: SimpleNamespace(now_ns=lambda: now.ns))
    data = SimpleNamespace(qpos=np.zeros(7))
    assert images._pass(Camera(), data) == (15 * 10 * 2, 15 * 10 * 5)  # type: ignore[arg-type]
    assert sorted(set(places)) == [10.0 * number for number in range(15)]


def test_what_the_wire_adds_to_a_picture_is_its_time_less_the_bare_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    took_s = iter([0.004, 0.003, 0.009, 0.001, 0.0015, 0.002])
    asked: list[str] = []
    session = SimpleNamespace(start_game=lambda *_, lane: SimpleNamespace(image=asked.append))
    camera = SimpleNamespace(colour=lambda data: None, render_again=lambda out: asked.append("bare"))
    world = SimpleNamespace(set_lane=lambda _: None, camera=lambda *_: camera, data=None, close=lambda: None)
    for name, value in (
        ("PICTURES", 3), ("WallSession", lambda *_: nullcontext(session)), ("World", lambda *_: world),
        ("elapsed_s", lambda work: (work(), next(took_s))[1]),
    ):  # fmt: skip
        monkeypatch.setattr(images, name, value)
    wire, added = images.bench_image()
    assert asked == ["gray"] * 4 + ["bare"] * 3  # the first one makes the context
    assert (wire.value, wire.bound) == pytest.approx((4.0, 1.5))
    assert (added.value, added.bound) == pytest.approx((2.5, 0.8))


def test_the_dvs_is_timed_frame_by_frame_at_the_times_of_the_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    now, took_ns = SimpleNamespace(ns=0), iter([400_000, 100_000, 300_000])
    stepped: list[tuple[int, float]] = []

    def step(sensor: Any, state: Any, frame: Any, time_s: float) -> Any:
        now.ns += next(took_ns)
        stepped.append((int(frame[0, 0]), time_s))
        return state, None, None

    frames = [np.full((144, 256), number, np.uint8) for number in range(4)]
    monkeypatch.setattr(images, "lane_frames", lambda: frames)
    monkeypatch.setattr(images, "step", step)
    monkeypatch.setattr(images, "MonotonicClock", lambda: SimpleNamespace(now_ns=lambda: now.ns))
    [found] = images.bench_dvs()
    assert (found.value, found.bound) == pytest.approx((0.3, 0.6))
    assert found.unit == "ms"
    assert [number for number, _ in stepped] == [1, 2, 3]
    assert [time_s for _, time_s in stepped] == pytest.approx([0.33, 0.66, 0.99])


def test_an_event_camera_is_timed_per_simulated_second_and_per_picture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Five commands of a second after one to warm up; as if they took 0.1 to 0.5 s."""
    took_s = iter([0.5, 0.1, 0.3, 0.2, 0.4] * 3)

    class Lane:
        def __init__(self, dvs_rate_hz: float | None) -> None:
            self.per_command, self.frames = int(dvs_rate_hz or 3), 1

        def reset(self, **how: Any) -> None: ...
        def close(self) -> None: ...
        def step(self, action: int) -> None:
            self.frames += self.per_command

    monkeypatch.setattr(images, "describe_renderer", lambda: SimpleNamespace(name="a card"))
    monkeypatch.setattr(images, "ObstacleLane", Lane)
    monkeypatch.setattr(images, "frames_seen", lambda lane: lane.frames)
    monkeypatch.setattr(images, "elapsed_s", lambda work: (work(), next(took_s))[1])
    found = by_name(images.bench_event_camera())
    assert {name: (each.value, each.note) for name, each in found.items()} == {
        "event camera at the samples": (300.0, "3 pictures, 100.00 ms each, flight included; a card"),
        "event camera at 100 Hz": (300.0, "100 pictures, 3.00 ms each, flight included; a card"),
        "event camera at 500 Hz": (300.0, "500 pictures, 0.60 ms each, flight included; a card"),
    }


# --- the machine -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cores", "load", "late_us", "doubts"),
    [
        (4, 2.0, 200.0, []),
        (4, 2.1, 200.0, ["load 2.10 on 4 cores"]),
        (2, 1.1, 10.0, ["load 1.10 on 2 cores"]),
        (4, 0.0, 200.1, ["sleeps end 200 us late (90th percentile)"]),
        (1, 0.6, 300.0, [
            "one core for client and server together", "load 0.60 on 1 cores",
            "sleeps end 300 us late (90th percentile)",
        ]),
    ],
)  # fmt: skip
def test_a_machine_is_quiet_by_its_cores_its_load_on_each_and_its_sleeps(
    monkeypatch: pytest.MonkeyPatch, cores: int, load: float, late_us: float, doubts: list[str]
) -> None:
    """Of 50 sleeps, sorted, the median is the 26th and the 90th percentile the 46th."""
    late_ns = [round(1000 * late_us * (number / 45)) for number in range(50)]
    monkeypatch.setattr(machine, "usable_cores", lambda: cores)
    monkeypatch.setattr(machine, "timer_grain_ns", lambda: late_ns)
    monkeypatch.setattr("os.getloadavg", lambda: (load, 99.0, 99.0))
    found = machine.check_machine()
    noisy = f"noisy: {', '.join(doubts)}; measured latencies are pessimistic"
    assert found["verdict"] == (noisy if doubts else "quiet")
    assert (found["cores"], found["load_1min"]) == (cores, load)
    assert found["timer_late_median_us"] == pytest.approx(late_us * 25 / 45, abs=0.001)
    assert found["timer_late_p90_us"] == pytest.approx(late_us, abs=0.001)


# --- commands --------------------------------------------------------------------------------------------------------


def test_a_trace_is_of_the_second_command_alone_in_the_order_of_its_times() -> None:
    """A command of 0.5 s at 50x in lockstep takes 10 ms; the first one has moved the drone by half a second."""
    with VirtualSession("blocks", "native") as session:
        events = record_trace(session, "tcsc", 50.0, 0.5)
    moves = [each for each in events if each["event"] == "call moveByVelocity"]
    assert [each["source"] for each in moves] == ["client"]
    assert [each["event"] for each in events if each["event"].startswith("handle")].count(
        "handle moveByVelocity"
    ) == 1
    assert not any("Trace" in each["event"] for each in events)
    for column in ("wall_s", "sim_s"):
        times = [each[column] for each in events]
        assert times == sorted(times)
    assert events[-1]["sim_s"] - events[0]["sim_s"] == pytest.approx(0.5)
    assert events[-1]["wall_s"] - events[0]["wall_s"] == pytest.approx(0.01)


def test_gaps_are_from_the_end_of_a_command_to_the_start_of_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    assert command_gaps_s([0.0, 1.25, 2.75], [1.0, 2.5, 4.0]) == pytest.approx([0.25, 0.25])
    arrays = {
        "command_start_s": np.array([0.0, 1.25, 3.0]), "command_end_s": np.array([1.0, 2.5, 4.0]),
        "time_s": np.arange(5.0), "position_m": np.zeros((5, 3)),
    }  # fmt: skip
    now_ns = iter([7_000_000_000, 9_500_000_000])
    client = SimpleNamespace(
        now_ns=lambda: next(now_ns), recording=lambda: SimpleNamespace(arrays=lambda: arrays), clock_speed=1.0
    )
    flown: list[Any] = []

    def fly(client: Any, goal: Any, *how: Any) -> tuple[()]:
        flown.append(how)
        return ()

    command = SimpleNamespace(begin=lambda _: None, fly=fly)
    monkeypatch.setattr(square, "COMMANDS", {"adsc": command})
    session: Any = SimpleNamespace(start_game=lambda clock_speed, seeds: client)
    game = square.fly_square(session, "adsc", 5.0, 0.5, 2, 3, 4)
    assert game.gap_s == pytest.approx([0.25, 0.5])
    assert game.wall_s == 2.5
    assert flown == [(0.5, 0.5, 4)] * 8
