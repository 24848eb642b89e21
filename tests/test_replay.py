"""Replay buffers against a plain loop over what was flown, through every kind of end."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from torch.nn import functional

from tests.host_kernels import host_kernels  # noqa: F401 - a fixture
from uavaccel.rl.network import Levels, Replay, Windows, contrast

LANES, ROWS, GAMMA = 3, 11, 0.5
CPU = th.device("cpu")
AFTER = 1_000.0  # is added to what a command was decided on, to tell what followed it
SHARE = 60  # draws of each command, about
NEVER = th.zeros(1, dtype=th.bool)


class Flown(NamedTuple):
    """One command of one lane; `seen` is its number, and no other's."""

    seen: float
    action: int
    reward: float
    terminated: bool
    truncated: bool
    idle: bool


def flights(commands: int, idle: float) -> list[list[Flown]]:
    """Of each lane, in order; games end after four commands or so, either way. Each lane's rewards are its own."""
    random = np.random.default_rng(0)
    return [
        [
            Flown(
                number * LANES + lane + 1.0,
                int(random.integers(5)),
                float(random.integers(-20, 20) + 100 * lane),
                over := bool(random.random() < 0.2),
                not over and bool(random.random() < 0.2),
                bool(random.random() < idle),
            )
            for number in range(commands)
        ]
        for lane in range(LANES)
    ]


def filled(commands: int, keeps_ends: bool) -> tuple[Replay, list[list[Flown]]]:
    """A buffer, and what was flown by each lane; without ends a lane may be idle, and a round is being flown."""
    buffer = Replay(ROWS, LANES, spaces.Box(-1.0, 1.0, (1,)), CPU, keeps_ends)
    flown = flights(commands, 0.0 if keeps_ends else 0.1)
    for row in zip(*flown, strict=True):
        seen, actions, rewards, over, cut, idle = (th.tensor(each) for each in zip(*row, strict=True))
        buffer.start_round(seen[:, None], actions)
        buffer.end_round(rewards, over, cut, ~idle, seen[:, None] + AFTER if keeps_ends else None)
    if not keeps_ends:
        buffer.start_round(th.full((LANES, 1), AFTER), th.zeros(LANES, dtype=th.int64))
    return buffer, flown


def expected(lane: list[Flown], first: int, n_steps: int, keeps_ends: bool) -> tuple[float, ...]:
    """What there is to learn from a lane's command: s', a, the return, the discount of what follows, and the weight."""
    total, discount, weight, last = 0.0, 1.0, float(not lane[first].idle), first
    for last in range(first, min(first + n_steps, len(lane))):
        total += discount * lane[last].reward
        discount *= GAMMA
        if lane[last].terminated or (lane[last].truncated and keeps_ends):
            break
        weight *= not lane[last].truncated or keeps_ends
    after = lane[last].seen + AFTER
    if not keeps_ends:
        after = lane[first + n_steps].seen if first + n_steps < len(lane) else AFTER
    return after, lane[first].action, total, 0.0 if lane[last].terminated else discount, weight


@pytest.mark.parametrize("keeps_ends", [True, False])
@pytest.mark.parametrize("n_steps", [1, 2, 4])
@pytest.mark.parametrize("commands", [4, ROWS - 1, ROWS, ROWS + 1, 2 * ROWS + 5])
def test_windows_are_those_of_a_plain_loop(commands: int, n_steps: int, keeps_ends: bool) -> None:
    """With ends every row begins one; without, all n commands and what is seen after them must be there."""
    buffer, flown = filled(commands, keeps_ends)
    kept = min(commands, ROWS if keeps_ends else ROWS - 1)
    last = commands if keeps_ends else commands - n_steps + 1
    there = {
        lane[number].seen: expected(lane, number, n_steps, keeps_ends)
        for lane in flown
        for number in range(commands - kept, last)
    }
    count = SHARE * len(there)
    if keeps_ends:
        row, lane = th.arange(count) % kept, th.arange(count) // kept % LANES
    else:
        th.manual_seed(0)
        row, lane = buffer.draw(count, n_steps)
    drawn = buffer.windows(row, lane, n_steps, GAMMA, NEVER)
    begun = buffer.observations[drawn.row, drawn.lane, 0].tolist()
    after = buffer.next_observations[drawn.after, drawn.lane, 0].tolist()
    told = (drawn.actions, drawn.rewards, drawn.discounts, drawn.weights)
    for seen, followed, *found in zip(begun, after, *(each.tolist() for each in told), strict=True):
        assert found[-1] == there[seen][-1]
        if found[-1]:  # what has no weight is not learned, and what is over leads nowhere
            assert found == list(there[seen][1:])
            assert followed == there[seen][0] or not found[2]
    counted = Counter(begun)
    assert set(counted) == set(there)
    assert SHARE / 2 < min(counted.values()) <= max(counted.values()) < SHARE * 2


@pytest.mark.parametrize("keeps_ends", [True, False])
@pytest.mark.parametrize("commands", [5, ROWS + 4])
def test_a_ring_is_put_back_and_goes_on(commands: int, keeps_ends: bool) -> None:
    buffer, _ = filled(commands, keeps_ends)
    other = Replay(ROWS, LANES, spaces.Box(-1.0, 1.0, (1,)), CPU, keeps_ends)
    state = buffer.get_state()
    assert len(state["rewards"]) == min(commands, ROWS)
    other.set_state(state)
    seen, flags, drawn = th.full((LANES, 1), 7.0), th.zeros(LANES, dtype=th.bool), list[Any]()
    for each in (buffer, other):
        each.start_round(seen, th.ones(LANES, dtype=th.int64))
        each.end_round(th.ones(LANES), flags, flags, ~flags, seen if keeps_ends else None)
        th.manual_seed(1)
        row, lane = each.draw(300, 3)
        drawn.append([each.observations[row, lane].tolist(), *each.windows(row, lane, 3, GAMMA, NEVER)[:-1]])
    assert drawn[0][0] == drawn[1][0]
    assert all(th.equal(*pair) for pair in zip(drawn[0][1:], drawn[1][1:], strict=True))


def test_batches_divide_windows() -> None:
    windows = Windows(*(th.arange(6) + 10 * column for column in range(8)))
    assert [batch.lane.tolist() for batch in windows.split(3)] == [[20, 21, 22], [23, 24, 25]]


def test_mirrored_pictures_are_turned_and_numbers_are_not() -> None:
    picture = th.arange(12, dtype=th.uint8).reshape(1, 2, 1, 2, 3)  # a row of two lanes
    seen = Levels().look(picture, th.tensor([0, 0]), th.tensor([1, 0]), th.tensor([True, False]))
    np.testing.assert_array_equal(seen, contrast(th.stack([picture[0, 1].flip(-1), picture[0, 0]]).float()))
    numbers = th.arange(6.0).reshape(1, 2, 1, 3)
    np.testing.assert_array_equal(
        Levels().look(numbers, th.tensor([0]), th.tensor([1]), th.tensor([True])), numbers[0, 1:]
    )


@pytest.mark.usefixtures("host_kernels")
def test_patches_are_what_the_first_convolution_sees(monkeypatch: pytest.MonkeyPatch) -> None:
    from uavaccel.rl import patches as of

    frames, rows, columns = 2, 12, 16
    down, across, numbers = of.patches_of(frames, rows, columns)
    assert of.patches_of(3, 36, 64) == (9, 16, 192)
    levels = np.random.default_rng(0).integers(0, 256, (4, LANES, frames, rows, columns), dtype=np.uint8)
    row, lane, mirrored = np.array([3, 1]), np.array([2, 0]), np.array([0, 1])
    patches: Any = np.empty((2 * down * across, numbers // 4), np.int64)  # words of four numbers
    bits = of.spread_levels(CPU).numpy()
    for thread in range(len(patches) * frames * of.KERNEL):
        monkeypatch.setattr(of, "cuda", SimpleNamespace(grid=lambda _, at=thread: at))
        of._cut(row, lane, mirrored, bits, levels.view(np.int16), patches, down, across)
    seen = th.from_numpy(np.stack([levels[3, 2], levels[1, 0, :, :, ::-1]]).astype(np.float32))
    padded = functional.unfold(contrast(seen), 8, stride=4, padding=2)
    expected = padded.transpose(1, 2).reshape(len(patches), numbers).to(th.bfloat16)
    assert th.equal(th.from_numpy(patches).view(th.bfloat16), expected)
