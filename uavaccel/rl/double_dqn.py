"""Double DQN (van Hasselt et al., AAAI 2016), on lanes flown by the host or together with it on one GPU.

decide     choose an action a for each lane: greedy, argmax Q(s, a), or with probability ε a random one;
fly        let the lanes fly, and meanwhile
learn      draw windows (s, a, r, s') of n commands from the replay buffer, and take gradient steps on the Huber loss of
           Q(s, a) to the target r + γ^n Q'(s', argmax Q(s', a));
store      add the results to the replay buffer;
schedule   lower ε and the learning rate with the games done, copy Q to the target network Q' now and then.

`HostDQN` flies lanes of the host in groups that take turns. `DeviceDQN` launches rounds, which are CUDA graphs, in
chunks; while a chunk is flown, it reads the log of the one before and samples new games. Mirrored windows are turned
left to right: on average the lane is symmetric.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch.nn import functional

from uavaccel.clock import MonotonicClock
from uavaccel.envs.arrays import assign, mapped, select
from uavaccel.envs.batch import TurnBatch
from uavaccel.envs.stopwatch import PHASES
from uavaccel.envs.values import Observation
from uavaccel.kernels.recording import recorded
from uavaccel.rl.agents import first_policy
from uavaccel.rl.config import DqnOptions, LearnerConfig
from uavaccel.rl.learner import (
    Game,
    Learner,
    LearnerState,
    StepStatistics,
    compute_the_same_each_time,
    falling,
    first_seed,
    learning_rhythm,
    plain_generator,
    set_generator,
)
from uavaccel.rl.network import Adam, Levels, Replay, Windows, turned_actions
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:
    from uavaccel.envs.cuda_lanes import CudaLanes

CHUNK = 8  # rounds that the host launches at once


class Prepared(NamedTuple):
    """A batch that can be learned from (n,): s as the network sees it, a, the target, and the loss's weights."""

    seen: Any
    actions: th.Tensor
    target: th.Tensor
    weights: th.Tensor


class DoubleDQN(Learner):
    """What is learned; `policy` holds Q as `q_net`, Q' as `q_net_target`."""

    counters: tuple[str, ...] = ("games", "updates", "returns")
    replay: Replay
    sight: Any  # Levels or Patches: how networks see observations

    def __init__(self, config: LearnerConfig, lanes: Any, device: th.device, recorded: bool) -> None:
        """Make the networks; with `recorded`, gradient steps are recorded as graphs, with the optimizer in them."""
        super().__init__(config, lanes)
        self.options, self.device, self._recorded = DqnOptions.of(config), device, recorded
        th.manual_seed(config.seed)
        self.policy = first_policy(config).to(device)
        parameters, rate = self.policy.q_net.parameters(), self.options.learning_rate
        self.optimizer = Adam(parameters, rate, fused=True, capturable=device.type == "cuda")
        self._make_rates_tensors()
        actions = range(int(config.task.action_space().n))
        turned = turned_actions(config.task.headings_deg) if config.mirror else list(actions)
        self._turned = th.tensor(turned, device=device)
        self.updates = 0
        self.statistics = StepStatistics(device)

    def _make_rates_tensors(self) -> None:
        """Let a graph read the learning rate where the schedule writes it."""
        for group in self.optimizer.param_groups if self._recorded else ():
            group["lr"] = th.tensor(float(group["lr"]), device=self.device)

    # --- a gradient step ---------------------------------------------------------------------------

    def _prepared(self, batch: Windows) -> Prepared:
        """Look at s and s', and compute the target r + γ^n Q'(s', argmax Q(s', a))."""
        ring, q = self.replay, self.policy
        seen = self.sight.look(ring.observations, batch.row, batch.lane, batch.mirrored)
        with th.no_grad():
            after = self.sight.look(ring.next_observations, batch.after, batch.lane, batch.mirrored)
            best = self.sight.rate(q.q_net, after).argmax(1, keepdim=True)
            value = self.sight.rate(q.q_net_target, after).gather(1, best)[:, 0]
        actions = th.where(batch.mirrored, self._turned[batch.actions], batch.actions)
        return Prepared(seen, actions, batch.rewards + batch.discounts * value, batch.weights)

    def _descend(self, batch: Prepared) -> None:
        """Take one gradient step of the online network on the Huber loss of Q(s, a) to the target."""
        chosen = self.sight.rate(self.policy.q_net, batch.seen).gather(1, batch.actions[:, None])[:, 0]
        loss = (functional.smooth_l1_loss(chosen, batch.target, reduction="none") * batch.weights).mean()
        self.statistics.add(loss, chosen)
        self.optimizer.zero_grad(set_to_none=False)
        loss.backward()
        th.nn.utils.clip_grad_norm_(self.policy.q_net.parameters(), self.options.max_grad_norm)
        self.optimizer.step()

    def _copy_to_target(self) -> None:
        pairs = zip(self.policy.q_net.parameters(), self.policy.q_net_target.parameters(), strict=True)
        for online, target in pairs:
            target.data.copy_(online.data)

    # --- going on after a stop ---------------------------------------------------------------------

    def get_state(self) -> LearnerState:
        """Return also replay buffer and statistics."""
        state = super().get_state()
        return LearnerState(
            state.tensors, self.replay.get_state(), {**state.counters, "statistics": self.statistics.get_state()}
        )

    def set_state(self, state: LearnerState, observations: Observation) -> None:
        """See `Learner`."""
        super().set_state(state, observations)
        self._make_rates_tensors()
        self.replay.set_state(state.arrays)
        self.statistics.set_state(state.counters["statistics"])


# --- lanes of the host -----------------------------------------------------------------------------------------


class HostDQN(DoubleDQN):
    """The learner of lanes on the host, with networks and replay buffer on any device.

    While all groups but one fly, it decides for that one and learns.
    """

    counters = (*DoubleDQN.counters, "commands", "steps", "owed", "exploration_rate")

    def __init__(self, config: LearnerConfig, lanes: TurnBatch) -> None:
        device = th.device(config.device)
        super().__init__(config, lanes, device, recorded=device.type == "cuda")
        self.random = np.random.RandomState(config.seed)
        self.space = lanes.single_action_space
        self.space.seed(config.seed)
        count = lanes.num_envs
        rows = max(self.options.buffer_size // count, 1)
        self.replay = Replay(rows, count, lanes.single_observation_space, self.device, keeps_ends=True)
        self.sight = Levels()
        self.observations: Observation = None
        self.groups: list[NDArray[np.int64]] = np.array_split(np.arange(count), config.turns)
        self._next = 0  # group whose command starts next
        self._flying: deque[int] = deque()
        self._actions, self._acted = np.zeros(count, np.int64), np.zeros(count, np.int64)
        self._charges = [0] * config.turns  # gradient steps that each group has yet to pay for
        self.commands = self.steps = self.owed = 0
        self.exploration_rate = 0.0
        self._rhythm = learning_rhythm(config.commands_per_gradient_step, count)
        self._parts: deque[Callable[[], None]] = deque()
        self._flights_left = 0
        self._step_as_graph: Callable[[], None] | None = None

    def begin(self) -> None:
        """See `Learner`."""
        if self.observations is None:
            self._see(self.lanes.reset(seed=first_seed(self.config.seed))[0])

    def _see(self, observations: Observation) -> None:
        """Make room for a round that begins with these observations (lanes, ...)."""
        count = self.lanes.num_envs
        self.observations, self._before, self._after = (mapped(np.array, observations) for _ in range(3))
        self._rewards, self._terminated, self._truncated = np.zeros(count), np.zeros(count, bool), np.zeros(count, bool)

    def advance(self) -> list[Game]:
        """Start a command in the next group, learn, and once all groups fly, wait for the first.

        Returns the games that ended with its commands. While `holding`, no new round of the groups begins.
        """
        self.begin()
        waits = self.holding and self._next == 0 and self._flying
        if not waits:
            self._start_command(self._next)
        self._learn_meanwhile()
        all_fly = len(self._flying) == len(self.groups)
        return self._finish_command(self._flying.popleft()) if all_fly or waits else []

    @property
    def at_rest(self) -> bool:
        """Whether a checkpoint can be taken: no gradient step is pending and no lane flies."""
        return self.steps % self._rhythm[0] == 0 and not self._parts and not self._flying

    def _start_command(self, group: int) -> None:
        lanes = self.groups[group]
        steps, self._charges[group] = self._charges[group], 0
        self.charge(steps / self.lanes.num_envs * self.config.learning_s, "learning", lanes)
        self._actions[lanes] = self._decide(lanes)
        self.lanes.step_async(self._actions[lanes], lanes.tolist())
        self._flying.append(group)
        self._next = (group + 1) % len(self.groups)

    def _decide(self, lanes: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return actions (n,) for a group's lanes (n,): with probability ε all of them at random."""
        with self.stopwatch.phase("inference"):
            untrained = self.config.start_from is None and self.commands < self.options.learning_starts
            if untrained or self.random.rand() < self.exploration_rate:
                return np.array([self.space.sample() for _ in lanes])
            with th.inference_mode():
                seen = mapped(self._on_device, select(self.observations, lanes))
                return np.asarray(self.policy.q_net(seen).argmax(dim=1).cpu())

    def _on_device(self, array: NDArray[Any]) -> th.Tensor:
        return th.from_numpy(array).to(self.device)

    def _finish_command(self, group: int) -> list[Game]:
        lanes = self.groups[group]
        seen, rewards, terminated, truncated, infos = self.lanes.step_wait(lanes.tolist())
        self.commands += len(lanes)
        games = self.finished(rewards, terminated | truncated, infos, lanes.tolist())
        if games:
            self.statistics.read(self.statistics.sums)
            games = [replace(game, loss=self.statistics.loss, mean_q=self.statistics.mean_q) for game in games]
        self.charge(self.config.inference_s, "inference", lanes)
        assign(self._before, lanes, select(self.observations, lanes))
        assign(self._after, lanes, seen)
        assign(self.observations, lanes, seen)
        self._acted[lanes] = self._actions[lanes]
        self._rewards[lanes], self._terminated[lanes], self._truncated[lanes] = rewards, terminated, truncated
        for lane, info in zip(lanes, infos, strict=True):
            if "final_obs" in info:  # `seen` is the next game's first observation
                assign(self._after, lane, info["final_obs"])
        if group == len(self.groups) - 1 and self.games < self.config.games:
            columns = (self._before, self._acted, self._after, self._rewards, self._terminated, self._truncated)
            before, actions, after, reward, lost, cut = mapped(self._on_device, columns)
            self.replay.start_round(before, actions)
            self.replay.end_round(reward, lost, cut & ~lost, th.ones_like(lost), after)
            self._schedule()
        return games

    def _schedule(self) -> None:
        options, remaining = self.options, 1.0 - self.games / self.config.games
        rate = falling(options.learning_rate, self.config.final_learning_rate_share, remaining)
        for group in self.optimizer.param_groups:
            group["lr"] = group["lr"].fill_(rate) if self._recorded else rate
        self.exploration_rate = options.exploration_rate(remaining)
        self.steps += 1
        if self.steps % max(options.target_update_interval // self.lanes.num_envs, 1) == 0:
            self._copy_to_target()
        due = self.steps % self._rhythm[0] == 0 and not self._parts
        if due and self.commands > options.learning_starts:
            self.owed += self._rhythm[1]
            self._charges = [self.owed] * len(self.groups)

    def _learn_meanwhile(self) -> None:
        """Take an equal part of the pending gradient steps, so that they are done before the next ones are due."""
        if self.owed and not self._parts:
            self._flights_left = self._rhythm[0] * len(self.groups)
            self._parts.extend([self._prepare_batch, self._step] * self.owed)
            if self.device.type == "cuda":  # where they are short, many to a part
                shares = np.diff(np.linspace(0, self.owed, self._flights_left + 1).round().astype(int))
                self._parts = deque(partial(self._steps_at_once, int(share)) for share in shares)
        if not self._parts:
            return
        with self.stopwatch.phase("learning"):
            for _ in range(math.ceil(len(self._parts) / self._flights_left)):
                self._parts.popleft()()
        self._flights_left -= 1
        if not self._parts:
            self.owed = 0

    def _sample(self, batches: int = 1) -> Windows:
        """Draw the windows of so many batches, half of each mirrored."""
        size, whole = self.options.batch_size, min(self.steps, self.replay.rows)
        rows = self.random.randint(0, whole, size=batches * size)
        drawn = np.stack([rows, self.random.randint(0, self.lanes.num_envs, size=batches * size)])
        row, lane = th.from_numpy(drawn).to(self.device)  # together: each transfer waits for all work of a GPU
        mirrored = th.arange(batches * size, device=self.device) % size < (size // 2 if self.config.mirror else 0)
        return self.replay.windows(row, lane, self.options.n_steps, self.options.gamma, mirrored)

    def _prepare_batch(self) -> None:
        self._batch = self._prepared(self._sample())

    def _step(self) -> None:
        self._descend(self._batch)
        self.updates += 1

    def _steps_at_once(self, steps: int) -> None:
        """Sample all batches at once and launch the recorded step for each, without waiting for the GPU."""
        if not steps:
            return
        for batch in self._sample(steps).split(self.options.batch_size):
            if self._step_as_graph is None:
                self._fixed = Windows(*(each.clone() for each in batch))
                self._step_as_graph = recorded(lambda: self._descend(self._prepared(self._fixed)), self.device)
            for here, there in zip(self._fixed, batch, strict=True):
                here.copy_(there)
            self._step_as_graph()
        self.updates += steps

    def get_state(self) -> LearnerState:
        state = super().get_state()
        state.counters["random"] = plain_generator(self.random)
        state.counters["actions"] = self.space.np_random.bit_generator.state
        return state

    def set_state(self, state: LearnerState, observations: Observation) -> None:
        super().set_state(state, observations)
        set_generator(self.random, state.counters["random"])
        self.space.np_random.bit_generator.state = state.counters["actions"]
        self._see(observations)
        self._charges = [self.owed] * len(self.groups)


# --- lanes on a GPU --------------------------------------------------------------------------------------------


class DeviceDQN(DoubleDQN):
    """The learner for `simulator: kernels` with `device: cuda`: all of a round is one CUDA graph."""

    counters = (*DoubleDQN.counters, "rounds")

    def __init__(self, config: LearnerConfig, lanes: CudaLanes) -> None:
        from uavaccel.envs.cuda_lanes import AT  # these need numba-cuda and a GPU
        from uavaccel.kernels.cuda import SideStream
        from uavaccel.rl.patches import Patches

        compute_the_same_each_time()
        super().__init__(config, lanes, lanes.device, recorded=True)
        lanes.games.seed(first_seed(config.seed))
        self._at, device, count = AT, lanes.device, lanes.count
        rows = max(self.options.buffer_size // count, self.options.n_steps + 2)
        self.replay = Replay(rows, count, config.task.observation_space(), device)
        seen = lanes.observations
        pictures = isinstance(seen, th.Tensor) and seen.dtype == th.uint8
        self.sight = Patches(tuple(seen.shape[1:]), device) if pictures else Levels()
        self._nowhere = th.zeros(count, dtype=th.int64, device=device)
        self._straight = th.zeros(count, dtype=th.bool, device=device)
        self._lane_numbers = th.arange(count, device=device)
        self._done = th.zeros((), dtype=th.float64, device=device)  # games so far
        self._epsilon = th.ones((), device=device)
        self._log = th.zeros((CHUNK, count, AT.columns), dtype=th.float64, device=device)
        self._line = th.zeros(1, dtype=th.int64, device=device)
        self.rounds = 0
        self._rounds: dict[tuple[bool, bool, bool], Callable[[], None]] = {}
        self._learning_stream = SideStream(priority=-1)  # its small kernels go before the large ones of rendering
        self._unread: deque[tuple[Any, ...]] = deque()
        self._clock = MonotonicClock()
        self._read_ns = self._spent_ns = 0  # when a chunk was read last, and time of which no game was told

    @property
    def exploration_rate(self) -> float:
        """Share of random actions."""
        return self.options.exploration_rate(1.0 - self.games / self.config.games)

    @property
    def at_rest(self) -> bool:
        """Whether a checkpoint can be taken: the host has read all rounds that were flown."""
        return not self._unread

    def begin(self) -> None:
        """See `Learner`; also sample the games after the first."""
        if not self.lanes.games.has_games:
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
        parts = (self._log, self.lanes.games.begun, self.statistics.sums)
        copies = [part.to("cpu", non_blocking=True, copy=True) for part in parts]
        read = th.cuda.Event()
        read.record()
        self._unread.append((read, *copies, begun_ns))

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
        if kind not in self._rounds:
            self._rounds[kind] = recorded(lambda: self._work(*kind), self.device)
        self._rounds[kind]()

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
            self._copy_to_target()

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
        now = select(self.lanes.observations, None)
        seen = self.sight.look(now, self._nowhere, self._lane_numbers, self._straight)
        greedy = self.sight.rate(self.policy.q_net, seen).argmax(1)
        return th.where(th.rand(count, device=self.device) < self._epsilon, drawn, greedy)

    def _learn(self) -> None:
        """Take the gradient steps of a round, on batches that are sampled together."""
        size = self.options.batch_size
        _, steps = learning_rhythm(self.config.commands_per_gradient_step, self.lanes.count)
        row, lane = self.replay.draw(steps * size, self.options.n_steps)
        half = th.arange(steps * size, device=self.device) % 2 == 0
        mirrored = half if self.config.mirror else th.zeros_like(half)
        for batch in self.replay.windows(row, lane, self.options.n_steps, self.options.gamma, mirrored).split(size):
            self._descend(self._prepared(batch))

    def _schedule(self) -> None:
        options, config = self.options, self.config
        self._log.index_copy_(0, self._line, self.lanes.ended[None])
        self._line.copy_((self._line + 1) % CHUNK)
        self._done += self.lanes.ended[:, self._at.over].sum()
        done = (self._done / config.games).clamp(max=1.0)
        fraction = options.exploration_fraction
        fall = (options.exploration_final_eps - options.exploration_initial_eps) / (fraction or 1.0)
        over = done > fraction if fraction else done >= 0.0
        self._epsilon.copy_(
            th.where(over, options.exploration_final_eps, options.exploration_initial_eps + done * fall)
        )
        rate_now = falling(options.learning_rate, config.final_learning_rate_share, 1.0 - done)  # type: ignore[arg-type]
        for group in self.optimizer.param_groups:
            # Games beyond the configured number must not change the weights.
            group["lr"].copy_(th.where(done >= 1.0, 0.0, rate_now))

    def _read_chunk(self) -> list[Game]:
        """Wait for the oldest chunk, sample new games, and return those that ended, up to the configured number."""
        read, log, begun, sums, begun_ns = self._unread.popleft()
        read.synchronize()
        self.statistics.read(sums)
        over = log[..., self._at.over].numpy()
        games = []
        before_ns, self._read_ns = max(begun_ns, self._read_ns), self._clock.now_ns()  # the next is in flight already
        self._spent_ns += self._read_ns - before_ns
        for line, lane in np.argwhere(over).tolist():
            if self.games >= self.config.games:
                break
            outcome = log[line, lane].tolist()
            info = self.lanes.info(lane, outcome) | {"host_phase_s": dict.fromkeys(PHASES, 0.0)}
            learned = self.statistics.loss, self.statistics.mean_q
            games.append(Game(self.games, lane, info, outcome[self._at.reward], self.exploration_rate, *learned))
            self.games += 1
        for game in games:
            game.info["host_phase_s"]["simulation"] = self._spent_ns / NS_PER_S / len(games)
        if games:
            self._spent_ns = 0
        self.lanes.games.refill(begun.tolist())
        return games

    def get_state(self) -> LearnerState:
        state = super().get_state()
        state.tensors["schedule"] = {"done": self._done, "epsilon": self._epsilon}
        return state

    def set_state(self, state: LearnerState, observations: Observation) -> None:
        super().set_state(state, observations)
        self._done.copy_(state.tensors["schedule"]["done"])
        self._epsilon.copy_(state.tensors["schedule"]["epsilon"])
