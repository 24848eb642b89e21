"""Replay buffers against a plain loop over what was flown, through every kind of end."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch as th
from torch.nn import functional

from tests.host_kernels import host_kernels  # noqa: F401 - a fixture
from uavaccel.rl.contrast import contrast
from uavaccel.rl.replay import Batch, ReplayBuffer

LANES, ROWS, GAMMA = 3, 11, 0.5
CPU = th.device("cpu")
AFTER = 1_000.0  # is added to what a command was decided on, to tell what followed it


class Flown(NamedTuple):
    """One command of one lane; `seen` is its number, and no other's."""

    seen: float
    action: int
    reward: float
    terminated: bool
    truncated: bool


def flights(commands: int, seed: int = 0) -> list[list[Flown]]:
    """Of each lane, in order; games end after four commands or so, either way. Each lane's rewards are its own."""
    random = np.random.default_rng(seed)
    return [
        [
            Flown(
                number * LANES + lane + 1.0,
                int(random.integers(5)),
                float(random.integers(-20, 20) + 100 * lane),
                over := bool(random.random() < 0.2),
                not over and bool(random.random() < 0.2),
            )
            for number in range(commands)
        ]
        for lane in range(LANES)
    ]


def filled(commands: int) -> tuple[ReplayBuffer, list[list[Flown]]]:
    """A buffer, and what is left in it of each lane."""
    buffer = ReplayBuffer(ROWS * LANES + LANES - 1, LANES, (1,), np.dtype(np.float32), CPU)
    flown = flights(commands)
    for row in zip(*flown, strict=True):
        seen, actions, rewards, terminated, truncated = (np.array(each) for each in zip(*row, strict=True))
        buffer.add(seen[:, None], actions, rewards, seen[:, None] + AFTER, terminated | truncated, truncated)
    return buffer, [lane[-ROWS:] for lane in flown]


def expected(lane: list[Flown], first: int, n_steps: int) -> tuple[float, ...]:
    """What there is to learn from a lane's command: next observation, over, return, discount."""
    total, discount = 0.0, 1.0
    for flown in lane[first : first + n_steps]:
        total += discount * flown.reward
        discount *= GAMMA
        if flown.terminated or flown.truncated:
            break
    return flown.seen + AFTER, float(flown.terminated), total, discount


@pytest.mark.parametrize("n_steps", [1, 2, 4])
@pytest.mark.parametrize("commands", [2, ROWS - 1, ROWS, ROWS + 1, 2 * ROWS + 5])
def test_each_command_is_drawn_with_what_a_plain_loop_finds(commands: int, n_steps: int) -> None:
    buffer, flown = filled(commands)
    assert len(buffer) == min(commands, ROWS)
    there = {
        each.seen: (each.action, *expected(lane, number, n_steps)) for lane in flown for number, each in enumerate(lane)
    }
    share = 60  # draws of each command, about
    batch = buffer.sample(share * len(there), n_steps, GAMMA, np.random.RandomState(0))
    drawn = Counter[float]()
    for seen, action, after, done, reward, discount in zip(*columns(batch), strict=True):
        assert (action, after, done, reward, discount) == there[seen]
        drawn[seen] += 1
    assert set(drawn) == set(there)
    assert share / 2 < min(drawn.values()) <= max(drawn.values()) < share * 2


def columns(batch: Batch) -> list[list[float]]:
    assert {each.shape for each in batch} == {(len(batch.actions), 1)}
    return [each.ravel().tolist() for each in batch]


def test_a_wrapped_ring_is_put_back_and_goes_on() -> None:
    buffer, _ = filled(ROWS + 4)
    other = ReplayBuffer(ROWS * LANES, LANES, (1,), np.dtype(np.float32), CPU)
    other.set_state(buffer.get_state())
    for each in (buffer, other):
        seen = np.full((LANES, 1), 7.0)
        each.add(seen, np.ones(LANES, int), np.ones(LANES), seen, np.zeros(LANES, bool), np.zeros(LANES, bool))
    drawn = [columns(each.sample(300, 3, GAMMA, np.random.RandomState(1))) for each in (buffer, other)]
    assert drawn[0] == drawn[1]
    assert 7.0 in drawn[0][0]


def test_pictures_are_kept_as_bytes_and_no_buffer_is_too_small_for_the_newest_command() -> None:
    buffer = ReplayBuffer(1, 2, (1, 2, 2), np.dtype(np.uint8), CPU)
    picture, after = np.array([[[[0, 1], [254, 255]]]] * 2, np.uint8), np.full((2, 1, 2, 2), 9, np.uint8)
    for seen in (after, picture):
        buffer.add(seen, np.array([3, 3]), np.ones(2), after, np.ones(2, bool), np.zeros(2, bool))
    batch = buffer.sample(20, 1, GAMMA, np.random.RandomState(0))
    assert batch.observations.dtype == th.uint8
    assert (batch.observations.numpy() == picture[0]).all()
    assert (batch.next_observations.numpy() == after[0]).all()


# --- of lanes on a GPU, on tensors of the CPU -------------------------------------------------------------------


@pytest.fixture
def device_replay(host_kernels: None) -> Any:  # noqa: F811
    from uavaccel.rl import device_replay

    return device_replay


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("n_steps", [1, 3])
@pytest.mark.parametrize("commands", [4, ROWS - 1, ROWS, 2 * ROWS + 5])
def test_windows_of_the_ring_on_a_device_are_those_of_a_plain_loop(
    device_replay: Any, commands: int, n_steps: int, mirror: bool
) -> None:
    replay = device_replay.DeviceReplay(ROWS, LANES, (1,), th.float32, CPU)
    flown, idle = flights(commands), np.random.default_rng(3).random((LANES, commands)) < 0.1
    for number, row in enumerate(zip(*flown, strict=True)):
        seen, actions, rewards, terminated, truncated = (th.tensor(each) for each in zip(*row, strict=True))
        replay.start_round(seen[:, None], actions)
        replay.end_round(rewards, terminated, truncated, th.from_numpy(~idle[:, number]))
    replay.start_round(th.full((LANES, 1), AFTER), th.zeros(LANES, dtype=th.int64))  # a round is being flown
    kept = min(commands, ROWS - 1)  # whole rounds; all n commands and what is seen after them must be there
    there = {
        lane[number].seen: (
            lane[number + n_steps].seen if number + n_steps < commands else AFTER,
            lane[number].action,
            *windows_of(lane, number, n_steps, idle[place, number]),
        )
        for place, lane in enumerate(flown)
        for number in range(commands - kept, commands - n_steps + 1)
    }
    th.manual_seed(0)
    share = 60
    drawn = replay.sample(share * len(there), n_steps, GAMMA, mirror)
    assert drawn.mirrored.tolist() == [mirror and number % 2 == 0 for number in range(share * len(there))]
    begun = replay.observations[drawn.row, drawn.lane, 0].tolist()
    after = replay.observations[drawn.after, drawn.lane, 0].tolist()
    told = (drawn.actions, drawn.rewards, drawn.discounts, drawn.weights)
    for seen, followed, *found in zip(begun, after, *(each.tolist() for each in told), strict=True):
        assert found[-1] == there[seen][-1]
        if found[-1]:  # what has no weight is not learned
            assert (followed, *found) == there[seen]
    counted = Counter(begun)
    assert set(counted) == set(there)
    assert share / 2 < min(counted.values()) <= max(counted.values()) < share * 2


def windows_of(lane: list[Flown], first: int, n_steps: int, idle: bool) -> tuple[float, float, float]:
    """Return, discount of what follows, and weight: none where the window was cut short, or nothing was flown."""
    total = 0.0
    for step, flown in enumerate(lane[first : first + n_steps]):
        total += GAMMA**step * flown.reward
        if flown.truncated:
            return total, 0.0, 0.0
        if flown.terminated:
            return total, 0.0, float(not idle)
    return total, GAMMA**n_steps, float(not idle)


def test_a_ring_on_a_device_is_put_back(device_replay: Any) -> None:
    one, other = (device_replay.DeviceReplay(4, LANES, (1,), th.float32, CPU) for _ in range(2))
    flags = th.tensor([True, False, False])
    for number in range(6):
        one.start_round(th.full((LANES, 1), number + 1.0), th.tensor([0, 1, 2]))
        one.end_round(th.tensor([1.0, 2.0, 3.0]), flags, flags.flip(0), ~flags)
    other.set_state(one.get_state())
    for name in ("observations", "actions", "rewards", "over", "cut", "flown", "place", "filled"):
        assert th.equal(getattr(one, name), getattr(other, name)), name
    assert (one.place.item(), one.filled.item()) == (2, 3)


def test_patches_are_what_the_first_convolution_sees(device_replay: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    frames, rows, columns = 2, 12, 16
    down, across, numbers = device_replay.patches_of(frames, rows, columns)
    assert device_replay.patches_of(3, 36, 64) == (9, 16, 192)
    levels = np.random.default_rng(0).integers(0, 256, (4, LANES, frames, rows, columns), dtype=np.uint8)
    row, lane, mirrored = np.array([3, 1]), np.array([2, 0]), np.array([0, 1])
    patches = np.empty((2 * down * across, numbers // 4), np.int64)  # words of four numbers
    bits = device_replay.spread_levels(CPU).numpy()
    for thread in range(len(patches) * frames * device_replay.KERNEL):
        monkeypatch.setattr(device_replay, "cuda", SimpleNamespace(grid=lambda _, at=thread: at))
        device_replay._cut(row, lane, mirrored, bits, levels.view(np.int16), patches, down, across)
    seen = th.from_numpy(np.stack([levels[3, 2], levels[1, 0, :, :, ::-1]]).astype(np.float32))
    padded = functional.unfold(contrast(seen), 8, stride=4, padding=2)
    expected = padded.transpose(1, 2).reshape(len(patches), numbers).to(th.bfloat16)
    assert th.equal(th.from_numpy(patches).view(th.bfloat16), expected)
