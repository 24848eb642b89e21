"""ADSC and TCSC against a scripted client: which calls, in which order, at which times."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uavaccel.commands import COMMANDS, VelocityGoal, adsc, check_times, samples_due, slice_of, tcsc, velocities
from uavaccel.kinematics import FlightGoal, Kinematics

MS = 1_000_000
NORTH = VelocityGoal((1.0, 0.0, 0.0))
AT_REST = Kinematics(0, (0.0, 0.0, -10.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

Call = tuple[Any, ...]


@dataclass
class ScriptedClient:
    """Simulated and wall time under a script; every call is logged.

    `early_ns`: by how much each continue-for in turn ends early. `latency_ns`: wall time that a call takes. The command
    ends `clock_speed` times faster than simulated, on a wall clock that stands while the simulation is paused.
    """

    clock_speed: float = 1.0
    early_ns: list[int] = field(default_factory=list)
    latency_ns: int = 0
    calls: list[Call] = field(default_factory=list)
    time_ns: int = 7 * MS
    wall_ns: int = 1_000 * MS
    left_ns: int = 0
    paused: bool = False

    def now_ns(self) -> int:
        return self.wall_ns

    def move_async(self, goal: FlightGoal, t_move_s: float) -> str:
        self._take(self.latency_ns, "move", goal, t_move_s)
        self.left_ns = round(t_move_s * 1e9 / self.clock_speed)
        return "future"

    def join(self, future: str, deadline_ns: int | None = None) -> bool:
        assert future == "future"
        end_ns = self.wall_ns + self.left_ns
        until_ns = end_ns if deadline_ns is None else min(end_ns, max(deadline_ns, self.wall_ns))
        self._take(until_ns - self.wall_ns, "join", deadline_ns)
        return self.left_ns == 0

    def pause(self) -> None:
        self._take(self.latency_ns, "pause")
        self.paused = True

    def run(self) -> None:
        self._take(self.latency_ns, "run")
        self.paused = False

    def continue_for(self, duration_ns: int) -> Kinematics:
        self.calls.append(("continue", duration_ns))
        self.time_ns += duration_ns - (self.early_ns.pop(0) if self.early_ns else 0)
        return replace(AT_REST, time_ns=self.time_ns)

    def kinematics(self) -> Kinematics:
        self._take(self.latency_ns, "state")
        return replace(AT_REST, time_ns=self.time_ns)

    def read_sample(self, state: Kinematics) -> tuple[str, int]:
        self.calls.append(("read_sample",))
        return ("sample", state.time_ns)

    def _take(self, wall_ns: int, *call: Any) -> None:
        self.calls.append(call)
        self.wall_ns += wall_ns
        if not self.paused:
            passed_ns = min(wall_ns, self.left_ns)
            self.left_ns -= passed_ns
            self.time_ns += round(passed_ns * self.clock_speed)

    def names(self) -> str:
        return " ".join(str(call[0]) for call in self.calls)


# --- TCSC: Figure 4 ---------------------------------------------------------------------------------------


def test_tcsc_is_figure_4() -> None:
    client = ScriptedClient()
    assert list(tcsc(client, NORTH, 1.0, 1.0)) == [("sample", 1007 * MS)]
    assert client.calls == [("state",), ("move", NORTH, 1.0), ("continue", 1000 * MS), ("read_sample",)]


def test_tcsc_takes_three_samples_a_command_as_in_the_paper() -> None:
    client = ScriptedClient()
    samples = list(tcsc(client, NORTH, 1.0, 0.33))
    assert samples == [("sample", (7 + t) * MS) for t in (330, 660, 1000)]
    assert client.calls[2:] == [
        *[("continue", 330 * MS), ("read_sample",)] * 2,
        *[("continue", 340 * MS), ("read_sample",)],
    ]


def test_tcsc_gathers_before_it_goes_on() -> None:
    """A generator: who thinks between two samples thinks while the clock is paused."""
    client = ScriptedClient()
    flight = tcsc(client, NORTH, 1.0, 0.5)
    next(flight)
    assert client.names() == "state move continue read_sample"
    next(flight)
    assert client.names() == "state move continue read_sample continue read_sample"


def test_tcsc_that_woke_early_runs_the_difference() -> None:
    client = ScriptedClient(early_ns=[30 * MS, 5 * MS, 0, 2 * MS])
    samples = list(tcsc(client, NORTH, 1.0, 0.5))
    assert [call[1] for call in client.calls if call[0] == "continue"] == [
        *[500 * MS, 30 * MS, 5 * MS],
        *[500 * MS, 2 * MS],
    ]
    assert samples == [("sample", 507 * MS), ("sample", 1007 * MS)]


@pytest.mark.parametrize(("early_ms", "calls"), [(9, 1), (10, 1), (11, 2)])
def test_a_difference_up_to_t_th_counts_as_complete(early_ms: int, calls: int) -> None:
    client = ScriptedClient(early_ns=[early_ms * MS])
    list(tcsc(client, NORTH, 1.0, 1.0, t_th_ns=10 * MS))
    assert client.names().count("continue") == calls


def test_neither_early_nor_late_ends_add_up() -> None:
    """Deadlines are absolute: each slice makes good what the last one was short of or beyond by."""
    client = ScriptedClient(early_ns=[8 * MS, 8 * MS, -6 * MS, -6 * MS])
    samples = list(tcsc(client, NORTH, 1.0, 0.25, t_th_ns=10 * MS))
    assert [time_ns // MS - 7 for _, time_ns in samples] == [242, 492, 756, 1006]
    assert [call[1] // MS for call in client.calls if call[0] == "continue"] == [250, 258, 258, 244]


# --- ADSC: section II-B -------------------------------------------------------------------------------------


def test_adsc_joins_and_gathers_with_the_clock_stopped() -> None:
    client = ScriptedClient()
    assert list(adsc(client, NORTH, 1.0, 1.0)) == [("sample", 1007 * MS)]
    assert client.calls == [("move", NORTH, 1.0), ("join", None), ("pause",), ("state",), ("read_sample",), ("run",)]


def test_adsc_samples_are_due_at_multiples_of_t_sample() -> None:
    client = ScriptedClient(clock_speed=10.0)
    samples = list(adsc(client, NORTH, 1.0, 0.33))
    assert samples == [("sample", (7 + t) * MS) for t in (330, 660, 1000)]
    assert [call for call in client.calls if call[0] == "join"] == [
        ("join", 1_000 * MS + 33 * MS),
        ("join", 1_000 * MS + 66 * MS),
        ("join", None),
    ]
    read_sample = "pause state read_sample run"
    assert client.names() == f"move join {read_sample} join {read_sample} join {read_sample}"


def test_adsc_allows_for_the_time_it_stood_still() -> None:
    """The deadline of the second sample is later by what the first one took from pause to continue."""
    client = ScriptedClient(latency_ns=2 * MS)
    list(adsc(client, NORTH, 1.0, 0.5))
    deadlines = [call[1] for call in client.calls if call[0] == "join"]
    assert deadlines == [1_000 * MS + 500 * MS, None]
    client = ScriptedClient(latency_ns=2 * MS)
    list(adsc(client, NORTH, 1.0, 0.25))
    deadlines = [call[1] for call in client.calls if call[0] == "join"]
    assert deadlines[:3] == [1_000 * MS + (250 * n + 6 * (n - 1)) * MS for n in (1, 2, 3)]


def test_adsc_whose_command_ended_takes_no_more_samples_but_the_last() -> None:
    """At 1000x a call costs more simulated time than there is between two samples."""
    client = ScriptedClient(clock_speed=1000.0, latency_ns=2 * MS)
    assert list(adsc(client, NORTH, 1.0, 0.1)) == [("sample", 1007 * MS)] * 2
    read_sample = "pause state read_sample run"
    assert client.names() == f"move join {read_sample} join join {read_sample}"


def test_adsc_lets_the_clock_run_and_tcsc_stops_it() -> None:
    """Before the first command of a game."""
    for name, call in (("adsc", "run"), ("tcsc", "pause")):
        client = ScriptedClient()
        COMMANDS[name].begin(client)
        assert client.calls == [(call,)]


# --- slices and paths -----------------------------------------------------------------------------------------


@given(st.integers(1, 5000), st.integers(1, 5000))
def test_slices_fill_the_command_and_none_is_a_stub(t_move_ms: int, t_sample_ms: int) -> None:
    due = samples_due(t_move_ms / 1000, t_sample_ms / 1000)
    slices = [later - earlier for earlier, later in zip([0, *due], due, strict=False)]
    assert sum(slices) == due[-1] == t_move_ms * MS
    assert all(length == t_sample_ms * MS for length in slices[:-1])
    assert len(slices) == 1 or slices[-1] >= 0.05 * t_sample_ms * MS
    assert slices[-1] < 1.05 * t_sample_ms * MS
    assert slice_of(t_move_ms * MS, t_sample_ms * MS) == slices[0]


def test_a_command_is_cut_into_samples_as_the_paper_counts_them() -> None:
    """A rest shorter than a twentieth of a sample is none."""
    due_ms = {(1.0, 0.33): [330, 660, 1000], (0.1, 1.0): [100], (1.049, 1.0): [1049], (1.05, 1.0): [1000, 1050]}
    for times_s, due in due_ms.items():
        assert [each / MS for each in samples_due(*times_s)] == due


@pytest.mark.parametrize(
    ("t_move_s", "t_sample_s", "flown_s"),
    [(1.0, 0.5, {0.5}), (1.0, 0.33, {0.33, 0.34}), (1.0, 0.3, {0.3, 0.1}), (0.5, 0.5, {0.5}), (0.5, 2.0, {0.5})],
)
def test_what_is_flown_is_what_has_to_fit(t_move_s: float, t_sample_s: float, flown_s: set[float]) -> None:
    """A sampling time beyond the command's end is never flown, so that any will do."""
    asked: list[tuple[str, float]] = []
    check_times(t_move_s, t_sample_s, lambda seconds, name: asked.append((name, seconds)))
    assert {seconds for name, seconds in asked if name == "t_move_s"} == {t_move_s}
    assert {seconds for name, seconds in asked if name == "t_sample_s"} == flown_s


def test_paths_are_lists_of_velocities() -> None:
    assert velocities("square", 2) == [(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)] * 2
    assert velocities("two_forward_one_back", 1, 2.0) == [(2, 0, 0), (2, 0, 0), (-2, 0, 0)]
    assert velocities([(0.0, 0.0, -1.0)], 3, 5.0) == [(0, 0, -1)] * 3, "the caller's own are not scaled"
