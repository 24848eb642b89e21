"""Double DQN (van Hasselt et al., AAAI 2016) on lanes flown in parallel: the training loop.

collect    choose an action for each lane, greedy or random, and let the lanes fly, in groups that take turns;
learn      meanwhile sample batches and take gradient steps towards the target network's values;
store      add the transitions to the replay buffer;
schedule   lower exploration and learning rate with the games done, update the target network periodically.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.utils import polyak_update
from torch.nn import functional

from uavaccel.clock import MonotonicClock
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.envs.values import Frame, Info
from uavaccel.files import Plain
from uavaccel.rl.agents import first_policy
from uavaccel.rl.algorithms import greedy
from uavaccel.rl.config import DqnOptions, LearnerConfig
from uavaccel.rl.graph import GraphedStep
from uavaccel.rl.lanes import Lanes
from uavaccel.rl.learner import (
    Game,
    LearnerState,
    charge_inference,
    charge_learning,
    falling,
    finished_games,
    learning_rhythm,
    plain_generator,
    set_generator,
)
from uavaccel.rl.network import ratings, turned_actions
from uavaccel.rl.replay import Batch, ReplayBuffer, Row
from uavaccel.rl.statistics import StepStatistics

COUNTERS = ("returns", "games", "commands", "steps", "updates", "owed", "exploration_rate", "rate")


class DoubleDQN:
    """The learner; `policy` holds `q_net` (online), `q_net_target` and the optimizer."""

    def __init__(self, config: LearnerConfig, lanes: Lanes) -> None:
        self.config, self.lanes, self.options = config, lanes, DqnOptions.of(config)
        self.rate = falling(self.options.learning_rate, config.final_learning_rate_share, 1.0)
        self.device = th.device(config.device)
        self.random = np.random.RandomState(config.seed)
        th.manual_seed(config.seed)
        lanes.action_space.seed(config.seed)
        policy: Any = first_policy(config, lambda _: self.rate).to(self.device)
        self.policy = policy
        self._learned = list(policy.q_net.parameters())
        space = lanes.observation_space
        self.buffer = ReplayBuffer(
            self.options.buffer_size, lanes.num_envs, space.shape or (), np.dtype(space.dtype), self.device
        )
        turned = turned_actions(config.task.headings_deg) if config.mirror else None
        self.mirror = None if turned is None else th.tensor(turned, device=self.device)
        self.observations: Frame | None = None
        self.groups: list[NDArray[np.int64]] = np.array_split(np.arange(lanes.num_envs), config.turns)
        self.holding = False
        self._next = 0  # group whose command starts next
        self._flying: deque[int] = deque()
        self._actions = np.zeros(lanes.num_envs, np.int64)
        self._charges = [0] * config.turns  # gradient steps that each group has yet to pay for
        self.returns = [0.0] * lanes.num_envs
        self.games = self.commands = self.steps = self.updates = self.owed = 0
        self.exploration_rate = 0.0
        self._graph: GraphedStep | None = None
        self.statistics = StepStatistics(self.device)
        self.stopwatch = Stopwatch(MonotonicClock())
        self._rhythm = learning_rhythm(config.commands_per_gradient_step, lanes.num_envs)
        self._parts: deque[Callable[[], None]] = deque()
        self._flights_left = 0

    def begin(self) -> None:
        """See `Learner`."""
        if self.observations is None:
            self.observations = np.asarray(self.lanes.reset())
            self._row = Row.like(self.observations)

    def advance(self) -> list[Game]:
        """Start a command in the next group, learn, and once all groups fly, wait for the first.

        Returns the games that ended with its commands. While `holding`, no new round of the groups begins.
        """
        self.begin()
        assert self.observations is not None
        waits = self.holding and self._next == 0 and self._flying
        if not waits:
            self._start_command(self._next, self.observations)
        self._learn_meanwhile()
        all_fly = len(self._flying) == len(self.groups)
        return self._finish_command(self._flying.popleft()) if all_fly or waits else []

    @property
    def at_rest(self) -> bool:
        """Whether a checkpoint can be taken: no gradient step is pending and no lane flies."""
        return self.steps % self._rhythm[0] == 0 and not self._parts and not self._flying

    # --- collect ----------------------------------------------------------------------------------

    def _start_command(self, group: int, observations: Frame) -> None:
        lanes = self.groups[group]
        charge_learning(self.lanes, self.config, self._charges[group], lanes)
        self._charges[group] = 0
        self._actions[lanes] = self._act(observations[lanes])
        self.lanes.step_async(self._actions[lanes], *self._in_part(lanes))
        self._flying.append(group)
        self._next = (group + 1) % len(self.groups)

    def _finish_command(self, group: int) -> list[Game]:
        lanes = self.groups[group]
        after, rewards, dones, infos = self.lanes.step_wait(*self._in_part(lanes))
        seen = np.asarray(after)
        self.commands += len(lanes)
        games = finished_games(self, rewards.tolist(), dones.tolist(), infos, lanes.tolist())
        if games:
            self.statistics.read(self.statistics.sums)
            games = [replace(game, loss=self.statistics.loss, mean_q=self.statistics.mean_q) for game in games]
        charge_inference(self.lanes, self.config, lanes)
        self._keep(lanes, rewards, seen, dones, infos)
        if group == len(self.groups) - 1 and self.games < self.config.games:
            self.buffer.add(*self._row)
            self._schedule()
        return games

    def _in_part(self, lanes: NDArray[np.int64]) -> tuple[list[int], ...]:
        """Extra arguments of a call that addresses some lanes; none for all, which any VecEnv understands."""
        return () if len(self.groups) == 1 else (lanes.tolist(),)

    def _act(self, observations: Frame) -> NDArray[np.int64]:
        with self.stopwatch.phase("inference"):
            untrained = self.config.start_from is None and self.commands < self.options.learning_starts
            if untrained or self.random.rand() < self.exploration_rate:
                return np.array([self.lanes.action_space.sample() for _ in observations])
            return greedy(self.policy, observations)

    # --- learn ------------------------------------------------------------------------------------

    def _learn_meanwhile(self) -> None:
        """Take an equal part of the pending gradient steps, so that they are done before the next ones are due."""
        if self.owed and not self._parts:
            self._flights_left = self._rhythm[0] * len(self.groups)
            self._parts.extend(self._parts_of(self.owed, self._flights_left))
        if not self._parts:
            return
        with self.stopwatch.phase("learning"):
            for _ in range(math.ceil(len(self._parts) / self._flights_left)):
                self._parts.popleft()()
        self._flights_left -= 1
        if not self._parts:
            self.owed = 0

    def _parts_of(self, steps: int, flights: int) -> list[Callable[[], None]]:
        """Divide gradient steps into parts of about equal duration; on a GPU, where they are short, many to a part."""
        if self.device.type != "cuda":
            return [self._prepare_batch, self._step] * steps
        shares = np.diff(np.linspace(0, steps, flights + 1).round().astype(int))
        return [partial(self._steps_at_once, int(share)) for share in shares]

    def _prepare_batch(self) -> None:
        self._batch = self._half_mirrored(self._sample())
        self._targets = self.targets(self._batch)

    def _step(self) -> None:
        for group in self.policy.optimizer.param_groups:
            group["lr"] = self.rate
        self._descend(self._batch, self._targets)
        self.updates += 1

    def _steps_at_once(self, steps: int) -> None:
        """Sample all batches at once and launch the recorded step for each, without waiting for the GPU."""
        if not steps:
            return
        size = self.options.batch_size
        samples = self._sample(steps)
        batches = [Batch(*(sample[at : at + size] for sample in samples)) for at in range(0, steps * size, size)]
        if self._graph is None:
            for group in self.policy.optimizer.param_groups:
                group["lr"] = th.tensor(self.rate, device=self.device)
            sums = self.statistics.sums.clone()
            self._graph = GraphedStep(self._learn_from, self.policy, self.policy.optimizer, batches[0])
            self.statistics.sums.copy_(sums)  # recording takes steps that do not count
        for group in self.policy.optimizer.param_groups:
            group["lr"].fill_(self.rate)
        for batch in batches:
            self._graph(batch)
        self.updates += steps

    def _learn_from(self, batch: Batch) -> None:
        batch = self._half_mirrored(batch)
        self._descend(batch, self.targets(batch))

    def _sample(self, batches: int = 1) -> Batch:
        options = self.options
        count = batches * options.batch_size
        return self.buffer.sample(count, options.n_steps, options.gamma, self.random)

    def _descend(self, batch: Batch, targets: th.Tensor) -> None:
        """Take one gradient step of the online network on the Huber loss to the targets."""
        chosen = self.policy.q_net(batch.observations).gather(1, batch.actions)
        loss = functional.smooth_l1_loss(chosen, targets)
        self.statistics.add(loss, chosen)
        self.policy.optimizer.zero_grad()
        loss.backward()
        th.nn.utils.clip_grad_norm_(self._learned, self.options.max_grad_norm)
        self.policy.optimizer.step()

    @th.no_grad()
    def targets(self, batch: Batch) -> th.Tensor:
        """Return rewards plus the discounted target value of the online network's next greedy action (n, 1)."""
        both = ratings((self.policy.q_net, self.policy.q_net_target), batch.next_observations)
        rating = both[1].gather(1, both[0].argmax(dim=1, keepdim=True))
        return batch.rewards + (1 - batch.dones) * batch.discounts * rating

    def _half_mirrored(self, batch: Batch) -> Batch:
        """Mirror half of the batch left to right: on average the lane is symmetric."""
        if self.mirror is None:
            return batch
        half = len(batch.actions) // 2
        images = [
            th.cat([image[:half].flip(-1), image[half:]]) for image in (batch.observations, batch.next_observations)
        ]
        actions = th.cat([self.mirror[batch.actions[:half]], batch.actions[half:]])
        return batch._replace(observations=images[0], next_observations=images[1], actions=actions)

    # --- store, schedule --------------------------------------------------------------------------

    def _keep(
        self,
        lanes: NDArray[np.int64],
        rewards: NDArray[np.float64],
        seen: Frame,
        dones: NDArray[np.bool_],
        infos: list[Info],
    ) -> None:
        """Keep a group's transitions until those of all groups go into the replay buffer."""
        assert self.observations is not None
        row = self._row
        row.observations[lanes], row.actions[lanes] = self.observations[lanes], self._actions[lanes]
        row.rewards[lanes], row.after[lanes], row.dones[lanes] = rewards, seen, dones
        for lane, info, done in zip(lanes, infos, dones, strict=True):
            row.truncated[lane] = bool(info.get("TimeLimit.truncated", False))
            if done and "terminal_observation" in info:  # `seen` is the next game's first observation
                row.after[lane] = info["terminal_observation"]
        self.observations[lanes] = seen

    def _schedule(self) -> None:
        options, remaining = self.options, 1.0 - self.games / self.config.games
        self.rate = falling(options.learning_rate, self.config.final_learning_rate_share, remaining)
        self.steps += 1
        if self.steps % max(options.target_update_interval // self.lanes.num_envs, 1) == 0:
            polyak_update(self.policy.q_net.parameters(), self.policy.q_net_target.parameters(), 1.0)
        self.exploration_rate = options.exploration_rate(remaining)
        due = self.steps % self._rhythm[0] == 0 and not self._parts
        if due and self.commands > options.learning_starts:
            self.owed += self._rhythm[1]
            self._charges = [self.owed] * len(self.groups)

    # --- going on after a stop ----------------------------------------------------------------------

    def get_state(self) -> LearnerState:
        """Return networks, optimizer, replay buffer, counters and generators."""
        tensors = {
            "policy": self.policy.state_dict(),
            "optimizer": self.policy.optimizer.state_dict(),
            "torch": th.get_rng_state(),
        }
        counters: dict[str, Plain] = {name: getattr(self, name) for name in COUNTERS}
        counters |= {"random": plain_generator(self.random), "statistics": self.statistics.get_state()}
        return LearnerState(tensors, self.buffer.get_state(), counters)

    def set_state(self, state: LearnerState, observations: Frame) -> None:
        """Restore what `get_state` returned; `observations` are the lanes' present ones."""
        self.policy.load_state_dict(state.tensors["policy"])
        self.policy.optimizer.load_state_dict(state.tensors["optimizer"])
        th.set_rng_state(state.tensors["torch"].cpu())
        self.buffer.set_state(state.arrays)
        for name in COUNTERS:
            setattr(self, name, state.counters[name])
        set_generator(self.random, state.counters["random"])
        self.statistics.set_state(state.counters.get("statistics"))
        self.observations = observations
        self._row = Row.like(observations)
        self._charges = [self.owed] * len(self.groups)
