"""Double DQN on one GPU: lanes, replay buffer and learner there, a round of all lanes recorded as one CUDA graph.

decide     a number for each lane, greedy or at random, and what it sees goes into the ring;
fly        the lanes fly, see and are judged, on one stream,
learn      and on another batches are drawn, and the online network steps towards the target network's rating;
note       what the round brought goes into the ring, games that ended are written down for the host;
schedule   exploration and learning rate fall with the games done, the target network follows now and then.

The host launches rounds in chunks, and draws new games and keeps rows while the next chunk is flown.
"""

from __future__ import annotations

import os
import random
from collections import deque
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch.nn import functional

from uavaccel.clock import MonotonicClock
from uavaccel.envs.cuda_lanes import AT, CudaLanes
from uavaccel.envs.stopwatch import PHASES, Stopwatch
from uavaccel.kernels.cuda import Recorded, SideStream
from uavaccel.rl.agents import first_policy
from uavaccel.rl.config import DqnOptions, LearnerConfig
from uavaccel.rl.device_network import rate
from uavaccel.rl.device_replay import Cutter, DeviceReplay, Windows
from uavaccel.rl.learner import Game, LearnerState, falling, learning_rhythm
from uavaccel.rl.network import turned_actions
from uavaccel.units import NS_PER_S

CHUNK = 8  # rounds between two looks of the host
COUNTERS = ("games", "rounds", "updates")


class DeviceDQN:
    """The learner of `simulator: kernels` with `device: cuda`; `policy` holds networks and optimizer as DoubleDQN's."""

    def __init__(self, config: LearnerConfig, lanes: CudaLanes) -> None:
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # without it cuBLAS is not repeatable
        th.use_deterministic_algorithms(True)
        th.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
        th.backends.cudnn.deterministic, th.backends.cudnn.benchmark = True, False
        self.config, self.lanes, self.options = config, lanes, DqnOptions.of(config)
        self.device = lanes.device
        random.seed(config.seed)
        th.manual_seed(config.seed)
        self.policy: Any = first_policy(config, lambda _: self.options.learning_rate).to(self.device)
        self._let_rates_be_tensors()
        self._allocate()
        self.games = self.rounds = self.updates = 0
        self.returns: list[float] = []
        self.holding = False
        self.stopwatch = Stopwatch(MonotonicClock())
        self._works: dict[tuple[bool, bool, bool], Recorded] = {}
        self._learning = SideStream(
            priority=-1
        )  # its small kernels go before the next of a thousand pictures'
        self._unread: deque[tuple[Any, ...]] = deque()
        self._clock = MonotonicClock()

    def _let_rates_be_tensors(self) -> None:
        for group in self.policy.optimizer.param_groups:
            group["lr"] = th.tensor(float(group["lr"]), device=self.device)

    def _allocate(self) -> None:
        lanes, options = self.lanes, self.options
        shape = tuple(lanes.observations.shape[1:])
        rows = max(options.buffer_size // lanes.count, options.n_steps + 2)
        self.replay = DeviceReplay(rows, lanes.count, shape, lanes.observations.dtype, self.device)
        self._cut = Cutter(shape, self.device)  # type: ignore[arg-type]
        self._none = th.zeros(lanes.count, dtype=th.int64, device=self.device)
        self._each = th.arange(lanes.count, device=self.device)
        headings = self.config.task.headings_deg
        turned = turned_actions(headings) if self.config.mirror else list(range(len(headings)))
        self._turned = th.tensor(turned, device=self.device)
        self._done = th.zeros((), dtype=th.float64, device=self.device)  # games so far
        self._epsilon = th.ones((), device=self.device)
        self._log = th.zeros((CHUNK, lanes.count, AT.columns), dtype=th.float64, device=self.device)
        self._line = th.zeros(1, dtype=th.int64, device=self.device)

    @property
    def exploration_rate(self) -> float:
        return self.options.exploration_rate(1.0 - self.games / self.config.games)

    @property
    def at_rest(self) -> bool:
        """Whether a checkpoint can be taken: nothing has been flown that the host has not read."""
        return not self._unread

    # --- rounds -----------------------------------------------------------------------------------

    def begin(self) -> None:
        """See `Learner`; the games that follow the first ones are drawn too."""
        if not self.lanes.begun_yet:
            self.lanes.begin()
            self.lanes.games.refill([1] * self.lanes.count)

    def advance(self) -> list[Game]:
        """A chunk of rounds is launched, and the one before is read: the games that ended in it."""
        self.begin()
        if not self.holding:
            self._launch()
        if len(self._unread) < 2 and not self.holding:
            return []
        return self._read() if self._unread else []

    def _launch(self) -> None:
        begun_ns = self._clock.now_ns()
        for _ in range(CHUNK):
            self._round(self._kind())
        log = self._log.to("cpu", non_blocking=True, copy=True)
        begun = self.lanes.games.begun.to("cpu", non_blocking=True, copy=True)
        read = th.cuda.Event()
        read.record()
        self._unread.append((read, log, begun, begun_ns))

    def _kind(self) -> tuple[bool, bool, bool]:
        """Whether the next round explores at random, learns, and lets the target network follow."""
        commands, options = self.rounds * self.lanes.count, self.options
        every, _ = learning_rhythm(self.config.commands_per_gradient_step, self.lanes.count)
        enough = commands > options.learning_starts and self.rounds > options.n_steps
        follows = self.rounds % max(options.target_update_interval // self.lanes.count, 1) == 0
        unknowing = self.config.start_from is None and not enough
        return unknowing, enough and self.rounds % every == 0, enough and follows

    def _round(self, kind: tuple[bool, bool, bool]) -> None:
        """A round of its kind, each of which is recorded."""
        self.rounds += 1
        if kind not in self._works:
            self._works[kind] = Recorded(lambda: self._work(*kind))
        self._works[kind]()

    def _work(self, unknowing: bool, learns: bool, follows: bool) -> None:
        actions = self._decide(unknowing)
        flown = self.lanes.going.clone()
        self.replay.decide(self.lanes.observations, actions)
        if learns:
            with self._learning.following():
                self._learn()
        self.lanes.fly(actions)
        if learns:
            self._learning.join()
        self._charge(flown, learns)
        self.replay.note(self.lanes.rewards, self.lanes.terminated, self.lanes.truncated, flown)
        self._schedule()
        if follows:
            pairs = zip(self.policy.q_net.parameters(), self.policy.q_net_target.parameters(), strict=True)
            for online, target in pairs:
                target.data.copy_(online.data)

    def _charge(self, flown: th.Tensor, learns: bool) -> None:
        """In `virtual` each lane pays for its next decision, and for the gradient steps that its commands cause."""
        self.lanes.charge(flown, self.config.inference_s, "inference")
        if learns:
            _, steps = learning_rhythm(self.config.commands_per_gradient_step, self.lanes.count)
            self.lanes.charge(flown, steps / self.lanes.count * self.config.learning_s, "learning")

    @th.no_grad()
    def _decide(self, unknowing: bool) -> th.Tensor:
        """An action for each lane (L,)."""
        count, actions = self.lanes.count, len(self._turned)
        drawn = (th.rand(count, device=self.device) * actions).long().clamp(max=actions - 1)
        if unknowing:
            return drawn
        ring = self.lanes.observations[None]
        patches = self._cut(ring, self._none, self._each, self._none)
        greedy = rate(self.policy.q_net, patches, self._cut.down, self._cut.across).argmax(1)
        return th.where(th.rand(count, device=self.device) < self._epsilon, drawn, greedy)

    # --- learn ------------------------------------------------------------------------------------

    def _learn(self) -> None:
        """The gradient steps of a round, on batches drawn together."""
        options, size = self.options, self.options.batch_size
        _, steps = learning_rhythm(self.config.commands_per_gradient_step, self.lanes.count)
        drawn = self.replay.draw(steps * size, options.n_steps, options.gamma, self.config.mirror)
        for first in range(0, steps * size, size):
            self._descend(Windows(*(each[first : first + size] for each in drawn)))

    def _descend(self, batch: Windows) -> None:
        """One step of the online network towards the targets, by Huber's loss."""
        seen = self._cut(self.replay.observations, batch.row, batch.lane, batch.mirrored)
        after = self._cut(self.replay.observations, batch.after, batch.lane, batch.mirrored)
        targets = self.targets(batch, after)
        actions = th.where(batch.mirrored, self._turned[batch.actions], batch.actions)
        chosen = self._rate(self.policy.q_net, seen).gather(1, actions[:, None])[:, 0]
        loss = (functional.smooth_l1_loss(chosen, targets, reduction="none") * batch.weights).mean()
        self.policy.optimizer.zero_grad(set_to_none=False)
        loss.backward()
        th.nn.utils.clip_grad_norm_(self.policy.parameters(), self.options.max_grad_norm)
        self.policy.optimizer.step()

    @th.no_grad()
    def targets(self, batch: Windows, after: th.Tensor) -> th.Tensor:
        """Rewards (n,) plus the discounted rating of what the online network would do next."""
        best = self._rate(self.policy.q_net, after).argmax(1, keepdim=True)
        rating = self._rate(self.policy.q_net_target, after).gather(1, best)[:, 0]
        return batch.rewards + batch.discounts * rating

    def _rate(self, network: Any, patches: th.Tensor) -> th.Tensor:
        return rate(network, patches, self._cut.down, self._cut.across)

    # --- schedule, and what the host reads ----------------------------------------------------------

    def _schedule(self) -> None:
        options, config = self.options, self.config
        self._log.index_copy_(0, self._line, self.lanes.ended[None])
        self._line.copy_((self._line + 1) % CHUNK)
        self._done += self.lanes.ended[:, AT.over].sum()
        done = (self._done / config.games).clamp(max=1.0)
        fall = (
            options.exploration_final_eps - options.exploration_initial_eps
        ) / options.exploration_fraction
        epsilon = options.exploration_initial_eps + done * fall
        over = done > options.exploration_fraction
        self._epsilon.copy_(th.where(over, options.exploration_final_eps, epsilon))
        rate_now = falling(options.learning_rate, config.final_learning_rate_share, 1.0 - done)  # type: ignore[arg-type]
        for group in self.policy.optimizer.param_groups:
            group["lr"].copy_(
                th.where(done >= 1.0, 0.0, rate_now)
            )  # what is learned is of the games asked for

    def _read(self) -> list[Game]:
        """The games of the oldest chunk flown, up to as many as are wanted; new ones are drawn in their place."""
        read, log, begun, begun_ns = self._unread.popleft()
        read.synchronize()
        over = log[..., AT.over].numpy()
        games = []
        spent_s = (self._clock.now_ns() - begun_ns) / NS_PER_S
        for line, lane in np.argwhere(over).tolist():
            if self.games >= self.config.games:
                break
            told = log[line, lane].tolist()
            info = self.lanes.info(lane, told) | {"host_phase_s": dict.fromkeys(PHASES, 0.0)}
            games.append(Game(self.games, lane, info, told[AT.reward], self.exploration_rate))
            self.games += 1
        if games:
            share_s = spent_s / len(games)
            for game in games:
                game.info["host_phase_s"]["simulation"] = share_s
        self.lanes.games.refill(begun.tolist())
        return games

    # --- going on after a stop ----------------------------------------------------------------------

    def get_state(self) -> LearnerState:
        """Networks, optimizer, ring, counters; the generators are saved with the checkpoint."""
        tensors = {
            "policy": self.policy.state_dict(),
            "optimizer": self.policy.optimizer.state_dict(),
            "torch": th.get_rng_state(),
            "schedule": {"done": self._done, "epsilon": self._epsilon},
        }
        return LearnerState(
            tensors, self.replay.get_state(), {name: getattr(self, name) for name in COUNTERS}
        )

    def set_state(self, state: LearnerState, observations: NDArray[Any]) -> None:
        """Take what `get_state` gave; what the lanes show is with them."""
        self.policy.load_state_dict(state.tensors["policy"])
        self.policy.optimizer.load_state_dict(state.tensors["optimizer"])
        self._let_rates_be_tensors()
        th.set_rng_state(state.tensors["torch"].cpu())
        self._done.copy_(state.tensors["schedule"]["done"])
        self._epsilon.copy_(state.tensors["schedule"]["epsilon"])
        self.replay.set_state(state.arrays)
        for name in COUNTERS:
            setattr(self, name, state.counters[name])
