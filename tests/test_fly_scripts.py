"""What a script of AirSim's time, or of ours, may use under `uavaccel fly`: each in a process, as its user runs it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.scripts import ROOT, Folder
from uavaccel.errors import UserError
from uavaccel.fly.options import FlightOptions, found_settings
from uavaccel.fly.process import settings_of


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Folder:
    return Folder(tmp_path, monkeypatch, capfd)


# --- the simulated clock -------------------------------------------------------------------------------------------

EXECUTORS = """
    import airsim, asyncio, concurrent.futures, sched, time
    from multiprocessing.pool import ThreadPool

    def since(begun):
        return round(time.monotonic() - begun, 3)

    def waits(seconds):
        time.sleep(seconds)
        return round(seconds, 1)

    async def tasks():
        loop, begun = asyncio.get_running_loop(), time.monotonic()
        loop.call_later(0.7, lambda: print("later", since(begun)))
        print("to_thread", await asyncio.to_thread(waits, 1.5), since(begun))
        client = airsim.MultirotorClient()
        client.enableApiControl(True)
        client.moveByVelocityAsync(2, 0, 0, 9)
        begun_ns = client.getMultirotorState().timestamp
        for _ in range(10):
            await asyncio.sleep(0.5)
        print("flown", client.getMultirotorState().timestamp - begun_ns)
        moves = client.moveByVelocityAsync(2, 0, 0, 9)
        loop.call_later(0.5, client.cancelLastTask)
        begun = time.monotonic()
        print("cancelled", await asyncio.to_thread(moves.get), since(begun))
        end = loop.time() + 0.01
        while loop.time() < end:
            await asyncio.sleep(0)

    asyncio.run(tasks())
    begun = time.monotonic()
    scheduler = sched.scheduler()
    scheduler.enter(2, 1, lambda: print("sched", since(begun)))
    scheduler.run()
    with ThreadPool(2) as pool:
        print("ThreadPool", pool.map(waits, (1, 0.5, 0.2)), since(begun))
    from joblib import Parallel, delayed  # a library's threads keep the machine's time
    print("joblib", Parallel(n_jobs=2, backend="threading")(delayed(abs)(-number) for number in range(3)))
    concurrent.futures.ThreadPoolExecutor().submit(lambda: (time.sleep(1), print("left", since(begun))))
"""


def test_executors_loops_and_schedulers_follow_the_simulated_clock(folder: Folder) -> None:
    done = folder.fly(EXECUTORS, "--timing", "lockstep")
    assert done.stdout.splitlines()[:-1] == [
        "later 0.7", "to_thread 1.5 1.5", "flown 5000000000", "cancelled False 0.5",
        "sched 2.0", "ThreadPool [1, 0.5, 0.2] 3.0", "joblib [0, 1, 2]", "left 4.0",
    ], done.stderr  # fmt: skip


def test_copies_of_the_client_settings_and_loops_that_poll(folder: Folder) -> None:
    """Settings are found and named; another program's are passed over. The client's modules have the script's time."""
    text = """
        import airsim, json, msgpackrpc, time
        copy = msgpackrpc.Client(msgpackrpc.Address("127.0.0.1", 41451), timeout=9, pack_encoding="utf-8")
        print(copy.call("ping"), copy.call_async("enableApiControl", True, "").get())
        print(copy.call("simGetVehiclePose", "")["position"]["z_val"])
        try:
            copy.call("noSuchCall")
        except msgpackrpc.error.RPCError as error:
            print("refused")
        client = airsim.MultirotorClient()
        print(json.loads(client.getSettingsString())["ClockSpeed"])
        airsim.time.sleep(7)
        print(airsim.time is time, airsim.math.pi > 3)
        polls, begun = 0, client.getMultirotorState().timestamp
        while client.getMultirotorState().timestamp < begun + 1_500_000_000:
            polls += 1
        print("polls", polls)
    """
    documents = folder.home / "Documents" / "AirSim"
    documents.mkdir(parents=True)
    (folder.path / "settings.json").write_text(json.dumps({"editor.fontSize": 12}))  # of another program
    (documents / "settings.json").write_text(json.dumps({"SettingsVersion": 1.2, "ClockSpeed": 3, "Wind": {"W": 1}}))
    done = folder.fly(text)
    named, *said, polls, how = done.stdout.splitlines()
    assert named.startswith(f"settings: {documents / 'settings.json'} (--no-settings"), done.stderr
    assert "settings.json: without effect here: Wind.W\n" in done.stderr
    assert said == ["True None", "-10.0", "refused", "3.0", "True True"]
    assert 250 < int(polls.split()[1]) < 501, done.stderr
    assert "1 ms of thinking before each" in how


# --- processes -----------------------------------------------------------------------------------------------------

CHILDREN = """
    import airsim, concurrent.futures, multiprocessing, subprocess, sys

    def squares(number):
        return number * number

    def flies(number):
        return airsim.MultirotorClient().getMultirotorState().timestamp > 0

    if __name__ == "__main__":
        client = airsim.MultirotorClient()
        kind = multiprocessing.get_context(sys.argv[1])
        with kind.Pool(1) as pool:
            print(pool.map(squares, range(3)))
        child = subprocess.run([sys.executable, "child.py"], cwd=sys.argv[2], capture_output=True, text=True)
        print(child.returncode, child.stdout.strip() + child.stderr.strip(), flush=True)
        process = kind.Process(target=flies, args=(1,))
        process.start()
        process.join()
        print(process.exitcode, flush=True)
        with concurrent.futures.ProcessPoolExecutor(1, kind) as pool:
            print(pool.submit(flies, 1).result())
"""
CHILD = """
    import airsim.types
    client = airsim.MultirotorClient()
    print(client.ping())
"""
REFUSED = "it cannot share a simulated clock: fly the script with --timing wall"


@pytest.mark.slow
def test_processes_of_a_script_share_the_server(folder: Folder) -> None:
    folder.write(CHILD, "child.py")
    shared = folder.fly(CHILDREN, "--timing", "wall", "--", "fork", str(folder.path))
    assert shared.stdout.splitlines()[:-1] == ["[0, 1, 4]", "0 True", "0", "True"], shared.stderr


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["fork", "spawn"])
def test_processes_of_a_script_share_no_simulated_clock(folder: Folder, kind: str) -> None:
    folder.write(CHILD, "child.py")
    done = folder.fly(CHILDREN, "--", kind, str(folder.path))
    squares, child, process = done.stdout.splitlines()
    assert (squares, process, done.returncode) == ("[0, 1, 4]", "1", 1)
    assert child.startswith("1 uavaccel: error: a process that the script has started calls")
    assert child.endswith(REFUSED)
    lines = done.stderr.splitlines()
    assert sum(line.endswith(REFUSED) for line in lines) == 2  # of the process, and of the pool's
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("how", ["pool", "queue"])
def test_a_script_does_not_wait_for_a_process_that_was_refused(folder: Folder, how: str) -> None:
    """A pool starts its processes again and again; a queue's reader does not hear that nobody writes any more."""
    text = """
        import airsim, multiprocessing, sys
        from uavaccel.fly import environment
        environment.POLL_S = 0.1  # seldom enough for this machine

        def flies(*queues):
            airsim.MultirotorClient()

        kind = multiprocessing.get_context("fork")
        if sys.argv[1] == "pool":
            kind.Pool(1, flies).apply(abs, (1,))  # map counts its processes, of which there may be none
        else:
            queue = kind.Queue()
            kind.Process(target=flies, args=(queue,)).start()
            queue.get()
    """
    done = folder.fly(text, "--", how)
    assert done.returncode == 1
    said = [line for line in done.stderr.splitlines() if line.startswith("uavaccel: ")]  # a pool's processes go on
    assert [line.endswith(f"{REFUSED}; the script waits for it") for line in said][-1:] == [True], done.stderr


def test_programs_of_a_script_find_what_it_finds_and_others_nothing(folder: Folder) -> None:
    folder.write("import sys\nprint('uavaccel' in str(sys.modules.keys()), sys.flags.hash_randomization)\n", "other.py")
    folder.write(
        """
        import keyboard, airsim, numpy
        from gym.envs.registration import register
        import matplotlib
        matplotlib.use("TkAgg")
        print(numpy.fromstring(b"ab", numpy.uint8), numpy.float, keyboard.is_pressed("w"), repr(input()))
        """,
        "child.py",
    )
    text = """
        import pathlib, subprocess, sys
        for name in ("child.py", "other.py"):
            subprocess.run([sys.executable, pathlib.Path(__file__).with_name(name)], stdin=subprocess.DEVNULL)
    """
    done = folder.fly(text)
    assert done.stdout.splitlines()[:3] == ["", "[97 98] <class 'float'> False ''", "False 0"], done.stderr


# --- keys ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("options", "ends"), [(["--keys", "c,c,x"], "c c"), (["--until", "2"], "stopped by")])
def test_a_loop_that_polls_a_key_takes_time_and_ends(folder: Folder, options: list[str], ends: str) -> None:
    text = """
        import keyboard
        was, count = False, 0
        while not keyboard.is_pressed("x"):
            now = keyboard.is_pressed("c")
            count, was = count + (now and not was), now
        print(" ".join("c" * count))
    """
    done = folder.fly(text, *options)
    assert done.stdout.startswith(ends), done.stderr


# --- what scripts print --------------------------------------------------------------------------------------------


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux has it")
@pytest.mark.parametrize(
    ("to", "unbuffered", "status", "lines"),
    [(">/dev/full", "", 1, 1), (">/dev/full", "1", 1, 1), (">&-", "", 0, 0), ("| true", "1", 0, 0)],
)
def test_output_that_nobody_takes_is_one_line_and_none_for_nobody(
    folder: Folder, to: str, unbuffered: str, status: int, lines: int
) -> None:
    fly = f"{sys.executable} -m uavaccel fly {folder.write('print(1)')} {to}"
    environment = {**os.environ, "HOME": str(folder.home), "PYTHONUNBUFFERED": unbuffered}
    done = subprocess.run(fly, shell=True, cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, len(done.stderr.splitlines())) == (status, lines), done.stderr


# --- how a flight ends ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_check_tells_where_flights_differ(folder: Folder) -> None:
    text = """
        import airsim, os
        client = airsim.MultirotorClient()
        client.simSetObjectPose("none", airsim.Pose(airsim.Vector3r(os.getpid())))
    """
    done = folder.fly(text, "--check")
    assert done.returncode == 1
    assert "uavaccel: the flights differ at call 1" in done.stderr
    assert "checked" not in done.stdout


def test_what_is_called_at_exit_may_still_fly(folder: Folder) -> None:
    text = """
        import airsim, atexit
        client = airsim.MultirotorClient()
        client.enableApiControl(True)

        @atexit.register
        def last():
            print("last")

        atexit.register(lambda: 1 / 0)
        atexit.register(lambda duration: print(client.hoverAsync().get(), client.ping()), duration=1)
        atexit.unregister(atexit.register(print, "never"))
        print("first")
    """
    done = folder.fly(text)
    assert done.stdout.splitlines()[:3] == ["first", "False True", "last"]
    assert done.stderr.splitlines()[-1] == "ZeroDivisionError: division by zero"
    assert "uavaccel" not in done.stderr


# --- what scripts import -------------------------------------------------------------------------------------------


def test_tracebacks_of_failed_imports_are_the_scripts_own(folder: Folder) -> None:
    folder.write("import nothing_of_that_name\n", "broken.py")
    text = """
        import threading, traceback
        try:
            import nothing_at_all
        except ImportError:
            traceback.print_exc()
        def work():
            import broken
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
        import broken
    """
    done = folder.fly(text)
    assert done.returncode == 1
    assert done.stderr.count("No module named 'nothing_of_that_name'") == 2
    assert done.stderr.count("No module named 'nothing_at_all'") == 1
    assert "uavaccel" not in done.stderr


def test_keys_are_never_pressed_where_nothing_reads_them(folder: Folder) -> None:
    text = """
        import keyboard, pygame, msvcrt, time
        from pygame.locals import *
        from pynput import keyboard as keys

        begun = time.time()
        pygame.init()
        screen, clock = pygame.display.set_mode((640, 480)), pygame.time.Clock()
        for _ in range(30):
            for event in pygame.event.get():
                running = event.type != pygame.QUIT
            held = pygame.key.get_pressed()
            assert not (held[K_w] or held[pygame.K_UP] or keyboard.is_pressed("w") or msvcrt.kbhit())
            screen.fill((0, 0, 0))
            pygame.display.flip()
            clock.tick(30)
        print(round(time.time() - begun, 2), pygame.time.get_ticks())

        class Sprite(pygame.sprite.Sprite):
            pass

        def pressed(key):
            return key != keys.Key.esc

        with keys.Listener(on_press=pressed) as listener:
            listener.join()
        keyboard.wait("esc")
        print(pygame.K_UP != pygame.K_DOWN)
    """
    done = folder.fly(text)
    assert done.stdout.splitlines()[:2] == ["1.0 1000", "True"], done.stderr
    named = [line.split()[1] for line in done.stderr.splitlines()]
    assert sorted(named) == ["keyboard", "msvcrt", "pygame", "pynput"]
    assert done.stderr.count("no key is ever pressed") == 4


@pytest.mark.slow
def test_a_script_of_airsim_1_1_flies(folder: Folder) -> None:
    text = """
        from AirSimClient import *
        import airsim, threading, time
        client = MultirotorClient()
        client.confirmConnection()
        client.enableApiControl(True)
        client.armDisarm(True)
        assert client.getLandedState() == LandedState.Flying
        assert client.moveToPosition(3, 0, -9, 2) and client.getPosition().x_val > 2.4
        begun = client.timestampNow()
        client.moveByVelocity(1, 0, 0, 5)
        time.sleep(2)
        print(client.timestampNow() - begun < 2.1e9, 0.5 < client.getVelocity().x_val < 1.1)
        depth, scene = client.simGetImages([
            ImageRequest(0, AirSimImageType.DepthPlanner, True), ImageRequest(1, AirSimImageType.Scene)])
        print(AirSimClientBase.getPfmArray(depth).shape, airsim.ImageType.DepthPlanner, scene.width)
        taken = []  # in another thread than the pictures before it and after it
        threads = [threading.Thread(target=lambda: taken.append(client.simGetImage(0, 0))) for _ in range(2)]
        [thread.start() for thread in threads], [thread.join() for thread in threads]
        print([len(png) > 500 for png in taken])
        client.setCameraOrientation(0, AirSimClientBase.toQuaternion(0.2, 0, 0))
        pitch, roll, yaw = client.toEulerianAngle(client.getCameraInfo(0).pose.orientation)
        print(0.1 < pitch < 0.3, client.getCollisionInfo().has_collided)
        before = client.timestampNow()
        print(client.moveOnPath([Vector3r(9, 0, -9)], 2, 0), client.timestampNow() - before < 10_000_000)
    """
    done = folder.fly(text)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-6:-1] == [
        *("True True", "(144, 256) 1 256", "[True, True]", "True False", "True True")
    ]


# --- settings ------------------------------------------------------------------------------------------------------


def test_settings_that_were_found_and_do_not_fit_are_left_out(
    folder: Folder, capfd: pytest.CaptureFixture[str]
) -> None:
    script, beside = folder.write("import airsim\n"), folder.path / "settings.json"
    beside.write_text(json.dumps({"SettingsVersion": 1.2, "SimMode": "Car"}))
    assert found_settings(script) == beside
    named = FlightOptions(script, (), folder.path, settings=beside)
    assert settings_of(replace(named, settings_found=True)) is None
    warned = capfd.readouterr().err
    assert warned.startswith(f"uavaccel: warning: {beside}: ")
    assert warned.rstrip().endswith("flown without")
    with pytest.raises(UserError, match="SimMode"):
        settings_of(named)


HEAVY = "import sys\nprint(sorted({'cv2', 'mujoco', 'numba', 'scipy', 'torch'} & {*sys.modules}))\n"


@pytest.mark.parametrize(
    ("text", "status", "ending"),
    [
        (HEAVY, 0, "exit status 0"),
        ("raise TypeError('only 0-dimensional arrays can be converted\\ntwo')", 1, "TypeError: only 0-dim"),
        ("import airsim\nairsim.MultirotorClient()\nraise SystemExit(3)", 3, "exit status 3"),
    ],
)
def test_a_check_of_a_script_that_calls_nothing_says_how_it_ended(
    folder: Folder, text: str, status: int, ending: str
) -> None:
    """It has loaded nothing heavy. A NumPy that takes no array for a number is told of."""
    done = folder.fly(text, "--check")
    assert done.returncode == status
    *said, last = done.stdout.splitlines()
    assert last.startswith(f"not checked: the script ended with {ending}")
    assert last.endswith(" before any call")
    assert said == (["[]"] if text == HEAVY else [])
    assert done.stderr.endswith("pip install 'numpy<2.4'\n") == (status == 1)
