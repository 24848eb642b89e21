"""A game that was saved and gone on with elsewhere is the same game, byte for byte."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uavaccel.commands import COMMANDS
from uavaccel.errors import UserError
from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.profile import AIRSIM, NATIVE
from uavaccel.sim.world import World
from uavaccel.units import plain
from uavaccel.wire.client import Client
from uavaccel.wire.latency import QUANTILES, LatencyConfig
from uavaccel.wire.platform import PlatformConfig
from uavaccel.wire.session import Session, VirtualSession, open_session

ROOT = Path(__file__).parents[1]
RISING_US = tuple(50.0 + 400.0 * quantile for quantile in QUANTILES)
LATENCY = LatencyConfig(
    request_us={"call": RISING_US, "move": tuple(2 * x for x in RISING_US)},
    reply_us={"call": RISING_US, "pause@5ms": tuple(3 * x for x in RISING_US)},
    issue_us=RISING_US,
    timer_us=RISING_US,
)


def session_of(timing: str, profile: str, scene: str = "blocks") -> Any:
    return open_session(timing, profile, scene, LATENCY)


def test_a_modelled_simulator_is_saved_with_its_speed_and_what_its_frames_show() -> None:
    platform = PlatformConfig.model_validate(
        {"tick_us": 60.0, "frames": {"hz": 60.0, "stale_pose": True}, "faults": {"late": 0.3}}
    )
    latency = LATENCY.model_copy(update={"platform": platform})
    with VirtualSession("blocks", "airsim", latency) as session, VirtualSession("blocks", "airsim", latency) as other:
        client = session.start_game(100.0, np.random.SeedSequence(5))
        fly(client, "adsc", 1, 3)
        again = other.set_state(session.get_state())
        shown, shown_again = (
            each._transport._api.simulation.frames.scene(each._world(100.0).data).qpos.tolist()
            for each in (session, other)
        )
        assert shown == shown_again != session._world(100.0).data.qpos.tolist()
        assert fly(again, "tcsc", 2, 3) == fly(client, "tcsc", 2, 3)
        assert again.speed() == client.speed()


def fly(client: Client, command: str, seed: int, count: int) -> list[Any]:
    """Random commands, some with a height or a yaw of their own; what the client saw and when."""
    rng = np.random.default_rng(seed)
    seen: list[Any] = []
    for _ in range(count):
        north, east, down = rng.uniform(-3, 3, 3).tolist()
        height = None if rng.random() < 0.5 else -10.0 + down
        goal = VelocityGoal((north, east, 0.0 if height else down), height, rng.uniform(-1, 1))
        COMMANDS[command].begin(client)
        seen += [*COMMANDS[command].fly(client, goal, float(rng.choice([0.2, 0.5])), 0.1), client.now_ns()]
    return seen


def evidence(client: Client) -> tuple[bytes, ...]:
    """The recording, the speeds and the clock, as bytes."""
    recording = client.recording()
    return (
        recording.samples.tobytes(),
        recording.commands.tobytes(),
        json.dumps([client.speed(), client.collision(), client.now_ns()]).encode(),
    )


def through_a_file(state: dict[str, Any], kind: str) -> Any:
    """As `np.load` or JSON gives it back, without pickle."""
    if kind == "json":
        return json.loads(json.dumps({name: plain(value) for name, value in state.items()}))
    file = io.BytesIO()
    np.savez(file, **state)
    file.seek(0)
    return dict(np.load(file))


@pytest.fixture(scope="module")
def sessions() -> dict[tuple[str, str, int], Any]:
    return {}


@settings(max_examples=24)
@given(
    seed=st.integers(0, 2**32),
    before=st.integers(0, 4),
    command=st.sampled_from(["adsc", "tcsc"]),
    timing=st.sampled_from(["virtual", "lockstep"]),
    profile=st.sampled_from(["native", "airsim"]),
    kind=st.sampled_from(["npz", "json"]),
    clock_speed=st.sampled_from([1.0, 2.5, 100.0]),
)
def test_a_saved_game_goes_on_to_the_same_bytes(
    sessions: dict[tuple[str, str, int], Any], seed: int, before: int, command: str, timing: str, profile: str,
    kind: str, clock_speed: float,
) -> None:  # fmt: skip
    for copy in (0, 1):
        if (timing, profile, copy) not in sessions:
            sessions[timing, profile, copy] = session_of(timing, profile)
    here, there = (sessions[timing, profile, copy] for copy in (0, 1))
    client = here.start_game(clock_speed, np.random.SeedSequence([seed, 2**70], spawn_key=(3,)))
    fly(client, command, seed, before)
    saved = through_a_file(here.get_state(), kind)
    seen, kept = fly(client, command, seed + 1, 2), evidence(client)
    client = there.set_state(saved)
    assert fly(client, command, seed + 1, 2) == seen
    assert evidence(client) == kept


ELSEWHERE = """
import json, sys
import numpy as np
from tests.test_saved_games import evidence, fly, session_of
client = session_of("virtual", "native", "lane").set_state(np.load(sys.argv[1]))
fly(client, "tcsc", 8, 4)
sys.stdout.buffer.write(b"|".join(evidence(client)))
"""


def test_a_game_in_a_lane_goes_on_in_another_process(tmp_path: Path) -> None:
    """With its lane, its wind and, in the end, its collision."""
    posts = [{"x_m": 2.0, "y_m": y, "radius_m": 0.4} for y in (-4, -3, -2, -1, 1, 2, 3, 4)]
    session = session_of("virtual", "native", "lane")
    client = session.start_game(10.0, lane={"obstacles": posts, "wind_m_s": [3.0, 1.0, 0.0]})
    fly(client, "tcsc", 7, 4)
    np.savez(tmp_path / "game.npz", **session.get_state())
    fly(client, "tcsc", 8, 4)
    again = subprocess.run(
        [sys.executable, "-c", ELSEWHERE, str(tmp_path / "game.npz")], cwd=ROOT, capture_output=True, check=True
    )
    assert again.stdout == b"|".join(evidence(client))


@pytest.mark.parametrize("profile", [NATIVE, AIRSIM], ids=lambda profile: profile.name)
def test_a_world_saved_while_it_touches_something_goes_on(profile: Any) -> None:
    """Bouncing on the ground, rotors off: contacts, warm starts and the count of touches."""
    ends = []
    worlds = [World("blocks", profile) for _ in range(2)]
    worlds[0].place((0.0, 0.0, -1.0), (0.9, 0.3, 0.3, 0.1), (2.0, 0.0, 0.0))
    worlds[0].lead.state["armed"] = 0
    worlds[0].advance(round(0.46 / profile.tick_s))
    while not worlds[0].lead.state["contacts"]:
        worlds[0].advance(1)
    worlds[1].set_state(through_a_file(worlds[0].get_state(), "json"))
    for world in worlds:
        world.start_recording()
        world.advance(1000)
        ends.append((world.samples().tobytes(), world.lead.contact_log.count, world.lead.contact_log.latest))
    assert ends[0] == ends[1]
    assert ends[0][1] > 1


def test_a_state_of_something_else_is_refused() -> None:
    session: VirtualSession = session_of("virtual", "native")
    session.start_game(1.0)
    state = session.get_state()
    others: list[tuple[Session, str]] = [
        (session_of("virtual", "airsim"), "profile is native, not airsim"),
        (session_of("virtual", "native", "lane"), "scene is blocks, not lane"),
        (session_of("lockstep", "native"), "latency"),
    ]
    for other, text in others:
        with pytest.raises(UserError, match=text):
            other.set_state(state)
