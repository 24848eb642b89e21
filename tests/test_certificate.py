"""Measured and certified: what a policy is worth against latency, the same bytes every time, whatever interrupts it."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cloudpickle
import gymnasium
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tests.conftest import forget_own_code
from tests.golden import assert_as_recorded, figures_text, plain
from tests.opengl import needs_opengl
from tests.test_policy_server import process
from uavaccel.cli.main import app
from uavaccel.clock import VirtualClock
from uavaccel.errors import Interrupted, UserError
from uavaccel.files import file_sha256
from uavaccel.metrics.intervals import Proportion
from uavaccel.realtime import Certificate, Measurement, RealTime, certify, measure
from uavaccel.realtime.thinking import thinking_time
from uavaccel.resources import asset
from uavaccel.units import NS_PER_S
from uavaccel.wire.latency import read_latency

pytestmark = pytest.mark.usefixtures("here", "whole_messages")
PERIOD_S = 0.01
cloudpickle.register_pickle_by_value(sys.modules[__name__])  # or worker processes would load all that these tests do


class Count(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """It counts periods, from a number that the seed draws; an action is right within 3 of the count when applied.

    Under the last action that was right when it was chosen, and a delay of n periods, actions are 0 to 2n off.
    """

    observation_space = spaces.Box(-np.inf, np.inf, (1,), np.float32)
    action_space = spaces.Box(-np.inf, np.inf, (1,), np.float32)
    dt = PERIOD_S

    def __init__(self, worth: float = 1.0, tells: Any = True) -> None:
        self._worth, self._tells = worth, tells

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[NDArray[np.float32], dict[str, Any]]:
        super().reset(seed=seed)
        self._count = self._first = int(self.np_random.integers(3))
        self._right = True
        return np.full(1, self._count, np.float32), {}

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        right = abs(float(action[0]) - self._count) <= 3
        self._right &= right
        self._count += 1
        over = self._count - self._first >= 30
        info = {"is_success": self._right & self._tells} if np.any(self._tells) else {}
        return np.full(1, self._count, np.float32), self._worth * right, over, False, info


def same(seen: NDArray[np.float32]) -> NDArray[np.float32]:
    return seen


DELAYS = [n * PERIOD_S for n in range(5)]


def contents(folder: str) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


# --- what it says -----------------------------------------------------------------------------------------------------


def test_a_certificate_is_exact_where_the_delay_is() -> None:
    """With a delay of one period all actions are right, with two every third is not, with four most."""
    written: list[int] = []
    told = lambda row: written.append(len(Path("out/rows.jsonl").read_text().splitlines()))  # noqa: E731
    certificate = certify(Count, same, DELAYS, episodes=6, seed=4, out="out", told=told)
    assert written == [*range(1, 31)], "a row is in its file before the next episode begins"
    cells, holds = certificate.document["cells"], certificate.document["holds"]
    assert [cell["latency_s"] for cell in cells] == DELAYS
    assert [cell["mean"] for cell in cells] == [1, 1, 0, 0, 0]
    assert [(cell["low"], cell["high"]) for cell in cells[:2]] == [Proportion(6, 6).interval] * 2
    assert (holds["latency_s"], holds["least"], holds["surely_s"]) == (PERIOD_S, 0.9, None)
    rows = [json.loads(line) for line in Path("out/rows.jsonl").read_text().splitlines()]
    assert rows == certificate.rows
    assert [(row["latency"], row["seed"]) for row in rows[4:8]] == [(0, 8), (0, 9), (PERIOD_S, 4), (PERIOD_S, 5)]
    assert {row["return"] for row in rows[:12]} == {30}
    policy = file_sha256(Path(__file__))
    hashes = f"policy {policy[:12]}, rows {file_sha256(Path('out/rows.jsonl'))[:12]}"
    assert certificate.line == (
        "same in Count: holds 90% of its success without latency, 100.0%, up to 10 ms "
        f"(6 episodes a latency from seed 4; {hashes})"
    )
    said = json.loads(Path("out/certificate.json").read_text())
    assert said == json.loads(json.dumps(certificate.document))
    assert said["policy"] == {"name": "same", "sha256": policy}
    assert said["environment"] == {"id": "Count", "kwargs": {}, "sha256": policy}
    assert {"gymnasium", "numpy", "python", "uavaccel"} <= said["versions"].keys()


def test_without_successes_the_score_is_the_return_also_below_zero() -> None:
    right = certify(partial(Count, tells=False), same, DELAYS, episodes=2)
    assert (right.document["score"], right.document["holds"]["latency_s"]) == ("return", PERIOD_S)
    assert [row["success"] for row in right.rows] == [None] * 10
    with pytest.raises(UserError, match=r"^success = 'won': the last info of an episode has no such key; it has is_"):
        certify(Count, same, success="won", out="out")
    with pytest.raises(UserError, match=r"must be true or false in the last info of an episode, not \[ True False\]$"):
        certify(partial(Count, tells=np.array([True, False])), same)
    assert certify(Count, same, [0.0], episodes=2, out="out", resume=True).rows, "nothing had been flown"
    wrong = certify(
        partial(Count, -1.0, False), lambda seen: seen - [0, 9][int(seen[0]) % 15 == 0], [0, 0.01], episodes=5
    )
    (zero, one), holds = wrong.document["cells"], wrong.document["holds"]
    assert zero["mean"] == pytest.approx(-28)
    assert holds["least"] == pytest.approx(1.1 * zero["mean"])
    assert (holds["latency_s"] > 0) == (one["mean"] >= holds["least"])


def test_of_one_episode_a_latency_no_return_is_sure() -> None:
    alone = certify(partial(Count, tells=False), same, DELAYS, episodes=1, out="out")
    assert {(cell["low"], cell["high"]) for cell in alone.document["cells"]} == {(None, None)}
    assert (alone.document["holds"]["latency_s"], alone.document["holds"]["surely_s"]) == (PERIOD_S, None)
    assert [line[3] for line in alone.table()[1]] == ["-"] * 5
    assert alone.figure("alone.png").is_file()


def test_a_calibration_file_is_replayed_and_stretched() -> None:
    times_us = [20_000.0] * 6 + [20_100.0] * 6
    Path("times.json").write_text(json.dumps({"latency": {"request_us": {"call": times_us}}}))
    certificate = certify(Count, same, calibration="times.json", episodes=2)
    cells = certificate.document["cells"]
    assert [cell["latency"] for cell in cells] == [0, 0.5, 1, 2, 4]
    assert [cell["latency_s"] for cell in cells] == pytest.approx([0, 0.01, 0.02, 0.04, 0.08], rel=0.01)
    assert certificate.document["calibration"] == {"file": "times.json", "sha256": file_sha256(Path("times.json"))}
    assert f"times {file_sha256(Path('times.json'))[:12]}" in certificate.line
    assert "0 times times.json" in certificate.line  # half of it is more than a period
    assert {row["thinking_s"] for row in certificate.rows[:2]} == {0.0}


def test_delays_in_control_periods_are_those_in_seconds() -> None:
    """Whatever the ClockSpeed, at which so many seconds of thinking are another number of periods."""
    for other in ({"latencies": [0.01]}, {"calibration": "times.json"}):
        with pytest.raises(UserError, match=r"^delay_steps: is given beside seconds; leave out latencies and calibr"):
            certify(Count, same, delay_steps=[1], **other)
    steps = certify(Count, same, delay_steps=[1, 2, 3, 4], episodes=3, clock_speed=8)
    seconds = certify(Count, same, [at / 8 for at in DELAYS], episodes=3, clock_speed=8)
    without = [[{**row, "latency": None} for row in each.rows] for each in (steps, seconds)]
    assert without[0] == without[1]
    assert "up to 1.25 ms, 1 step (3 episodes" in steps.line
    assert steps.table()[0][0] == "steps"


def test_what_people_read_of_one_is_as_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    """By default, and of an environment that tells no success."""
    drawn: dict[str, Figure] = {}
    save, lines = Figure.savefig, list[str]()

    def saved(figure: Figure, *to: Any, **how: Any) -> None:
        drawn[f"figure {len(drawn)}"] = figure
        save(figure, *to, **how)

    monkeypatch.setattr(Figure, "savefig", saved)
    for certificate in (certify(Count, same), certify(partial(Count, tells=False), same, DELAYS)):
        assert certificate.figure("figure.png").read_bytes().startswith(b"\x89PNG")
        document, (header, table) = certificate.document, certificate.table()
        lines += [
            certificate.line.partition("; policy")[0],
            *map(plain, [header, *table, *document["cells"], document["holds"]]),
        ]
    assert_as_recorded("certificate", "\n".join([*lines, *figures_text(drawn)]) + "\n")


# --- the same bytes ---------------------------------------------------------------------------------------------------


class Drawing:
    """A policy that draws: it begins anew with the seed of an episode."""

    name, sha256 = "drawing", None

    def __init__(self, before: Callable[[int], None] = lambda call: None) -> None:
        self._before, self._calls = before, 0

    def reset(self, seed: int) -> None:
        self._generator = np.random.default_rng(seed)

    def __call__(self, seen: NDArray[np.float32]) -> NDArray[np.float64]:
        self._before(self._calls)
        self._calls += 1
        return seen + self._generator.normal(0, 2, 1)


TIMES: dict[str, Any] = {"calibration": "times.json", "latencies": [0, 1, 2], "episodes": 5}


@pytest.fixture
def times(here: Path) -> None:
    spread_us = [float(us) for us in range(0, 60_000, 5_000)]
    (here / "times.json").write_text(json.dumps({"latency": {"request_us": {"call": spread_us}}}))


class Cut(Count):
    """By its seed cut short, and of other rewards; it says `won` in other episodes than `is_success`."""

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        seen, reward, over, _, info = super().step(action)
        cut = self._first == 1 and self._count == 19
        return seen, reward + self._first / 8, over, cut, {**info, "won": self._first != 1}


@pytest.mark.parametrize("success", [None, "won"])
@pytest.mark.usefixtures("times")
def test_a_row_is_what_a_flight_of_ones_own_tells(success: str | None) -> None:
    """With the times of the file, which a `scale` stretches as a factor does, at another ClockSpeed."""
    document = json.loads(Path("times.json").read_text())
    keys: dict[str, Any] = {"clock_speed": 2.0, "meanwhile": "default"}
    swept: dict[str, Any] = {"latencies": [2, 0.5], "calibration": "times.json", "episodes": 3, "seed": 5}
    for row in certify(Cut, Drawing(), **swept, success=success, **keys).rows:
        document["latency"]["scale"] = row["latency"]
        Path("own.json").write_text(json.dumps(document))
        env, policy = RealTime(Cut(), latency_s="own.json", **keys), Drawing()
        (seen, _), infos, total, ends = env.reset(seed=row["seed"]), list[Any](), 0.0, [False, False]
        policy.reset(row["seed"])
        while not any(ends):
            seen, reward, *ends, info = env.step(policy(seen))
            infos, total = [*infos, info], total + reward
        thought_s = np.median([info["thinking_s"] for info in infos])
        assert row == {
            "latency": row["latency"], "seed": row["seed"], "return": total, "steps": len(infos),
            "success": infos[-1][success or "is_success"], "terminated": ends[0],
            "thinking_s": pytest.approx(thought_s, abs=2e-9), "simulated_s": infos[-1]["simulated_s"],
        }  # fmt: skip


@pytest.mark.usefixtures("times")
@pytest.mark.parametrize("call", [0, 149])
def test_an_evaluation_that_was_interrupted_ends_with_the_same_bytes(call: int) -> None:
    def interrupt(now: int) -> None:
        if now == call:
            raise KeyboardInterrupt

    certify(Count, Drawing(), out="whole", **TIMES)
    certify(Count, Drawing(), out="again", **TIMES)
    assert contents("again") == contents("whole")
    for resume, before in ((False, interrupt), (True, lambda now: interrupt(call))):
        with pytest.raises(Interrupted, match=r"^interrupted after \d+ of 15 episodes; go on .*, in part, by --resume"):
            certify(Count, Drawing(before), out="part", resume=resume, **TIMES)
    with open("part/rows.jsonl", "a") as file:
        file.write('{"latency": 0')  # as a crash leaves it
    certify(Count, Drawing(), out="part", resume=True, **TIMES)
    assert contents("part") == contents("whole")
    certify(Count, Drawing(), out="part", resume=True, **TIMES)
    assert contents("part") == contents("whole")


@pytest.mark.slow
@pytest.mark.usefixtures("times")
def test_processes_change_no_byte_interrupted_or_killed_too() -> None:
    certify(Count, Drawing(), out="whole", **TIMES)
    rows: list[object] = []

    def interrupt(row: object) -> None:
        rows.append(row)
        if len(rows) == 7:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted, match=r"^interrupted after 7 of 15 episodes; go on with it, in part, by --resume"):
        certify(Count, Drawing(), out="part", jobs=2, told=interrupt, **TIMES)
    certify(Count, Drawing(), out="part", resume=True, jobs=2, **TIMES)
    assert contents("part") == contents("whole")
    parent = os.getpid()

    def end_worker(call: int) -> None:
        if os.getpid() != parent:
            os.kill(os.getpid(), signal.SIGKILL)

    with pytest.raises(
        UserError, match=r"^a worker process was killed, by its user or for memory; go on with --resume"
    ):
        certify(Count, Drawing(end_worker), out="lost", jobs=2, **TIMES)
    certify(Count, Drawing(), out="lost", resume=True, **TIMES)
    assert contents("lost") == contents("whole")


def test_an_evaluation_ends_after_three_episodes_that_fail_from_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """So does one of an environment that never ends, unless its own time limit is longer."""
    with pytest.raises(UserError, match=r"^the return of the episode is nan: 3 episodes in a row have failed; go on"):
        certify(partial(Count, math.nan), same, [0.01], episodes=9, out="out")
    assert len(Path("out/rows.jsonl").read_text().splitlines()) == 3
    for longest, limit, ends in ((29, None, False), (30, None, True), (29, 30, True)):
        monkeypatch.setattr("uavaccel.realtime.evaluation.LONGEST", longest)
        monkeypatch.setattr(Count, "spec", EnvSpec("Count-v0", max_episode_steps=limit))
        if ends:
            assert certify(Count, same, [0.0], episodes=1).document["holds"]
        else:
            with pytest.raises(UserError, match=r"^the episode has not ended after 29 steps: give the .* 3 episodes"):
                certify(Count, same, [0.01], episodes=9)


def test_another_evaluation_does_not_go_on_in_its_folder() -> None:
    certify(Count, same, [0.01], episodes=2, out="out")
    with pytest.raises(UserError, match=r"^out: exists; take another --out, or --resume"):
        certify(Count, same, [0.01], episodes=2, out="out")
    with pytest.raises(UserError, match=r"^out: is another evaluation: other episodes, latencies; take another"):
        certify(Count, same, [0.02], episodes=3, out="out", resume=True)
    with pytest.raises(UserError, match=r"^out: is another evaluation: other policy, real_time; take another"):
        certify(Count, Drawing(), [0.01], episodes=2, out="out", resume=True, clock_speed=2)
    Path("other").mkdir()
    Path("other/mine.txt").touch()
    with pytest.raises(UserError, match=r"^other: no evaluation of a policy, but not empty; take another folder$"):
        certify(Count, same, out="other", resume=True)
    rows = Path("out/rows.jsonl").read_text().splitlines()
    named = ([row.replace(f'"{name}"', '"other"') for row in rows] for name in ("return", "thinking_s", "success"))
    for changed in (rows[::-1], *named):
        Path("out/rows.jsonl").write_text("\n".join(changed) + "\n")
        with pytest.raises(UserError, match=r"^out/rows.jsonl: its rows are not those of this evaluation"):
            certify(Count, same, [0.01], episodes=2, out="out", resume=True)


# --- a policy that fails ----------------------------------------------------------------------------------------------

SERVER = """
import os, signal
from uavaccel.realtime import serve

calls = 0

def policy(seen):
    global calls
    calls += 1
    if calls == CALL:
        os.kill(os.getpid(), signal.SIGKILL)
    return seen

serve(policy, PORT)
"""


def test_an_episode_whose_server_was_killed_is_played_again() -> None:
    program = SERVER.replace("CALL", "70")
    with process(program.replace("PORT", "0")) as (_, address):
        port = address.rpartition(":")[2]
        evaluation: dict[str, Any] = {"latencies": [0.01], "episodes": 4, "out": "out"}
        with pytest.raises(
            UserError, match=rf"^{address}: no policy .* refused: 3 episodes in a row have failed; go on"
        ):
            certify(Count, address, **evaluation)
    rows = [json.loads(line) for line in Path("out/rows.jsonl").read_text().splitlines()]
    assert [row["seed"] for row in rows] == [0, 1, 2, 3, 0]
    killed, *refused = [row.get("error", "")[len(address) :] for row in rows[2:]]
    assert (killed, ["error" in row for row in rows[:2]]) == (
        ": the policy server has closed the connection",
        [False] * 2,
    )
    gone = ": (no policy server answers there: Connection refused|the policy server has closed the connection.*)"
    assert all(re.fullmatch(gone, error) for error in refused)  # while a process dies, it may still take a connection
    with process(SERVER.replace("CALL", "-1").replace("PORT", port)) as (_, again):
        assert again == address
        certify(Count, address, **evaluation, resume=True)
        certify(Count, address, **{**evaluation, "out": "whole"})
    assert contents("out") == contents("whole")


def test_an_episode_that_failed_forbids_a_certificate() -> None:
    def at_times(seen: NDArray[np.float32]) -> NDArray[np.float32]:
        return seen if seen[0] != 31 else seen * np.float32(np.nan)

    certificate = certify(Count, at_times, [PERIOD_S], episodes=4, seed=20, out="out")
    begin_at_2 = [seed for seed in range(20, 24) if Count().reset(seed=seed)[0] == 2]
    failed = [(row["latency"], row["seed"]) for row in certificate.rows if "error" in row]
    assert failed == [(0, seed) for seed in begin_at_2] == [(0, 20), (0, 22)]  # with a delay every other count is seen
    said = "at_times: returned float32 (1,) with NaN or infinity, where an action is (1,)"
    assert all(certificate.rows[seed - 20]["error"].endswith(said) for _, seed in failed)
    assert ": no certificate: 2 of 8 episodes failed; 4 episodes a latency from seed 20; " in certificate.line
    assert certificate.document["holds"]["latency_s"] is None
    assert [cell["errors"] for cell in certificate.document["cells"]] == [2, 0]
    for resume in (False, True):  # of two episodes the last one, which is played again
        certify(Count, at_times, [0.0], episodes=2, seed=21, out="last", resume=resume)
        assert ["error" in json.loads(row) for row in Path("last/rows.jsonl").read_text().splitlines()] == [False, True]


# --- measured ---------------------------------------------------------------------------------------------------------


def test_what_was_measured_is_replayed_without_the_warm_up() -> None:
    found = measure(Count, same, steps=50, warm_up=5, seed=1)
    assert (len(found.warm_up_ns), len(found.taken_ns), len(found.drift_us)) == (5, 50, 10)
    kept = found.save("times.json")
    said = json.loads(kept.read_text())["measured"]
    assert said["policy"] == {"name": "same", "sha256": file_sha256(Path(__file__))}
    assert said["machine"].keys() == {"platform", "cpu_model", "cores"}
    assert "gymnasium" in said["versions"]
    assert said["warm_up_us"] == [round(each / 1e3, 3) for each in found.warm_up_ns]
    generator = np.random.default_rng(0)
    for times in (thinking_time("times.json"), thinking_time(str(kept))):
        drawn = [times.sample_ns(generator) for _ in range(200)]
        assert min(found.taken_ns) - 1 <= min(drawn) <= max(drawn) <= max(found.taken_ns) + 1
    assert read_latency(kept).request_us["call"][5] == pytest.approx(np.median(found.taken_ns) / 1e3, abs=1e-3)
    env = RealTime(Count(), latency_s="times.json")
    env.reset(seed=0)
    assert env.step(np.zeros(1, np.float32))[-1]["thinking_s"] > 0
    assert list(Measurement([9_000_000, 5_000_000, 1_000_000], [*range(10**6, 10**8, 10**6)], {}).lines()) == [
        "99 thinking times: median 50 ms, 90% 89.2 ms, 99% 98 ms, 100% 99 ms",
        "warm-up, left out: the first 9 ms, 3 calls in the median 5 ms",
        "drift: median 5.5 ms in the first tenth, 95 ms in the last",
    ]
    assert len([*found.lines()]) == 3


def test_what_is_made_is_closed_and_a_program_keeps_its_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each episode of a measurement begins with the policy's reset too; an evaluation is flown in one thread."""
    clock, closed, begun, threads = VirtualClock(), list[Any](), list[Any](), set[int]()
    monkeypatch.setattr("uavaccel.realtime.thinking.MonotonicClock", lambda: clock)

    class Closing(Count):
        def close(self) -> None:
            closed.append(self)

    class Noting:
        def reset(self, seed: int | None) -> None:
            begun.append(seed)
            clock.charge(NS_PER_S)  # which is no thinking

        def __call__(self, seen: Any) -> Any:
            clock.charge(2_000_000)
            threads.add(th.get_num_threads())
            return seen

    before = th.get_num_threads()
    th.set_num_threads(2)
    try:
        assert {*measure(Closing, Noting(), steps=40, warm_up=0, seed=7).taken_ns} == {2_000_000}
        assert (len(closed), begun[0], {*begun[1:]}, threads.pop()) == (1, 7, {None}, 2)  # of thirty steps at most
        certify(Closing, Noting(), [0.01], episodes=1)
        assert (len(set(closed)), threads, th.get_num_threads()) == (4, {1}, 2)  # one to look at, one for each latency
    finally:
        th.set_num_threads(before)


# --- the commands -----------------------------------------------------------------------------------------------------


def ran(words: str) -> int:
    return int(app(words.split(), standalone_mode=False) or 0)


def test_a_policy_is_measured_and_certified_by_commands(capsys: pytest.CaptureFixture[str]) -> None:
    Path("pilot.py").write_text("def act(seen):\n    return 1\n")
    named = "pilot.py:act CartPole-v1"
    with pytest.raises(UserError, match=r"^default_action: a Discrete has no neutral action; name one$"):
        ran(f"timing measure {named}")
    named += " --set default_action=0"
    with pytest.raises(UserError, match=r"add --trust, once$"):
        ran(f"timing measure {named}")
    assert not ran(f"timing measure {named} --steps 30 --warm-up 2 --trust")
    assert not ran(f"timing certify {named} --latency thinking.json --factor 2 --episodes 2 --set command=tcsc")
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("30 thinking times: median ")
    assert said[3].startswith("thinking.json: replay it with RealTime(env, latency_s='thinking.json')")
    assert said[-2].startswith("pilot.py:act in CartPole-v1: holds 90% of its return without latency, ")
    assert said[-1] == "certificate: certificate/certificate.json; figure: certificate/certificate.png"
    document = json.loads(Path("certificate/certificate.json").read_text())
    assert (document["latencies"], document["real_time"]) == ([0, 2], {"command": "tcsc", "default_action": 0})
    with pytest.raises(UserError, match=r"^thinking.json: exists; take another --out$"):
        ran(f"timing measure {named}")
    again = "--latency thinking.json --factor 2 --episodes 2 --set command=tcsc --jobs 2 --out again"
    assert not ran(f"timing certify {named} {again}")
    assert contents("again") == contents("certificate")


def test_an_environment_of_ones_own_is_beside_the_policy(capsys: pytest.CaptureFixture[str]) -> None:
    Path("own_cart.py").write_text(
        "import gymnasium\n"
        "from gymnasium.envs.classic_control import CartPoleEnv\n"
        "gymnasium.register('Beside-v0', CartPoleEnv, max_episode_steps=3)\n"
        "def act(seen):\n    return 1\n"
        "class Stuck(CartPoleEnv):\n    def step(self, action):\n        raise KeyError('wheel')\n"
        "gymnasium.register('Stuck-v0', Stuck)\n"
    )
    named = "timing certify own_cart.py:act own_cart:Beside-v0 --episodes 2 --delay 1 --set default_action=0"
    with pytest.raises(UserError, match=r"^environment 'own_cart:Beside-v0': .* nobody has trusted here: "):
        ran(named)
    assert not ran(f"{named} --jobs 2 --trust")
    assert "own_cart.py:act in Beside-v0: holds 90% of its return" in capsys.readouterr().out
    with pytest.raises(UserError, match=r"^environment 'own_card:Beside-v0': no module 'own_card' in "):
        ran("timing measure own_cart.py:act own_card:Beside-v0")
    for command in ("measure", "certify --delay 1", "certify --delay 2 --jobs 2"):
        with pytest.raises(UserError, match=r"own_cart.py:8: Stuck.step: KeyError: 'wheel'$"):
            ran(f"timing {command} own_cart.py:act own_cart:Stuck-v0 --set default_action=0 --out stuck{len(command)}")


def test_a_worker_runs_what_was_trusted_though_it_was_written_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    Path("pilot.py").write_text("def act(seen):\n    return seen\n")
    monkeypatch.setenv("XDG_STATE_HOME", os.devnull)

    def as_in_others(jobs: int, at_once: int, calls: Iterable[Any]) -> Iterator[Any]:
        for worker, arguments, _ in calls:
            forget_own_code(monkeypatch)
            os.chdir("/")  # where a worker of loky may have been started
            yield worker(*arguments)

    monkeypatch.setattr("uavaccel.realtime.evaluation.on_this_machine", as_in_others)
    certificate = certify(Count, "pilot.py:act", DELAYS, episodes=1, jobs=2, trust=True)
    assert certificate.document["holds"]["latency_s"] == PERIOD_S


def test_a_file_that_was_edited_flies_as_it_is_now() -> None:
    """Its hash is in certificate and measurement."""
    pilot = Path("pilot.py")
    for action, mean in (("seen", 1.0), ("seen - 9", 0.0)):
        pilot.write_text(f"def act(seen):\n    return {action}\n")
        document = certify(Count, "pilot.py:act", [0], episodes=1, trust=True).document
        assert document["cells"][0]["mean"] == mean
        about = measure(Count, "pilot.py:act", steps=2, warm_up=0, trust=True).about
        assert about["policy"] == document["policy"] == {"name": "pilot.py:act", "sha256": file_sha256(pilot)}


def test_a_wrong_key_of_the_environment_is_one_line() -> None:
    with pytest.raises(UserError, match=r"^CartPole-v1: --set env.KEY: CartPoleEnv.__init__\(\) got an unexpected"):
        ran("timing certify pilot.py:act CartPole-v1 --set env.wind=2")


def test_a_policy_server_has_the_time_of_the_option() -> None:
    with pytest.raises(UserError, match=r"^answer_s: must be above 0 and at most 3600 seconds, not 0.0$"):
        ran("timing certify tcp://127.0.0.1:1 CartPole-v1 --answer 0 --set default_action=0")


@needs_opengl
def test_the_policy_that_ships_is_certified_in_its_environment() -> None:
    """Whose task it had in its training; the drone keeps its own clock."""
    with pytest.raises(UserError, match=r"^default: flies uavaccel/ObstacleLane-v0, not CartPole-v1$"):
        ran("timing certify default CartPole-v1")
    keys = "--set env.timing=virtual --set env.command=adsc --set env.max_commands=2 --set env.speed_m_s=1.5"
    assert not ran(f"timing certify default uavaccel/ObstacleLane-v0 --episodes 1 --latency 0.1 --jobs 2 {keys}")
    document = json.loads(Path("certificate/certificate.json").read_text())
    assert document["policy"]["sha256"] == file_sha256(asset("policies/default/policy.pt"))
    assert document["environment"]["kwargs"]["speed_m_s"] == 1.5  # not that of its training
    assert [cell["latency_s"] for cell in document["cells"]] == [0, 0.1]


def test_a_certificate_is_what_its_rows_say() -> None:
    rows = [
        {"latency": at, "seed": seed, "return": 1.0, "success": won, "thinking_s": at + (seed > 7)}
        for at, wins in ((0.0, 10), (0.1, 9), (0.2, 8), (0.3, 10))
        for seed, won in enumerate([True] * wins + [False] * (10 - wins))
    ]
    setup = {"policy": {"name": "p", "sha256": None}, "environment": {"id": "E"}, "calibration": None}
    certificate = Certificate({**setup, "unit": "seconds", "episodes": 10, "seed": 0}, rows)
    assert [cell["latency_s"] for cell in certificate.document["cells"]] == [0.0, 0.1, 0.2, 0.3]  # the medians
    assert certificate.document["holds"]["latency_s"] == 0.1  # what comes after the first that does not hold is not
    assert "policy of unknown hash" in certificate.line
    steps = [
        row | {"latency": int(10 * row["latency"]), "success": row["success"] and not row["latency"]} for row in rows
    ]
    assert "up to 0 ms, 0 steps (10 " in Certificate({**certificate.setup, "unit": "steps"}, steps).line
    lost = Certificate(certificate.setup, [row | {"success": False} for row in rows])
    assert ": no certificate: without latency no episode is a success; 10 episodes a latency" in lost.line
    assert lost.document["holds"]["latency_s"] is None
