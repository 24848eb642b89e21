"""Scripts on a simulated clock: exact, repeatable, and without a way to fail in silence."""

import contextlib
import hashlib
import json
import random
import re
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from tests.running import full_device
from tests.scripts import Folder
from uavaccel.airsim import MultirotorClient
from uavaccel.cli.main import main
from uavaccel.errors import UserError
from uavaccel.files import UNFINISHED
from uavaccel.fly import simulated, wall
from uavaccel.fly.log import (
    MESSAGES,
    TABLE,
    TRAJECTORY,
    DifferenceError,
    MessageLog,
    brief,
    equal,
    largest_difference_m,
    write_states,
    write_trajectory,
)
from uavaccel.fly.options import SUMMARY, FlightOptions
from uavaccel.fly.script import FlightOver, run_script
from uavaccel.fly.simulated import FREE_CALLS, SimulatedFlight
from uavaccel.kinematics import Kinematics
from uavaccel.units import NS_PER_S
from uavaccel.wire.settings import Settings
from uavaccel.wire.types import EPOCH_NS

FlightMaker = Callable[..., SimulatedFlight]


@pytest.fixture
def flight_in() -> Iterator[FlightMaker]:
    """Makes flights without a script, in lockstep unless told otherwise."""
    with contextlib.ExitStack() as stack:

        def make(folder: Path, clock_speed: float = 1.0, settings: Any = None, **options: Any) -> SimulatedFlight:
            folder.mkdir(exist_ok=True)
            asked = FlightOptions(Path("script.py"), (), folder, **{"timing": "lockstep", **options})
            log = MessageLog(folder, asked.reference)
            stack.callback(check_times, folder)
            stack.callback(log.close, ended=False)
            return SimulatedFlight(asked, Settings.model_validate(settings or {}), clock_speed, log)

        yield make


def check_times(folder: Path) -> None:
    """Answers arrive after their calls."""
    rows = [json.loads(line) for line in (folder / MESSAGES).read_text().splitlines()]
    asked_ns = {row["call"]: row["wall_ns"] for row in rows if "call" in row}
    early = [row for row in rows if "answer" in row and row["wall_ns"] < asked_ns[row["answer"]]]
    assert early == []


def client_of(flight: SimulatedFlight, timeout_s: float = 3600) -> MultirotorClient:
    with patch("uavaccel.airsim.connection._connect", flight._connect):
        return MultirotorClient(timeout_value=timeout_s)


PACED = """
    import setup_path
    import airsim, keyboard
    import numpy, queue, random, sys, threading, time
    from datetime import datetime

    client = airsim.MultirotorClient()
    client.confirmConnection()
    client.simPrintLogMessage("read ", input("name? ") + input("more? "))
    client.enableApiControl(True)
    client.simPause(True)
    for step in range(4):
        client.moveByVelocityAsync(2, 0, 0, 1)
        client.simPause(False)
        time.sleep(0.25)
        client.simPause(True)
        print(client.getMultirotorState().timestamp)
    client.client.call_async("moveNowhere").join()
    client.simPause(False)
    watched, over = queue.Queue(), threading.Event()
    def watch():
        while not over.is_set():
            watched.put(airsim.MultirotorClient().getMultirotorState().timestamp)
            time.sleep(0.02)
    watcher = threading.Thread(target=watch)
    watcher.start()
    client.moveByVelocityAsync(0, 1, 0, 1).join()
    over.set()
    watcher.join()
    print("watched", watched.qsize())
    print("drawn", random.random(), numpy.random.rand(), keyboard.read_key(), sys.flags.hash_randomization)
    print(sys.argv[1:], datetime.now().year, __name__, airsim.wait_key("key?") == chr(10), input() == "")
    sys.exit(3)
"""


# --- the whole way, in processes -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_script_flies_twice_to_the_same_bytes(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONHASHSEED", "7")
    out = folder.path / "out"
    exact = ("--think", "0", "--seed", "3", "--keys", "space", "--out", str(out))
    done = folder.fly(PACED, "--check", *exact, "--", "-a", "--clock", "7", "", answers="one\n")  # read by both flights
    assert done.returncode == 3, done.stderr  # the script's own
    assert "thinking" not in done.stdout
    lines = done.stdout.splitlines()
    assert {"name? one", "more? "} < {*lines}  # nothing is typed after the last answer
    paused = [int(line) for line in lines if line.isdigit()]
    assert [time_ns - EPOCH_NS for time_ns in paused] == [250_000_000, 500_000_000, 750_000_000, 1_000_000_000]
    assert "['-a', '--clock', '7', ''] 2020 __main__ True True" in lines
    assert "watched 50" in lines
    assert f"drawn {random.Random(3).random()} {np.random.RandomState(3).rand()} space 0" in lines
    assert lines[-1].startswith("checked: flown twice, ")
    assert done.stderr.count("warning: moveNowhere is not known here") == 2  # once a flight
    summary = json.loads((out / "flight.json").read_text())
    assert summary["refused"] == ["1 x moveNowhere is not known here"]
    with np.load(out / "trajectory.npz") as arrays:
        assert arrays["time_ns"].tolist() == list(range(0, 2_000_000_001, 50_000_000))
        assert 0.3 < arrays["position_m"][-1, 0] < 2.0


@pytest.mark.parametrize(("arguments", "text", "status"), [
    (["none.py"], "none.py: no such file", 1),
    (["--clock", "1,x", "none.py"], "--clock 1,x: should be numbers with commas between", 2),
    (["--clock", "0", "none.py"], "every ClockSpeed must be above 0", 2),
    (["--timing", "real", "none.py"], "'--timing': real: must be wall or virtual or lockstep", 2),
    (["--check", "--timing", "wall", "tests/scenes.py"], "--check flies one ClockSpeed twice", 2),
    (["--check", "--clock", "1,2", "tests/scenes.py"], "--check flies one ClockSpeed twice", 2),
    (["--film", "tests/scenes.py"], "--film needs --out", 2),
    (["--think", "1", "--timing", "wall", "tests/scenes.py"], "--film and --think need --timing virtual", 2),
])  # fmt: skip
def test_mistakes_are_one_line(
    arguments: list[str], text: str, status: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["uavaccel", "fly", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == status
    assert text in capsys.readouterr().err


# --- time ----------------------------------------------------------------------------------------------------------


def test_making_the_simulation_is_no_time_of_the_flight(flight_in: FlightMaker, tmp_path: Path) -> None:
    flight, times = flight_in(tmp_path), iter([NS_PER_S, 4 * NS_PER_S])
    with patch.object(simulated, "MonotonicClock", lambda: SimpleNamespace(now_ns=times.__next__)):
        client_of(flight).ping()
    flight._client = SimpleNamespace(spent_s=0.5)  # type: ignore[assignment]
    assert flight.unflown_s == 3.5


def test_declared_thinking_is_flown_through(flight_in: FlightMaker, tmp_path: Path) -> None:
    flight = flight_in(tmp_path, clock_speed=2.0, think_s=0.05)
    client = client_of(flight)
    first = client.getMultirotorState().timestamp
    assert client.getMultirotorState().timestamp - first == 100_000_000
    flight.pass_time(0.1)
    flight.end()
    with np.load(tmp_path / "trajectory.npz") as kept:
        assert kept["time_ns"].tolist() == [*range(0, 450_000_000, 50_000_000)]  # two thoughts and a sleep


@pytest.mark.parametrize(
    ("folder", "settings", "kept_in"),
    [
        ("out", {}, "out/recordings"),
        ("scratch/flight", {}, "home/Documents/AirSim"),
        ("scratch/flight", {"Recording": {"Folder": "home/mine"}}, "home/mine"),
    ],
    ids=["an own folder", "none", "none, but settings"],
)
def test_the_end_keeps_a_recording_and_refuses_what_comes_after(
    folder: str, settings: Any, kept_in: str, flight_in: FlightMaker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scratch").mkdir()
    flight = flight_in(tmp_path / folder, settings=settings, scratch=tmp_path / "scratch")
    client = client_of(flight)
    client.startRecording()
    flight.pass_time(0.5)
    flight.end()
    [kept] = tmp_path.rglob("airsim_rec.txt")
    assert kept.parents[1] == tmp_path / kept_in
    times = [line.split("\t")[1] for line in kept.read_text().splitlines()[1:]]
    assert int(times[-1]) - int(times[0]) >= 400  # milliseconds
    calls = flight._log.calls
    with pytest.raises(FlightOver):
        client.ping()
    assert flight._log.calls == calls


@pytest.mark.parametrize("timing", ["virtual", "wall"])
def test_until_keeps_the_flight_of_a_script_that_catches_all(timing: str, folder: Folder) -> None:
    text = """
        import airsim, time
        client, ends = airsim.MultirotorClient(), 0
        while True:
            try:
                while True:  # whose jumps, where an end may arrive, are within the try
                    (client.ping if ends else time.time)()
            except:
                ends += 1
    """
    out = folder.path / "out"
    done = folder.fly(text, "--until", "0.5", "--timing", timing, "--out", str(out))
    assert done.returncode == 0, done.stderr
    [wall_s] = re.findall(r"^stopped by --until; 0\.\d+ simulated s in ([0-9.]+) s", done.stdout)
    assert float(wall_s) < 30.0  # the script's, not the machine's
    assert "uavaccel: the script catches every exception and does not end; it is ended here" in done.stderr
    with np.load(out / "trajectory.npz") as kept:
        assert len(kept["time_ns"]) >= 10
        assert timing == "wall" or kept["time_ns"][-1] > 0.4 * NS_PER_S


def test_a_command_is_waited_for_once(flight_in: FlightMaker, tmp_path: Path) -> None:
    flight = flight_in(tmp_path)
    command = client_of(flight).hoverAsync()
    answers = [command.get() for _ in range(2)]
    flight._log.close()
    lines = (tmp_path / MESSAGES).read_text().splitlines()
    assert (answers, len([line for line in lines if "answer" in line])) == ([False] * 2, 1)


def test_of_the_calls_since_a_wait_so_many_are_free(flight_in: FlightMaker, tmp_path: Path) -> None:
    flight = flight_in(tmp_path)
    client = client_of(flight)
    for wait in (client.moveByVelocityAsync(1, 0, 0, 1).join, lambda: flight.pass_time(0.5)):
        wait()
        begun_s = flight.summary()["script_s"]
        for free, calls in ((True, FREE_CALLS), (False, 1)):
            for _ in range(calls):
                client.ping()
            assert (flight.summary()["script_s"] == begun_s) == free


# --- nothing fails silently ----------------------------------------------------------------------------------------


def test_flights_that_differ_stop_at_the_first_message_that_does(flight_in: FlightMaker, tmp_path: Path) -> None:
    for speed, reference in ((1.0, None), (2.0, tmp_path / "1.0")):
        flight = flight_in(tmp_path / str(speed), reference=reference)
        client = client_of(flight)
        client.enableApiControl(True)
        if reference is None:
            client.moveByVelocityAsync(speed, 0, 0, 1).join()
            flight._log.close()
    with pytest.raises(DifferenceError, match=r"differ at call 2\n  first: .*1.0, 0, 0, 1.*\n  second: .*2.0, 0, 0, 1"):
        client.moveByVelocityAsync(speed, 0, 0, 1)


def test_long_values_are_logged_by_length_and_digest() -> None:
    """On the wire a text of that length has a head of two bytes: its kind, and its length."""
    assert brief("a" * 198) == "a" * 198
    digest = hashlib.sha256(b"\xd9\xc7" + b"a" * 199).hexdigest()
    assert brief("a" * 199) == {"bytes": 201, "sha256": digest[:32]}


# --- imports -------------------------------------------------------------------------------------------------------


def test_no_python_is_one_line(folder: Folder) -> None:
    with pytest.raises(UserError, match=r"script\.py:2: not Python: invalid syntax$"):
        run_script(folder.write("import airsim\nclient = = 1\n"), ())


def test_a_full_disk_is_said_at_every_later_message(tmp_path: Path) -> None:
    """A script may catch the first error; so the log's end says it too."""
    (tmp_path / MESSAGES).symlink_to("/dev/full")
    log, full = MessageLog(tmp_path), rf"{MESSAGES}: No space left on device; make room$"

    def fill() -> None:
        for number in range(200):
            log.answer(log.call(number, None, "ping", ()), number, None, True)

    for late in (fill, lambda: log.call(0, None, "ping", ()), lambda: log.close(ended=False)):
        with pytest.raises(UserError, match=full):
            late()


@pytest.mark.parametrize("name", [TRAJECTORY, TABLE])
def test_a_trajectory_for_which_there_is_no_room_is_named(name: str, tmp_path: Path) -> None:
    full_device(tmp_path / f"{name}{UNFINISHED}")
    with pytest.raises(UserError, match=rf"{re.escape(name)}: No space left on device; make room$"):
        write_trajectory(tmp_path, np.arange(20), np.zeros((20, 10)))


def test_flights_that_share_only_some_times_are_compared_at_those(tmp_path: Path) -> None:
    """East at 0, 50, 100 ms and at 50, 100, 150 ms: 1 and 2 m against 1.5 and 4.5 m."""
    for name, first, easts in (("a", 0, [9.0, 1.0, 2.0]), ("b", 1, [1.5, 4.5, 99.0]), ("late", 7, [0.0])):
        (tmp_path / name).mkdir()
        rows = np.zeros((len(easts), 10))
        rows[:, 1] = easts
        write_trajectory(tmp_path / name, (first + np.arange(len(easts))) * 50_000_000, rows)
    assert largest_difference_m(tmp_path / "a", tmp_path / "b") == 2.5
    assert largest_difference_m(tmp_path / "b", tmp_path / "a") == 2.5
    assert largest_difference_m(tmp_path / "a", tmp_path / "late") == 0.0


def test_a_trajectory_is_written_as_arrays_and_as_a_table(tmp_path: Path) -> None:
    rows, time_ns = np.arange(20.0).reshape(2, 10), np.array([0, 12_340_050_000_000])
    write_trajectory(tmp_path, time_ns, rows)
    with np.load(tmp_path / "trajectory.npz") as kept:
        assert kept["time_ns"].tolist() == time_ns.tolist()
        found = [kept[name].tolist() for name in ("position_m", "orientation_wxyz", "velocity_m_s")]
    assert found == [rows[:, columns].tolist() for columns in (slice(3), slice(3, 7), slice(7, 10))]
    states = []
    for at_ns, row in zip(time_ns.tolist(), rows, strict=True):
        place, attitude, velocity = (tuple(row[part].tolist()) for part in (slice(3), slice(3, 7), slice(7, 10)))
        states.append(Kinematics(at_ns, place, attitude, velocity, (0.5, 0.5, 0.5)))
    (tmp_path / "added").mkdir()
    write_states(tmp_path / "added", states)
    assert equal(tmp_path / "added", tmp_path)
    header, _, last = (tmp_path / "trajectory.csv").read_text().splitlines()
    assert dict(zip(header.split(","), map(float, last.split(",")), strict=True))["q_w"] == 13.0
    assert last.startswith("12340.05,10,11,12,")


def test_in_wall_time_the_trajectory_is_the_servers_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the first vehicle: whole milliseconds, and places to which velocities belong.

    The flight ends by the machine's clock.
    """
    row = "{0}\t{1}\t{2}\t0\t-1\t1\t0\t0\t0\t".format
    rows = [row(name, 1000 + 50 * n, 0.1 * n + ord(name)) for n in range(3) for name in "BA"]
    for name, part in (("2021", rows[4:]), ("2020", rows[:4])):  # a script has begun another one
        (made := tmp_path / "recordings" / name).mkdir(parents=True)
        (made / "airsim_rec.txt").write_text("\n".join(["header", *part]) + "\n")
    options = FlightOptions(tmp_path / "script.py", (), tmp_path, "wall")
    log = MessageLog(tmp_path)
    log.close()
    flight = wall.WallFlight(options, Settings.model_validate({"Vehicles": {"B": {}, "A": {}}}), 4.0, log)
    flight.end()
    with np.load(tmp_path / "trajectory.npz") as kept:
        assert kept["time_ns"].tolist() == [1_000_000_000, 1_050_000_000, 1_100_000_000]
        np.testing.assert_allclose(kept["velocity_m_s"], [[2.0, 0.0, 0.0]] * 3)
    for seconds in (0.5, 0.25):
        flight._slept(seconds)
    kept = {"position_m": [65.2, 0.0, -1.0], "slept_s": 0.75, "think_s": 0.0}
    assert flight.summary() == kept | {"simulated_s": pytest.approx(0.1)}
    timers: list[float] = []
    monkeypatch.setattr("signal.setitimer", lambda kind, seconds: timers.append(seconds))
    with wall.stopping_after(20.0, 4.0, threading.Event()):
        pass
    assert timers == [5.0, 0.0]


@pytest.mark.parametrize(("clock_speed", "until_s", "lines"), [(1.0, 30.0, 1), (4.0, 30.0, 1), (4.0, 19.0, 0)])
def test_a_wait_without_an_end_is_worth_a_line(
    flight_in: FlightMaker,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    clock_speed: float,
    until_s: float,
    lines: int,
) -> None:
    """After 20 simulated seconds, whatever the ClockSpeed."""
    monkeypatch.setattr(simulated, "PATIENCE_NS", 20 * NS_PER_S)
    flight = flight_in(tmp_path, clock_speed, until_s=until_s)
    client = client_of(flight)
    client.enableApiControl(True)
    with pytest.raises(FlightOver):
        client.moveByVelocityAsync(0, 0, 0, 3e38).join()
    line = "the script has waited 20 simulated s for moveByVelocity; the vehicle is at 0.0 0.0 "
    assert capsys.readouterr().err.count(line) == lines


def test_an_answer_is_late_as_a_clients_timeout_has_it(
    flight_in: FlightMaker, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A join goes on, as AirSim's; get, and a call that waits, raise."""
    flight = flight_in(tmp_path)
    client = client_of(flight, 1.5)
    client.enableApiControl(True)
    future = client.moveByVelocityAsync(0, 0, 0, 4)
    told: list[Any] = []
    future.attach_callback(lambda late: told.append((late.error, flight._clock.now_ns())))
    future.join()
    assert told == [("no answer within 1.5 s", 1_500_000_000)]
    assert capsys.readouterr().err == "airsim: moveByVelocity failed: no answer within 1.5 s\n"
    with pytest.raises(TimeoutError, match=r"^moveByVelocity: no answer within 1\.5 s$"):
        future.get()
    with pytest.raises(TimeoutError, match="simContinueForTime"):
        client.simContinueForTime(9.0)
    assert client_of(flight, float("inf")).moveByVelocityAsync(0, 0, 0, 4).get() is True


@pytest.mark.parametrize("timing", ["lockstep", "virtual"])
def test_a_callback_is_called_while_the_client_waits_for_something_else(
    flight_in: FlightMaker, tmp_path: Path, timing: str
) -> None:
    """At the answer's time, in their order, within which the client can be called; not while the script sleeps."""
    flight = flight_in(tmp_path, timing=timing)
    client, other = client_of(flight), client_of(flight)
    told: list[Any] = []

    def tell(future: Any) -> None:
        told.append((future.method, future.result, flight._clock.now_ns() / 1e9))
        client.ping()

    client.enableApiControl(True)
    client.rotateByYawRateAsync(10, 1).attach_callback(tell)
    flight.pass_time(0.25)
    client.moveByVelocityAsync(1, 0, 0, 0.5).attach_callback(tell)
    other.moveByVelocityAsync(1, 0, 0, 1).join()
    assert told == []
    client.ping()
    assert [each[:2] for each in told] == [("rotateByYawRate", False), ("moveByVelocity", False)]
    client.moveByVelocityAsync(1, 0, 0, 0.5).attach_callback(tell)
    client.simContinueForTime(2.0)
    assert told[2][:2] == ("moveByVelocity", True)
    assert told[2][2] == pytest.approx(1.75, abs=0.01 * (timing == "virtual"))


def test_an_interrupted_flight_keeps_what_was_flown(folder: Folder) -> None:
    text = """
        import airsim, os, signal
        client = airsim.MultirotorClient()
        client.enableApiControl(True)
        client.moveByVelocityAsync(1, 0, 0, 2).join()
        os.kill(os.getpid(), signal.SIGINT)
    """
    assert folder.fly_here(text).returncode == 130
    assert not json.loads((folder.path / "out" / SUMMARY).read_text())["finished"]
    with np.load(folder.path / "out" / TRAJECTORY) as arrays:
        assert arrays["time_ns"][-1] == 2_000_000_000
