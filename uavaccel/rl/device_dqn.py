"""Double DQN (van Hasselt et al., AAAI 2016) on one GPU: lanes, replay buffer and learner, a round as one CUDA graph.

decide     choose an action for each lane, greedy or random, and store it with the observation;
fly        let the lanes fly, on one stream;
learn      meanwhile, on another stream, sample batches and take gradient steps towards the target network's values;
store      add the results to the replay buffer, and write the games that ended to a log for the host;
schedule   lower exploration and learning rate with the games done, update the target network periodically.

The host launches rounds in chunks; while a chunk is flown, it reads the log of the one before and samples new games.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch.nn import functional

from uavaccel.clock import MonotonicClock
from uavaccel.envs.cuda_lanes import AT, CudaLanes
from uavaccel.envs.stopwatch import PHASES, Stopwatch
from uavaccel.files import Plain
from uavaccel.kernels.cuda import SideStream
from uavaccel.kernels.recording import recorded
from uavaccel.rl.agents import first_policy
from uavaccel.rl.config import DqnOptions, LearnerConfig
from uavaccel.rl.device_network import rate
from uavaccel.rl.device_replay import Cutter, DeviceReplay, Windows
from uavaccel.rl.learner import Game, LearnerState, falling, learning_rhythm
from uavaccel.rl.network import turned_actions
from uavaccel.rl.statistics import StepStatistics
from uavaccel.units import NS_PER_S

CHUNK = 8  # rounds that the host launches at once
COUNTERS = ("games", "rounds", "updates")


class DeviceDQN:
    """The learner for `simulator: kernels` with `device: cuda`; its `policy` is like that of DoubleDQN."""

    def __init__(self, config: LearnerConfig, lanes: CudaLanes) -> None:
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # cuBLAS is not deterministic without it
        th.use_deterministic_algorithms(True)
        th.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
        th.backends.cudnn.deterministic, th.backends.cudnn.benchmark = True, False
        self.config, self.lanes, self.options = config, lanes, DqnOptions.of(config)
        self.device = lanes.device
        th.manual_seed(config.seed)
        self.policy: Any = first_policy(config, lambda _: self.options.learning_rate).to(self.device)
        self._make_rates_tensors()
        self._allocate()
        self.games = self.rounds = self.updates = 0
        self.returns: list[float] = []
        self.holding = False
        self.statistics = StepStatistics(self.device)
        self.stopwatch = Stopwatch(MonotonicClock())
        self._recorded: dict[tuple[bool, bool, bool], Callable[[], None]] = {}
        self._learning_stream = SideStream(priority=-1)  # its small kernels go before the large ones of rendering
        self._unread: deque[tuple[Any, ...]] = deque()
        self._clock = MonotonicClock()

    def _make_rates_tensors(self) -> None:
        for group in self.policy.optimizer.param_groups:
            group["lr"] = th.tensor(float(group["lr"]), device=self.device)

    def _allocate(self) -> None:
        lanes, options = self.lanes, self.options
        shape = tuple(lanes.observations.shape[1:])
        rows = max(options.buffer_size // lanes.count, options.n_steps + 2)
        self.replay = DeviceReplay(rows, lanes.count, shape, lanes.observations.dtype, self.device)
        self._cut = Cutter(shape, self.device)  # type: ignore[arg-type]
        self._zeros = th.zeros(lanes.count, dtype=th.int64, device=self.device)
        self._lane_numbers = th.arange(lanes.count, device=self.device)
        headings = self.config.task.headings_deg
        turned = turned_actions(headings) if self.config.mirror else list(range(len(headings)))
        self._turned = th.tensor(turned, device=self.device)
        self._done = th.zeros((), dtype=th.float64, device=self.device)  # games so far
        self._epsilon = th.ones((), device=self.device)
        self._log = th.zeros((CHUNK, lanes.count, AT.columns), dtype=th.float64, device=self.device)
        self._line = th.zeros(1, dtype=th.int64, device=self.device)

    @property
    def exploration_rate(self) -> float:
        """Share of random actions."""
        return self.options.exploration_rate(1.0 - self.games / self.config.games)

    @property
    def at_rest(self) -> bool:
        """Whether a checkpoint can be taken: the host has read all rounds that were flown."""
        return not self._unread

    # --- rounds -----------------------------------------------------------------------------------

    def begin(self) -> None:
        """See `Learner`; also sample the games after the first."""
        if not self.lanes.has_begun:
            self.lanes.begin()
            self.lanes.games.refill([1] * self.lanes.count)

    def advance(self) -> list[Game]:
        """Launch a chunk of rounds, and return the games that ended in the one before."""
        self.begin()
        if not self.holding:
            self._launch()
        if len(self._unread) < 2 and not self.holding:
            return []
        return self._read_chunk() if self._unread else []

    def _launch(self) -> None:
        begun_ns = self._clock.now_ns()
        for _ in range(CHUNK):
            self._round(self._kind())
        log = self._log.to("cpu", non_blocking=True, copy=True)
        begun = self.lanes.games.begun.to("cpu", non_blocking=True, copy=True)
        sums = self.statistics.sums.to("cpu", non_blocking=True, copy=True)
        read = th.cuda.Event()
        read.record()
        self._unread.append((read, log, begun, sums, begun_ns))

    def _kind(self) -> tuple[bool, bool, bool]:
        """Return whether the next round acts at random, takes gradient steps, and updates the target network."""
        commands, options = self.rounds * self.lanes.count, self.options
        every, _ = learning_rhythm(self.config.commands_per_gradient_step, self.lanes.count)
        enough = commands > options.learning_starts and self.rounds > options.n_steps
        follows = self.rounds % max(options.target_update_interval // self.lanes.count, 1) == 0
        at_random = self.config.start_from is None and not enough
        return at_random, enough and self.rounds % every == 0, enough and follows

    def _round(self, kind: tuple[bool, bool, bool]) -> None:
        """Fly a round; each kind is recorded as a graph of its own."""
        self.rounds += 1
        if kind not in self._recorded:
            self._recorded[kind] = recorded(lambda: self._work(*kind), self.device)
        self._recorded[kind]()

    def _work(self, at_random: bool, learns: bool, follows: bool) -> None:
        """Do all work of a round, as the module describes it."""
        actions = self._decide(at_random)
        flown = self.lanes.going.clone()
        self.replay.start_round(self.lanes.observations, actions)
        if learns:
            with self._learning_stream.following():
                self._learn()
        self.lanes.fly(actions)
        if learns:
            self._learning_stream.join()
        self._charge(flown, learns)
        self.replay.end_round(self.lanes.rewards, self.lanes.terminated, self.lanes.truncated, flown)
        self._schedule()
        if follows:
            pairs = zip(self.policy.q_net.parameters(), self.policy.q_net_target.parameters(), strict=True)
            for online, target in pairs:
                target.data.copy_(online.data)

    def _charge(self, flown: th.Tensor, learns: bool) -> None:
        """In timing `virtual`, charge each lane for its next decision and for its share of the gradient steps."""
        self.lanes.charge(flown, self.config.inference_s, "inference")
        if learns:
            _, steps = learning_rhythm(self.config.commands_per_gradient_step, self.lanes.count)
            self.lanes.charge(flown, steps / self.lanes.count * self.config.learning_s, "learning")

    @th.no_grad()
    def _decide(self, at_random: bool) -> th.Tensor:
        """Return an action for each lane (L,)."""
        count, actions = self.lanes.count, len(self._turned)
        drawn = (th.rand(count, device=self.device) * actions).long().clamp(max=actions - 1)
        if at_random:
            return drawn
        ring = self.lanes.observations[None]
        patches = self._cut(ring, self._zeros, self._lane_numbers, self._zeros)
        greedy = rate(self.policy.q_net, patches, self._cut.down, self._cut.across).argmax(1)
        return th.where(th.rand(count, device=self.device) < self._epsilon, drawn, greedy)

    # --- learn ------------------------------------------------------------------------------------

    def _learn(self) -> None:
        """Take the gradient steps of a round, on batches that are sampled together."""
        options, size = self.options, self.options.batch_size
        _, steps = learning_rhythm(self.config.commands_per_gradient_step, self.lanes.count)
        drawn = self.replay.sample(steps * size, options.n_steps, options.gamma, self.config.mirror)
        for first in range(0, steps * size, size):
            self._descend(Windows(*(each[first : first + size] for each in drawn)))

    def _descend(self, batch: Windows) -> None:
        """Take one gradient step on the Huber loss between the online network's values and the targets."""
        seen = self._cut(self.replay.observations, batch.row, batch.lane, batch.mirrored)
        after = self._cut(self.replay.observations, batch.after, batch.lane, batch.mirrored)
        targets = self.targets(batch, after)
        actions = th.where(batch.mirrored, self._turned[batch.actions], batch.actions)
        chosen = self._rate(self.policy.q_net, seen).gather(1, actions[:, None])[:, 0]
        loss = (functional.smooth_l1_loss(chosen, targets, reduction="none") * batch.weights).mean()
        self.statistics.add(loss, chosen)
        self.policy.optimizer.zero_grad(set_to_none=False)
        loss.backward()
        th.nn.utils.clip_grad_norm_(self.policy.parameters(), self.options.max_grad_norm)
        self.policy.optimizer.step()

    @th.no_grad()
    def targets(self, batch: Windows, after: th.Tensor) -> th.Tensor:
        """Return the targets (n,): n-step rewards plus the target network's value of the online network's choice."""
        best = self._rate(self.policy.q_net, after).argmax(1, keepdim=True)
        rating = self._rate(self.policy.q_net_target, after).gather(1, best)[:, 0]
        return batch.rewards + batch.discounts * rating

    def _rate(self, network: Any, patches: th.Tensor) -> th.Tensor:
        return rate(network, patches, self._cut.down, self._cut.across)

    # --- schedule, and the host's part ----------------------------------------------------------

    def _schedule(self) -> None:
        options, config = self.options, self.config
        self._log.index_copy_(0, self._line, self.lanes.ended[None])
        self._line.copy_((self._line + 1) % CHUNK)
        self._done += self.lanes.ended[:, AT.over].sum()
        done = (self._done / config.games).clamp(max=1.0)
        fall = (options.exploration_final_eps - options.exploration_initial_eps) / options.exploration_fraction
        epsilon = options.exploration_initial_eps + done * fall
        over = done > options.exploration_fraction
        self._epsilon.copy_(th.where(over, options.exploration_final_eps, epsilon))
        rate_now = falling(options.learning_rate, config.final_learning_rate_share, 1.0 - done)  # type: ignore[arg-type]
        for group in self.policy.optimizer.param_groups:
            # Games beyond the configured number must not change the weights.
            group["lr"].copy_(th.where(done >= 1.0, 0.0, rate_now))

    def _read_chunk(self) -> list[Game]:
        """Wait for the oldest chunk, sample new games, and return those that ended, up to the configured number."""
        read, log, begun, sums, begun_ns = self._unread.popleft()
        read.synchronize()
        self.statistics.read(sums)
        over = log[..., AT.over].numpy()
        games = []
        spent_s = (self._clock.now_ns() - begun_ns) / NS_PER_S
        for line, lane in np.argwhere(over).tolist():
            if self.games >= self.config.games:
                break
            outcome = log[line, lane].tolist()
            info = self.lanes.info(lane, outcome) | {"host_phase_s": dict.fromkeys(PHASES, 0.0)}
            learned = self.statistics.loss, self.statistics.mean_q
            games.append(Game(self.games, lane, info, outcome[AT.reward], self.exploration_rate, *learned))
            self.games += 1
        if games:
            share_s = spent_s / len(games)
            for game in games:
                game.info["host_phase_s"]["simulation"] = share_s
        self.lanes.games.refill(begun.tolist())
        return games

    # --- saving ----------------------------------------------------------------------

    def get_state(self) -> LearnerState:
        """Return networks, optimizer, ring and counters; a checkpoint saves the lanes' generators."""
        tensors = {
            "policy": self.policy.state_dict(),
            "optimizer": self.policy.optimizer.state_dict(),
            "torch": th.get_rng_state(),
            "schedule": {"done": self._done, "epsilon": self._epsilon},
        }
        counters: dict[str, Plain] = {name: getattr(self, name) for name in COUNTERS}
        counters["statistics"] = self.statistics.get_state()
        return LearnerState(tensors, self.replay.get_state(), counters)

    def set_state(self, state: LearnerState, observations: NDArray[Any]) -> None:
        """Restore a state that `get_state` returned; `observations` are restored with the lanes."""
        self.policy.load_state_dict(state.tensors["policy"])
        self.policy.optimizer.load_state_dict(state.tensors["optimizer"])
        self._make_rates_tensors()
        th.set_rng_state(state.tensors["torch"].cpu())
        self._done.copy_(state.tensors["schedule"]["done"])
        self._epsilon.copy_(state.tensors["schedule"]["epsilon"])
        self.replay.set_state(state.arrays)
        self.statistics.set_state(state.counters.get("statistics"))
        for name in COUNTERS:
            setattr(self, name, state.counters[name])
