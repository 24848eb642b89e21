"""Processes that end with the one that started them, and those that stand still, told from those that work."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from tests.processes import descendants, left_after, state_of
from uavaccel.processes import lifetime, workers
from uavaccel.processes.forks import Forks
from uavaccel.processes.stalls import IDLE_POLLS, STOPPED_POLLS, StallDetector, cpu_time_s

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere nothing happens")

CHILD = """
import signal, sys
from uavaccel.processes.lifetime import work_for_parent
work_for_parent(int(sys.argv[1]))
work_for_parent(int(sys.argv[1]))
print("bound", flush=True)
signal.pause()
"""
PARENT = """
import os, signal, subprocess, sys
child = subprocess.Popen([sys.executable, "-c", sys.argv[1], str(os.getpid())], stdout=subprocess.PIPE)
print(child.pid, child.stdout.readline().decode(), flush=True)
signal.pause()
"""


def test_an_interrupt_that_a_destructor_loses_comes_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """What else is lost is the hook's that was there, and is afterwards."""

    class Ends:
        def __init__(self, end: Callable[[], object]) -> None:
            self.end = end

        def __del__(self) -> None:
            self.end()

    def lost(what: Any) -> None:
        told.append(what.exc_type)

    told = list[type]()
    monkeypatch.setattr(sys, "unraisablehook", lost)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with lifetime.lost_interrupts_repeated():
        Ends(lambda: 1 // 0)
        Ends(lambda: signal.raise_signal(signal.SIGTERM))
        with pytest.raises(KeyboardInterrupt):
            threading.Event().wait(60.0)
    assert (told, sys.unraisablehook) == ([ZeroDivisionError], lost)


def test_a_process_whose_parent_is_killed_ends() -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT, CHILD], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline().split()[0])
        os.kill(child, signal.SIGINT)
        assert left_after([child], 0.0) == {child}
        parent.kill()
    assert not left_after([child], 60.0)


def test_one_whose_parent_was_killed_before_ends_at_once() -> None:
    """It has another parent by then, which may live for ever."""
    with subprocess.Popen([sys.executable, "-c", ""]) as gone:
        pass
    for started_by in (gone.pid, os.getppid()):
        command = [sys.executable, "-c", CHILD, str(started_by)]
        done = subprocess.run(command, stdout=subprocess.PIPE, check=False, timeout=60)
        assert (done.returncode, done.stdout) == (-signal.SIGKILL, b"")


def test_a_worker_does_not_hear_ctrl_c_before_it_is_bound_to_its_parent(monkeypatch: pytest.MonkeyPatch) -> None:
    begin = workers.begin_worker

    def interrupted(parent: int, *state: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        begin(parent, *state)

    monkeypatch.setattr(workers, "begin_worker", interrupted)
    blocked: workers.Delayed = (signal.pthread_sigmask, (signal.SIG_BLOCK, ()), {})
    assert list(workers.on_this_machine(2, 1, [blocked])) == [set()]  # nor is it deaf to its own any more
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == set()


def test_a_worker_finds_what_its_parent_finds_in_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "of_this_folder.py").write_text("def read():\n    return open('beside').read()\n")
    (tmp_path / "beside").write_text("found")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", *sys.path])  # as in a notebook
    read = importlib.import_module("of_this_folder").read
    assert list(workers.on_this_machine(2, 1, [(read, (), {})])) == ["found"]


@pytest.mark.parametrize(
    ("program", "seconds", "status"),
    [("", 60.0, 0), ("import signal; signal.pause()", 0.01, -9), ("import os; os.kill(os.getpid(), 19)", 60.0, -9)],
)
def test_who_does_not_end_in_time_is_killed_and_one_that_is_stopped_at_once(
    program: str, seconds: float, status: int
) -> None:
    with lifetime.start_python("-c", program) as process:
        while status and seconds == 60.0 and state_of(process.pid) != "T":
            pass
        lifetime.end_within(process, seconds)
        assert process.returncode == status


def test_what_ended_processes_have_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as gone:
        pass
    for pid in (gone.pid, os.getpid(), 1):
        (tmp_path / f"joblib_memmapping_folder_{pid}_a" / "inner").mkdir(parents=True)
        (tmp_path / f"sem.loky-{pid}-b").touch()
        (tmp_path / f"sem.own-{pid}-c").touch()
    kept = {path.name for path in tmp_path.iterdir()} - {
        f"joblib_memmapping_folder_{gone.pid}_a",
        f"sem.loky-{gone.pid}-b",
    }
    lifetime.remove_orphaned_files(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == kept
    lifetime.remove_orphaned_files(tmp_path / "none")


GUARDED = """
import signal, subprocess, sys, threading
from uavaccel.processes import stalls
stalls.POLL_S = 1 / 64
if sys.argv[1] == "waits":
    stalls.GUARD_POLLS = 1 << 30
stopped = subprocess.Popen([sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGSTOP)"])
said = threading.Event()
if sys.argv[1] == "goes on":
    looks = [*("T" * (stalls.GUARD_POLLS - 1) + "S") * 2]
    stalls.is_stopped = lambda pid: looks.pop(0) == "T" if looks else bool(said.set())
stalls.guard_children(lambda line: (print(line, flush=True), said.set()))
stalls.guard_children(lambda line: print("twice", flush=True))
print(stopped.pid, flush=True)
if sys.argv[1] == "goes on":
    said.wait()
    stopped.kill()
elif sys.argv[1] != "ends":
    try:
        stopped.wait()
    finally:  # as who waits for its processes does
        stopped.wait(60.0)
    said.wait()
else:
    while not stalls.is_stopped(stopped.pid):
        pass
"""


@pytest.mark.wall_clock
@pytest.mark.parametrize("how", ["looks", "waits", "ends", "goes on"])
def test_a_stopped_child_is_ended_after_some_looks(how: str) -> None:
    """Only the first is worth a line: otherwise the command ends as well."""
    command = [sys.executable, "-c", GUARDED, how]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as program:
        assert program.stdout is not None
        child = int(program.stdout.readline())
        if how == "waits":
            while state_of(child) != "T":
                pass
            program.send_signal(signal.SIGINT)
        said = program.stdout.read()
    assert not left_after([child], 60.0)
    assert program.returncode == (-signal.SIGINT if how == "waits" else 0)
    if how == "looks":
        assert said.startswith(f"process {child} (")
        assert said.endswith(") was stopped, and was ended since it did not go on\n")
    assert said.count("\n") == (how == "looks")


TEMPLATE = """
import os, signal, sys, time
from uavaccel.processes.forks import fork_each
ends = [lambda: print("over"), lambda: os._exit(3), lambda: os.kill(os.getpid(), 9), lambda: 1 / 0, *[signal.pause] * 2]
fork_each([[]] * len(ends), int(sys.argv[1]), lambda number: ends[number]())
"""


def forked() -> Forks:
    reports, told = os.pipe()
    template = lifetime.start_python("-c", TEMPLATE, str(told), pass_fds=(told,), environment={"PYTHONUNBUFFERED": ""})
    os.close(told)
    (forks := Forks(template, 6, reports)).read_reports(60.0)
    return forks


def test_a_template_is_missed_though_forks_of_it_live_on() -> None:
    """Whose ends nobody reports any more, so that each has ended as it did."""
    forks = forked()
    *_, waits, stays = forks.each()
    forks.template.kill()
    try:
        while forks.read_reports(30.0):
            pass
        assert forks.template.returncode == -signal.SIGKILL
        assert [waits.poll(), stays.poll()] == [None, None]
    finally:
        for fork in (waits, stays):
            os.kill(fork.pid, signal.SIGKILL)
    assert [waits.wait(), stays.wait()] == [-signal.SIGKILL] * 2


def test_forks_are_waited_for_and_ended_as_processes_are(capfd: pytest.CaptureFixture[str]) -> None:
    template = (forks := forked()).template
    *ended, waits, stays = forks.each()
    assert [fork.wait(60.0) for fork in ended] == [fork.poll() for fork in ended] == [0, 3, -9, 1]
    said = capfd.readouterr()
    assert (said.out, "ZeroDivisionError" in said.err) == ("over\n", True)
    assert len({template.pid, *(fork.pid for fork in forks.each())}) == 7
    with pytest.raises(subprocess.TimeoutExpired):
        waits.wait(0.01)
    waits.terminate()
    assert waits.wait() == -signal.SIGTERM
    os.kill(stays.pid, signal.SIGSTOP)
    stays.kill()
    assert (stays.wait(), stays.poll()) == (-signal.SIGKILL, -signal.SIGKILL)
    forks.close()
    assert template.returncode == 0
    waits.kill()  # who has ended, and whose id may be another's


# --- stalls -----------------------------------------------------------------------------------------------------------


WORKS, WAITS = "while True: pass", "import signal; print(flush=True); signal.pause()"
STARTER = f"""import subprocess, sys, threading
def start(): subprocess.Popen([sys.executable, '-c', {WORKS!r}]), print(flush=True), input()
threading.Thread(target=start).start()"""

Start = Callable[[str], int]


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts programs, and ends them."""
    with ExitStack() as stack:

        def started(program: str) -> int:
            process = subprocess.Popen(
                [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
            )
            stack.callback(process.communicate)
            stack.callback(os.killpg, process.pid, signal.SIGKILL)
            if program != WORKS:  # it is there, and does nothing any more
                assert process.stdout is not None
                process.stdout.readline()
                while state_of(process.pid) != "S":
                    pass
            return process.pid

        yield started


def work_a_little(pid: int) -> None:
    """Until the system has counted more of it."""
    before = cpu_time_s(pid)
    while cpu_time_s(pid) == before:
        pass


def test_one_that_waits_for_ever_stands_still_after_some_looks(start: Start) -> None:
    pid, stalls = start(WAITS), StallDetector()
    found = [stalls.poll([pid]) for _ in range(IDLE_POLLS + 1)]  # before the first, it may have worked
    assert found == [[]] * IDLE_POLLS + [[pid]]


def test_one_that_works_does_not_until_it_is_stopped(start: Start) -> None:
    pid, stalls = start(WORKS), StallDetector()
    for _ in range(2 * IDLE_POLLS):
        work_a_little(pid)
        assert stalls.poll([pid]) == []
    os.kill(pid, signal.SIGSTOP)
    while state_of(pid) != "T":
        pass
    found = [stalls.poll([pid]) for _ in range(STOPPED_POLLS)]
    assert found == [[]] * (STOPPED_POLLS - 1) + [[pid]]
    impatient = StallDetector()
    assert [impatient.poll([pid], 2) for _ in range(2)] == [[], [pid]], "who has less patience has it here too"


def test_the_work_of_a_child_counts(start: Start) -> None:
    parent, stalls = start(STARTER), StallDetector()
    (child,) = descendants(parent)
    for _ in range(2 * IDLE_POLLS):
        work_a_little(child)
        assert stalls.poll([parent]) == []


def test_who_is_not_waited_for_any_more_begins_anew(start: Start) -> None:
    pid, stalls = start(WAITS), StallDetector()
    for _ in range(IDLE_POLLS):
        assert stalls.poll([pid]) == []
    assert stalls.poll([]) == []
    assert stalls.poll([pid]) == []


class Found:
    """A process that successive looks find so: "T" stopped, "S" not, or ended with a status."""

    def __init__(self, *found: str | int) -> None:
        self.pid, self.killed = 7, False
        self._found = list(found)

    def poll(self) -> int | None:
        return self._found[0] if isinstance(self._found[0], int) else None

    def is_stopped(self, pid: int) -> bool:
        assert pid == self.pid
        return self._found.pop(0) == "T"

    def kill(self) -> None:
        self.killed = True


@pytest.mark.parametrize(
    ("found", "over"),
    [("T" * 16, 0), ("T" * 17, 1), ("T" * 16 + "S" + "T" * 16, 0), ("T" * 3 + "S" + "T" * 17, 1), ("TS" * 20, 0)],
)
def test_patience_is_over_after_four_seconds_without_a_break(
    found: str, over: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Looks are a quarter of a second apart; whoever is stopped now and then is waited for."""
    process: Any = Found(*found)
    monkeypatch.setattr(lifetime, "is_stopped", process.is_stopped)
    patience = lifetime.Patience(process)
    answers = [patience.is_over() for _ in found]
    assert answers == [False] * (len(found) - over) + [True] * over


@pytest.mark.parametrize(
    ("found", "lost"),
    [
        (["S", "S", 3], "the server ended with status 3"),
        (["S", 0], "the server ended with status 0"),
        (["T", "S", -9], "the server was ended by SIGKILL"),
        (["S", -99], "the server was ended by signal 99"),
        (["S", *"T" * 17], "the server was stopped"),
    ],
)
def test_a_watch_kills_what_stays_stopped_and_tells_once(
    found: list[str | int], lost: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    process: Any = Found(*found)
    told: list[str] = []
    monkeypatch.setattr(lifetime, "is_stopped", process.is_stopped)
    monkeypatch.setattr(lifetime, "POLL_S", 1 / 1024)
    monkeypatch.setattr(lifetime, "STOPPED_S", 16 / 1024)
    watch = lifetime.Watch(process, "the server", lambda: told.append("gone"))
    watch._thread.join()
    assert (watch.lost, told, process.killed) == (lost, ["gone"], True)
    assert watch.is_lost_soon()


def test_mesa_draws_on_one_core_unless_the_user_says_how_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LP_NUM_THREADS", raising=False)
    assert lifetime.single_core_rendering() == {"LP_NUM_THREADS": "0"}
    monkeypatch.setenv("LP_NUM_THREADS", "3")
    assert lifetime.single_core_rendering() == {"LP_NUM_THREADS": "3"}
