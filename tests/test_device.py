"""Lanes, batches and the learner of one GPU, on the CPU: games, observations and ends are those of the CPU's batch."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from copy import deepcopy
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch as th
from torch.nn import functional

import uavaccel.envs  # noqa: F401 - registers
from tests.gpu_threads import Numbers, Twice, kernels_in_python
from tests.host_kernels import host_kernels  # noqa: F401 - a fixture
from uavaccel.config import validate
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.kernel_games import GameMaker
from uavaccel.envs.navigate import Navigate
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.errors import UserError
from uavaccel.kernels.recording import recorded
from uavaccel.rl.double_dqn import DeviceDQN
from uavaccel.rl.learner import Game
from uavaccel.rl.network import QNetwork
from uavaccel.rl.policy import weights_sha256
from uavaccel.suites.train import TrainConfig


def test_no_graph_is_replayed_before_its_recording_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """Recording goes on on a stream of its own, where PyTorch resets the random numbers that a replay draws."""
    said: list[str] = []

    @contextmanager
    def graph(_: object, stream: object) -> Iterator[None]:
        said.append("record")
        yield
        said.append("end")

    monkeypatch.setattr(th.cuda, "CUDAGraph", type("Graph", (), {"replay": lambda _: said.append("replay")}))
    monkeypatch.setattr(th.cuda, "graph", graph)
    monkeypatch.setattr(th.cuda, "Stream", lambda priority: None)
    monkeypatch.setattr(th.cuda, "synchronize", lambda: said.append("wait"))
    work = recorded(lambda: said.append("work"), th.device("cuda"))
    for _ in range(4):
        work()
    assert " ".join(said) == "work work wait record work end wait replay replay"


@pytest.mark.usefixtures("host_kernels")
def test_resets_take_options_and_actions_are_looked_at() -> None:
    from uavaccel.envs.cuda_batch import CudaBatch

    keys: Any = {"observation": "state", "max_commands": 1, "autoreset_mode": "SameStep"}
    with closing(CudaBatch(ObstacleLane, 2, **keys)) as batch, closing(KernelBatch(ObstacleLane, 2, **keys)) as cores:
        with pytest.raises(UserError, match=r"^reset the environments before their first step$"):
            batch.step([2, 2])
        flown = []
        for each in (batch, cores, batch):
            each.reset(seed=3, options={"lane": 7})
            infos = [each.step([2, 2])[4] for _ in range(3)]
            flown.append([told["final_info"]["lane"].tolist() for told in infos])
        assert flown[0] == flown[1] == flown[2]
        assert flown[0][0] == [7, 7] != flown[0][1]  # of the next game nothing is given
        for wrong in ([2, 5], [2], [2.0, 2.0], np.array([-1, 0])):
            with pytest.raises(UserError, match=r"^actions .* are not in the action space"):
                batch.step(wrong)
    with pytest.raises(UserError, match=r"^autoreset_mode: with device = cuda it is SameStep$"):
        CudaBatch(ObstacleLane, 2, observation="state", autoreset_mode="NextStep")


@pytest.mark.usefixtures("host_kernels")
@pytest.mark.parametrize("sampled", [{}, {"randomise": {"wind_m_s": [0, 6], "widen_over_games": 9}}])
def test_a_batch_that_goes_back_to_a_state_flies_the_same_games_again(sampled: dict[str, Any]) -> None:
    """Games of one command: by then the host has sampled others ahead."""
    from uavaccel.envs.cuda_batch import CudaBatch

    with closing(CudaBatch(ObstacleLane, 2, observation="state", max_commands=1, **sampled)) as batch:
        batch.reset(seed=0)
        batch.step([2, 2])
        states, flown = deepcopy(batch.get_states()), []
        for _ in range(2):
            flown.append([batch.step([2, 3])[4]["final_info"]["lane"].tolist() for _ in range(9)])
            batch.set_states(states)
    assert flown[0] == flown[1]


@pytest.mark.usefixtures("host_kernels")
@pytest.mark.parametrize(
    ("kind", "wrong", "clipped", "right"),
    [
        (ObstacleLane, [-1, 9], [0, 4], [2, 3]),
        (Navigate, [[-9.0, 1.0, 0.0], [0.0, math.nan, 2.0]], [[-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [[0.5] * 3] * 2),
    ],
)
def test_wrong_actions_on_the_device_are_clipped_and_told_once_two_steps_later(
    kind: Any, wrong: list[Any], clipped: list[Any], right: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cuda_batch := import_module("uavaccel.envs.cuda_batch"), "FAR_BEHIND", 2)
    told, both = [], [cuda_batch.CudaBatch(kind, 2, observation="state") for _ in range(2)]
    both[0]._actions.waits = False
    for step in range(18):
        if step in (0, 9):  # a reset knows nothing of what was wrong before it
            np.testing.assert_array_equal(*(each.reset(seed=step)[0] for each in both))
        is_wrong = step in (1, 4, 5, 8)
        actions = th.tensor(wrong if is_wrong else right)
        both[1].step(th.tensor(clipped if is_wrong else right))
        try:
            both[0].step(actions.tolist() if step == 2 else actions)  # which the host looks at at once
        except UserError:
            told.append(step)
        np.testing.assert_array_equal(*(each._lanes.observations for each in both))
    assert told == [3, 6, 7]


SHORT: dict[str, Any] = {"t_move_s": 0.02, "t_sample_s": 0.02, "max_commands": 1}
SMALL: dict[str, Any] = {**SHORT, "picture_size": [17, 16], "clutter": {"shapes": 6}, "observation": "colour"}
RESTING = {"dvs_preset": "command_line", "t_move_s": 0.002, "t_sample_s": 0.002, "observation": "dvs"}


@pytest.mark.slow
@pytest.mark.usefixtures("host_kernels")
def test_threads_of_a_gpu_make_what_the_host_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """In Python, each kernel of the first case that launches it; one pixel in fifty may be another at an edge."""
    compared: Counter[str] = Counter()
    for kind, keys in (
        (Navigate, {**SMALL, **RESTING, "dvs_shot_noise_hz": 900.0, "image_noise": 12.0}),
        (Navigate, {**SMALL, "image_noise": 3.0}),
        (Navigate, {**SMALL, "observation": "depth", "picture_size": [256, 144]}),
        (ObstacleLane, SHORT),
        (ObstacleLane, {**SHORT, "observation": "colour", "image_noise": 2.0}),
        (ObstacleLane, {**SHORT, "observation": "depth"}),
    ):
        known = {name for name, count in compared.items() if count > 30}
        twice = Twice(GameMaker(kind(**keys).task).nominal, keys.get("picture_size") != [17, 16], known)
        with monkeypatch.context() as patch:
            twice.put_into(patch)
            with closing(import_module("uavaccel.envs.cuda_batch").CudaBatch(kind, 2, **keys)) as batch:
                batch.reset(seed=0)
                batch.step(batch.action_space.sample() if kind is Navigate else [1, 3])
        compared += twice.compared
    every = "fly deal_clutter cast_gray cast_colour cast_depth start_events see_gray take_frames draw_gray see show"
    assert min(compared[name] for name in every.split()) > 30, compared


@pytest.mark.parametrize("threads", [1, 4, 32])
def test_the_threads_of_a_lane_share_what_one_of_them_has_found(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The least distance, and the deepest solid, on a tie the later one; threads of other lanes have their own."""
    (gpu, names), random = kernels_in_python(), np.random.default_rng(0)
    monkeypatch.setattr(th.cuda, "get_device_properties", lambda _: SimpleNamespace(multi_processor_count=16))
    most = 16 * names["FLYING_WARPS"] * 32 // threads  # lanes for which a GPU has so many
    assert [names["threads_a_lane"](most + more, None) for more in (0, 1)] == [threads, max(threads // 2, 1)]
    found, depth_m = random.permutation(32), random.integers(4, size=32).astype(float)
    depths, solids = np.zeros(32), np.zeros(32, int)

    def share() -> None:
        thread = gpu.threadIdx.x
        depths[thread] = names["least_of_all"](depth_m[thread], threads)
        solids[thread] = names["deepest_of_all"](found[thread], depth_m[thread], threads)

    gpu.launch(share, [0], 32, range(32), ())
    lanes = np.arange(32).reshape(-1, threads)
    assert depths.tolist() == depth_m[lanes].min(1).repeat(threads).tolist()
    deepest = [max(found[lane][depth_m[lane] == depth_m[lane].min()]) for lane in lanes]
    assert solids.tolist() == np.repeat(deepest, threads).tolist()


def test_make_vec_says_which_simulator_flies() -> None:
    for name in ("ObstacleLane", "Hover", "Gates", "Navigate"):
        made: Any = gymnasium.make_vec(f"uavaccel/{name}-v0", num_envs=2, simulator="kernels")
        with closing(made) as batch:
            assert isinstance(batch, KernelBatch)


# --- the learner beside them, rounds as they are, none of them recorded ---------------------------------------------

LEARNING_LANES = 2
LEARNING: dict[str, Any] = {
    "games": 8,
    "environments": LEARNING_LANES,
    "simulator": "kernels",
    "channels": [4, 4],
    "hidden": [16],
    "commands_per_gradient_step": 2,
    "options": {"learning_starts": 6, "batch_size": 4, "buffer_size": 60, "target_update_interval": 8, "n_steps": 1},
    "task": {"timing": "virtual", "command": "adsc", "clock_speed": 20.0, "max_commands": 6},
}


def unfolded(sight: Any, ring: th.Tensor, row: th.Tensor, lane: th.Tensor, mirrored: th.Tensor) -> th.Tensor:
    """Patches (n, places, numbers) of what a ring shows, turned round where it is to be mirrored."""
    from uavaccel.rl.patches import KERNEL, PADDING, STRIDE, spread_levels

    seen = spread_levels(ring.device)[ring[row, lane].long()].view(th.bfloat16).float()
    turned = th.where(mirrored.bool()[:, None, None, None], seen.flip(-1), seen)
    return functional.unfold(turned, KERNEL, padding=PADDING, stride=STRIDE).transpose(1, 2)


@pytest.mark.filterwarnings("ignore:.*CUDA is not available:UserWarning")
@pytest.mark.usefixtures("host_kernels")
def test_patches_hold_what_the_first_convolution_sees(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a GPU's threads cut them, in Python, up to the edges; the network rates them as the pictures themselves."""
    patches, (gpu, _) = import_module("uavaccel.rl.patches"), kernels_in_python()
    for name, value in {
        "cuda": gpu,
        "np": Numbers("numpy"),
        "grid": lambda threads, each: (-(-threads // each), each),
    }.items():
        monkeypatch.setattr(patches, name, value)
    sight = patches.Patches((2, 12, 16), th.device("cpu"))
    cut: Any = sight._kernel

    class Kernel:
        def __getitem__(self, grid: Any) -> Any:
            return lambda *arguments: gpu.launch(cut, range(grid[0]), grid[1], range(grid[1]), arguments)

    sight._kernel, random = Kernel(), th.Generator().manual_seed(0)
    ring = th.randint(256, (3, 2, 2, 12, 16), dtype=th.uint8, generator=random)
    row, lane, mirrored = th.tensor([2, 0, 1, 2]), th.tensor([0, 1, 0, 1]), th.tensor([False, True, True, False])
    found = sight.look(ring, row, lane, mirrored).float()
    wanted = unfolded(sight, ring, row, lane, mirrored)
    assert th.equal(found.view(wanted.shape), wanted)
    network, seen = QNetwork((2, 12, 16), 5, [4, 3], [16]), ring[row, lane]
    seen[mirrored] = seen[mirrored].flip(-1)
    th.testing.assert_close(sight.rate(network, found), network(seen), rtol=0.0, atol=2e-3)


@pytest.fixture
def at_once(host_kernels: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:  # noqa: F811
    from uavaccel.rl.patches import Patches

    monkeypatch.setattr(Patches, "look", unfolded)
    yield
    th.use_deterministic_algorithms(False)


def learner_of(config: TrainConfig) -> Any:
    from uavaccel.envs.cuda_lanes import CudaLanes

    learner = DeviceDQN(config, CudaLanes(config.task, LEARNING_LANES, th.device("cpu")))
    learner.lanes.games.seed(3)
    return learner


def learn(learner: Any, games: int) -> list[Game]:
    """Until so many games are over, and it is at rest."""
    ended: list[Game] = []
    learner.holding = False
    while learner.games < games or not learner.at_rest:
        learner.holding = learner.games >= games
        ended += learner.advance()
    return ended


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*CUDA is not available:UserWarning")
@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize(
    "seen",
    [{}, {"observation": "state"}, {"observation": "depth", "also_state": True}],
    ids=["events", "state", "both"],
)
def test_a_learner_goes_on_from_a_checkpoint_to_the_same_weights(seen: dict[str, Any]) -> None:
    config = validate(TrainConfig, {**LEARNING, "task": {**LEARNING["task"], **seen}, "mirror": not seen}, "test")
    learner = learner_of(config)
    first = weights_sha256(learner.policy)
    games = learn(learner, 1)
    assert learner.lanes.going.any(), "in the middle of games"
    saved = (
        deepcopy(learner.get_state()),  # whose tensors are the learner's own
        [{name: np.array(value) for name, value in each.items()} for each in learner.lanes.get_states()],
    )
    games += learn(learner, 8)
    assert [game.number for game in games] == list(range(8))
    spent_s = [[game.info["phase_s"][phase] for game in games] for phase in ("inference", "learning")]
    np.testing.assert_allclose(spent_s[0], np.array([5, 5, *[6] * 6]) * config.inference_s)
    np.testing.assert_allclose(spent_s[1], np.array([1, 1, *[6] * 6]) * config.learning_s / 2)  # from round 5 on
    assert weights_sha256(learner.policy) != first

    other = learner_of(config.model_copy(update={"seed": 1}))
    other.config = config
    other.set_state(saved[0], other.lanes.set_states(saved[1]))
    again = learn(other, 8)
    assert len(again) > 1
    assert [(game.number, game.lane, game.reward) for game in again] == [
        (game.number, game.lane, game.reward) for game in games[-len(again) :]
    ]
    assert weights_sha256(other.policy) == weights_sha256(learner.policy)
