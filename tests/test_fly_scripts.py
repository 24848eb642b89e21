"""What a script of AirSim's time, or of ours, may use under `uavaccel fly`."""

from __future__ import annotations

import atexit
import json
import logging
from dataclasses import replace
from pathlib import Path

import pytest

from tests.scripts import Folder
from uavaccel.errors import UserError
from uavaccel.fly.options import SUMMARY, FlightOptions, found_settings
from uavaccel.fly.process import settings_of

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
    done = folder.fly_here(EXECUTORS)
    assert done.stdout.splitlines() == [
        "later 0.7", "to_thread 1.5 1.5", "flown 5000000000", "cancelled False 0.5",
        "sched 2.0", "ThreadPool [1, 0.5, 0.2] 3.0", "joblib [0, 1, 2]", "left 4.0",
    ], done.stderr  # fmt: skip


# --- processes -----------------------------------------------------------------------------------------------------

CHILDREN = """
    import airsim, concurrent.futures, multiprocessing, subprocess, sys
    from uavaccel.fly import environment
    environment.POLL_S = 60.0  # the machine may be busy

    def squares(number):
        return number * number

    def flies(number):
        return airsim.MultirotorClient().getMultirotorState().timestamp > 0

    if __name__ == "__main__":
        client = airsim.MultirotorClient()
        child = subprocess.run([sys.executable, "child.py"], cwd=sys.argv[1], capture_output=True, text=True)
        print(child.returncode, child.stdout.strip() + child.stderr.strip(), flush=True)
        for name in sys.argv[2:]:
            kind = multiprocessing.get_context(name)
            with kind.Pool(1) as pool:
                print(pool.map(squares, range(3)))
            process = kind.Process(target=flies, args=(1,))
            process.start()
            process.join()
            print(process.exitcode, flush=True)
            try:
                with concurrent.futures.ProcessPoolExecutor(1, kind) as pool:
                    print(pool.submit(flies, 1).result())
            except Exception as error:
                print(error)
"""
CHILD = """
    import airsim.types
    client = airsim.MultirotorClient()
    print(client.ping())
"""
LAST = """
    class Last:
        def __init__(self):
            self.client, self.itself = airsim.MultirotorClient(), self
        def __del__(self):
            print(self.client.ping())
    last = Last()
"""
REFUSED = "it cannot share a simulated clock: fly the script with --timing wall"


@pytest.mark.slow
def test_processes_of_a_script_and_its_destructors_share_the_server(folder: Folder) -> None:
    folder.write(CHILD, "child.py")
    shared = folder.fly(CHILDREN + LAST, "--timing", "wall", "--", str(folder.path), "fork")
    assert shared.stdout.splitlines()[:-1] == ["0 True", "[0, 1, 4]", "0", "True", "True"], shared.stderr


@pytest.mark.slow
def test_processes_of_a_script_share_no_simulated_clock(folder: Folder) -> None:
    folder.write(CHILD, "child.py")
    done = folder.fly(CHILDREN, "--", str(folder.path), "fork", "spawn")
    child, *told = done.stdout.splitlines()[:-1]
    refused = f"a process that the script has started calls the simulation; {REFUSED}"
    assert child == f"1 uavaccel: error: {refused}"
    assert told == ["[0, 1, 4]", "1", refused] * 2
    assert done.returncode == 0
    assert sum(line.endswith(REFUSED) for line in done.stderr.splitlines()) == 2, "a line of each process"
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


# --- what scripts print --------------------------------------------------------------------------------------------


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux has it")
@pytest.mark.parametrize(
    ("to", "unbuffered", "status", "lines"), [("/dev/full", "", 1, 1), ("/dev/full", "1", 1, 1), ("nobody", "1", 0, 0)]
)
def test_output_that_nobody_takes_is_one_line_and_none_for_nobody(
    folder: Folder, to: str, unbuffered: str, status: int, lines: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    done = folder.fly("print(1)", to=to)
    assert (done.returncode, len(done.stderr.splitlines())) == (status, lines), done.stderr


# --- how a flight ends ---------------------------------------------------------------------------------------------


def test_what_is_called_at_exit_and_then_destroyed_may_still_fly(
    folder: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What others have registered is called when this process ends, unless the script unregisters it."""
    gone: list[object] = []
    monkeypatch.setattr(atexit, "unregister", gone.append)
    folder.write("class Kept:\n    def __del__(self):\n        print(client.ping())\nkept = Kept()\n", "keeps.py")
    text = """
        import airsim, atexit, keeps, logging, time

        class Env:
            def __init__(self):
                self.client, self.itself = airsim.MultirotorClient(), self
            def __del__(self):
                time.sleep(1)
                print(env is self, self.client.hoverAsync().get(), self.client.reset())

        env = Env()
        client = keeps.client = airsim.MultirotorClient()
        client.enableApiControl(True)

        @atexit.register
        def last():
            print("last")

        atexit.register(lambda: 1 / 0)
        atexit.register(exit, 3)
        atexit.register(lambda duration: print(client.hoverAsync().get(), client.ping()), duration=1)
        atexit.unregister(atexit.register(print, "never"))
        atexit.unregister(logging.shutdown)
        print("first")
    """
    done = folder.fly_here(text)
    *before, first, second = done.stdout.splitlines()
    assert before == ["first", "False True", "last"]
    assert done.returncode == 0
    assert {first, second} == {"True", "True False None"}
    assert logging.shutdown in gone
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
    done = folder.fly_here(text)
    assert done.returncode == 1
    assert done.stderr.count("No module named 'nothing_of_that_name'") == 2
    assert done.stderr.count("No module named 'nothing_at_all'") == 1
    assert "uavaccel" not in done.stderr


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
    done = folder.fly_here(text)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-5:] == [
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


def test_a_script_that_calls_nothing_loads_nothing_heavy_and_is_not_checked(folder: Folder) -> None:
    heavy = "import sys\nprint({'cv2', 'mujoco', 'numba', 'scipy', 'torch'} & {*sys.modules})\n"
    done = folder.fly(heavy, "--check")
    assert done.returncode == 0
    assert done.stdout.splitlines() == [
        "set()", "not checked: the script ended with exit status 0 before any call",
    ]  # fmt: skip


def test_what_ends_a_script_is_told_by_its_own_lines(folder: Folder) -> None:
    """And kept, in a line; a NumPy that takes no array for a number is told of."""
    text = """
        def fall():
            raise TypeError("only 0-dimensional arrays can be converted\\ntwo")
        fall()
    """
    done = folder.fly_here(text)
    begun = f'Traceback (most recent call last):\n  File "{folder.path}/script.py", line 4, in <module>\n'
    assert done.stderr.startswith(begun)
    *_, error, second, advice = done.stderr.splitlines()
    assert (done.returncode, error, second) == (1, "TypeError: only 0-dimensional arrays can be converted", "two")
    assert advice.endswith("pip install 'numpy<2.4'")
    assert done.stderr.count("uavaccel") == 1
    kept = json.loads((folder.path / "out" / SUMMARY).read_text())
    assert kept["error"] == error
