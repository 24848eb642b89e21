"""Proximal policy optimisation for continuous actions (Schulman et al., 2017), over any vector environment.

One round is a rollout of T commands in N environments, and then epochs of minibatches over it:

act        a ~ Normal(mean(o), deviation), with its log probability and the value V(o);
estimate   generalised advantages A over the rollout (Schulman et al., 2016), and returns A + V;
descend    on the clipped objective, the squared error of V, and the entropy.

Of a task that is symmetric, half of each minibatch is mirrored, as if the policy were symmetric (Mittal et al., 2024).

The same code runs on the CPU and on a GPU, where acting and descending are recorded as CUDA graphs. Environments
restart in the step in which a game ends (autoreset SAME_STEP); what a truncated game would still have brought is taken
to be the value of its last observation but one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import deepcopy
from itertools import chain, pairwise
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np
import torch as th
from gymnasium import spaces
from pydantic import Field
from torch import nn
from torch.nn import functional

from uavaccel.config import Count, Seed
from uavaccel.envs.batch import TurnBatch
from uavaccel.envs.sensors import DEPTH_FAR_M
from uavaccel.envs.stopwatch import PHASES
from uavaccel.envs.task import Mirror
from uavaccel.errors import UserError
from uavaccel.kernels.recording import recorded
from uavaccel.rl.config import LearnerConfig, PPOSettings
from uavaccel.rl.learner import Game, Learner, LearnerState, compute_the_same_each_time, falling, first_seed
from uavaccel.rl.network import Adam, contrast
from uavaccel.units import NS_PER_S

Parts: TypeAlias = dict[str, th.Tensor]

NEAR_M = 15.0  # depth from which on all is equally far
SLOWEST = 1e-5  # learning rate below which no divergence brings it
LOG_ROOT_TWO_PI, LOG_ROOT_TWO_PI_E = 0.5 * math.log(2 * math.pi), 0.5 * math.log(2 * math.pi * math.e)


class PPOOptions(PPOSettings):
    """The options of a training by commands."""

    commands: Annotated[int, Field(ge=1, le=10**12)] = 20_000_000
    """Commands that all environments fly together; the learning rate falls to 0 over them."""
    channels: Annotated[tuple[Count, ...], Field(min_length=1, max_length=6)] = (16, 32, 32)
    """Channels of the convolutions, for observations with pictures: 5 x 5, then 3 x 3, all with stride 2."""
    hidden: Annotated[tuple[Count, ...], Field(max_length=8)] = (256, 128)
    """Widths of the layers after them."""
    mirror: bool = True
    """Whether half of each minibatch is turned left to right, where the environment's task says how."""
    seed: Seed = 0
    """Seed of weights and actions, and of the environments' games."""


class Progress(NamedTuple):
    """What a round brought."""

    commands: int
    """Commands flown so far."""
    games: int
    """Games that ended in the round, of which `won` were won."""
    won: int
    reward: float
    """Mean reward of a command."""
    deviation: float
    """Mean standard deviation of the actions."""


def parts_of(observations: Any, device: th.device) -> Parts:
    """Return observations (n, ...), tensors or arrays or a mapping of them, as tensors by name."""
    given = observations if isinstance(observations, Mapping) else {"seen": observations}
    return {name: th.as_tensor(part, device=device) for name, part in given.items()}


def boxes_of(space: spaces.Space[Any]) -> dict[str, spaces.Box]:
    """Return the boxes of an observation space by name. Raises UserError for other spaces."""
    found = dict(space.spaces) if isinstance(space, spaces.Dict) else {"seen": space}
    for name, part in found.items():
        if not isinstance(part, spaces.Box) or len(part.shape) not in (1, 2, 3):
            raise UserError(
                f"observation {name!r}: must be a picture (channels, rows, columns), rows or a vector, not {part}"
            )
    return found  # type: ignore[return-value]


class FirstLayer(nn.Conv2d):
    """A convolution of 5 x 5 pixels with stride 2, of pictures (n, channels, rows, columns) or of their blocks.

    Blocks have each 2 x 2 pixels as channels, which a GPU convolves faster.
    """

    def __init__(self, before: int, after: int) -> None:
        super().__init__(before, after, 5, stride=2, padding=2)

    def forward(self, seen: th.Tensor) -> th.Tensor:
        """Return what is the same for pictures and for their blocks, but for rounding."""
        if seen.shape[1] == self.in_channels:
            return super().forward(seen)
        weight = functional.pixel_unshuffle(functional.pad(self.weight, (0, 1, 0, 1)), 2)
        return functional.conv2d(seen, weight, self.bias, padding=1)


def blocks(pictures: th.Tensor) -> th.Tensor:
    """Return pictures (n, channels, rows, columns) as blocks (n, rows / 2, columns / 2, 4 channels), rounded up."""
    rows, columns = pictures.shape[2:]
    found = functional.pixel_unshuffle(functional.pad(pictures, (0, columns % 2, 0, rows % 2)), 2)
    return found.permute(0, 2, 3, 1)


class Turn:
    """Turns samples left to right, their pictures perhaps in blocks."""

    def __init__(self, mirror: Mirror, boxes: Mapping[str, spaces.Box], device: th.device) -> None:
        self._columns = {name: box.shape[-1] for name, box in boxes.items() if len(box.shape) == 3}
        self._fields, self._action = (th.tensor(places, device=device) for places in mirror)

    def seen(self, name: str, part: th.Tensor, in_blocks: bool) -> th.Tensor:
        """Return a part (n, ...) of observations, in the form in which the network takes it, turned."""
        if name not in self._columns:
            return _placed(part.unflatten(-1, (-1, len(self._fields))), self._fields).flatten(-2)
        if not in_blocks:
            return part.flip(3)
        pictures = functional.pixel_shuffle(part.permute(0, 3, 1, 2), 2)
        return blocks(pictures[..., : self._columns[name]].flip(3))

    def action(self, action: th.Tensor) -> th.Tensor:
        """Return actions (n, actions), turned."""
        return _placed(action, self._action)


def _placed(numbers: th.Tensor, places: th.Tensor) -> th.Tensor:
    return numbers[..., places.abs() - 1] * places.sign()


class ActorCritic(nn.Module):
    """Mean actions and values of observations: convolutions for each picture, then layers that all parts share.

    `sees` is the task's kind of observation, by which levels of pictures become the network's input.
    """

    def __init__(self, space: spaces.Space[Any], actions: int, options: PPOOptions, sees: str = "") -> None:
        super().__init__()
        self.sees, self.half_contrast = sees, options.half_contrast
        self.parts, width = tuple(boxes_of(space)), 0
        self.eyes = nn.ModuleDict()
        for name, box in boxes_of(space).items():
            if len(box.shape) < 3:
                width += math.prod(box.shape)
                continue
            layers: list[nn.Module] = []
            for number, (before, after) in enumerate(pairwise((box.shape[0], *options.channels))):
                layer = nn.Conv2d(before, after, 3, stride=2, padding=1) if number else FirstLayer(before, after)
                layers += [_scaled(layer, 2**0.5), nn.ReLU()]
            eye = nn.Sequential(*layers, nn.Flatten())
            width += int(eye(th.zeros(1, *box.shape)).shape[1])
            self.eyes[name] = eye
        body = [(_scaled(nn.Linear(*sizes), 2**0.5), nn.ReLU()) for sizes in pairwise((width, *options.hidden))]
        self.body = nn.Sequential(*(layer for pair in body for layer in pair))
        last = (width, *options.hidden)[-1]
        self.mean, self.value = _scaled(nn.Linear(last, actions), 0.01), _scaled(nn.Linear(last, 1), 1.0)
        self.log_deviation = nn.Parameter(th.full((actions,), math.log(options.first_deviation)))

    def forward(self, inputs: Parts) -> tuple[th.Tensor, th.Tensor]:
        """Return mean actions (n, actions) and values (n,) for the `inputs` of observations."""
        return self.rate(self.features(inputs))

    def features(self, inputs: Parts) -> th.Tensor:
        """Return what mean actions and values are computed from (n, width)."""
        looks = {name: eye(inputs[name]) for name, eye in self.eyes.items()}
        parts = [looks[name] if name in looks else inputs[name].flatten(1) for name in self.parts]
        features: th.Tensor = self.body(th.cat(parts, 1))
        return features

    def rate(self, features: th.Tensor) -> tuple[th.Tensor, th.Tensor]:
        """Return mean actions (n, actions) and values (n,) of features (n, width)."""
        return self.mean(features), self.value(features)[:, 0]

    def inputs(self, seen: Parts) -> Parts:
        """Return observations by name as the network takes them: pictures as levels -1 to 1."""
        return {name: self._levels(part) if name in self.eyes else part for name, part in seen.items()}

    def _levels(self, picture: th.Tensor) -> th.Tensor:
        """Return levels 0 to 255 as -1 to 1; faint events are amplified, and depth is told apart up to NEAR_M."""
        if self.sees == "dvs":
            return contrast(picture.to(th.float32, copy=True), self.half_contrast)
        if self.sees == "depth":
            return 1.0 - (picture.float() * (DEPTH_FAR_M / 255 / NEAR_M)).clamp(max=1.0)
        return picture.float() / 127.5 - 1.0

    def act_on(self, seen: Parts) -> th.Tensor:
        """Return the mean actions (n, actions), -1 to 1, for observations by name."""
        clipped: th.Tensor = self(self.inputs(seen))[0].clamp(-1.0, 1.0)
        return clipped

    @th.no_grad()
    def act(self, observations: Any) -> th.Tensor:
        """Return the mean actions (n, actions), -1 to 1, for observations as environments give them."""
        return self.act_on(parts_of(observations, self.log_deviation.device))


def _scaled(layer: Any, gain: float) -> Any:
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


class PPO:
    """The training of a policy in `env`, a vector environment with actions in [-1, 1] and autoreset SAME_STEP.

    `policy` is the network. Raises UserError for spaces of other kinds.
    """

    def __init__(self, env: Any, options: PPOOptions) -> None:
        space = env.single_action_space
        if not isinstance(space, spaces.Box) or len(space.shape) != 1:
            raise UserError(f"PPO takes continuous actions (n,), not {space}")
        options.check_samples(env.num_envs)
        self.env, self.options, self.device = env, options, th.device(getattr(env, "device", "cpu"))
        th.manual_seed(options.seed)
        task = getattr(env, "task", None)
        sees, mirrored = getattr(task, "observation", ""), getattr(task, "mirrored", None)
        mirror = mirrored() if options.mirror and mirrored else None
        self._turn = None if mirror is None else self._turn_of(mirror)
        on_gpu = self.device.type == "cuda"
        policy = ActorCritic(env.single_observation_space, space.shape[0], options, sees)
        order = th.channels_last if on_gpu else th.preserve_format  # the order in which a GPU convolves
        self.policy = policy.to(self.device, memory_format=order)  # type: ignore[call-overload]
        rate = th.tensor(options.learning_rate, device=self.device)
        self.optimizer = Adam(self.policy.parameters(), rate, eps=1e-5, capturable=on_gpu, fused=on_gpu or None)
        self.commands = 0
        self._in_bfloat16 = options.precision == "bfloat16"
        self._allocate(space.shape[0])
        works = self._act, self._estimate, self._descend
        self._do_act, self._do_estimate, self._do_descend = (recorded(work, self.device) for work in works)

    def _turn_of(self, mirror: Mirror) -> Turn:
        space = self.env.single_observation_space
        try:
            mirror = Mirror(*mirror)
            mirror.check(space, self.env.single_action_space.shape[0])
        except (TypeError, ValueError) as error:
            raise UserError(f"mirrored: {error}") from error
        return Turn(mirror, boxes_of(space), self.device)

    def _allocate(self, actions: int) -> None:
        count, steps, device = self.env.num_envs, self.options.rollout, self.device
        zeros: Callable[..., th.Tensor] = lambda *shape, **kind: th.zeros(shape, device=device, **kind)  # noqa: E731
        boxes = boxes_of(self.env.single_observation_space)
        inputs = self._inputs({name: zeros(1, *box.shape) for name, box in boxes.items()})
        self._now = {name: zeros(count, *part.shape[1:], dtype=part.dtype) for name, part in inputs.items()}
        self._seen = {name: zeros(steps, *now.shape, dtype=now.dtype) for name, now in self._now.items()}
        self._chosen, self._action = zeros(steps, count, actions), zeros(count, actions)
        self._chances, self._values, self._rewards, self._going, self._gains, self._targets = (
            zeros(steps, count) for _ in range(6)
        )
        self._step = zeros(1, dtype=th.int64)
        self._batch = zeros(count * steps // self.options.minibatches, dtype=th.int64)
        self._tally = zeros(3, dtype=th.float64)  # games ended, games won, sum of rewards
        self._most = th.full((), math.inf, device=device)
        self._fastest = th.zeros((), device=device)

    def learn(self) -> Iterator[Progress]:
        """Train until all commands are flown; yield after each round."""
        self.look(self.env.reset(seed=self.options.seed)[0])
        while self.commands < self.options.commands:
            left = 1.0 - self.commands / self.options.commands
            self.launch(left, left)
            yield self.finish()

    def launch(self, left: float, rate_share: float) -> None:
        """Fly a rollout and learn from it at a share of the initial learning rate, without waiting for a GPU.

        `left` is the share of the training that is left, from 1 to 0.
        """
        for group in self.optimizer.param_groups:
            most = self._fastest if self.options.divergence else group["lr"]
            most.fill_(rate_share * self.options.learning_rate)
        if (last := self.options.final_deviation) is not None:
            self._most.fill_(math.log(last + left * (self.options.first_deviation - last)))
        self._tally.zero_()
        self._step.zero_()
        for step in range(self.options.rollout):
            self._do_act()
            self._fly(step)
        self._do_estimate()
        for _ in range(self.options.epochs):
            order = th.randperm(self._rewards.numel(), device=self.device).view(self.options.minibatches, -1)
            for batch in order:
                self._batch.copy_(batch)
                self._do_descend()
        self.commands += self._rewards.numel()

    def finish(self) -> Progress:
        """Return what the launched round brought."""
        games, won, rewards = self._tally.tolist()
        deviation = float(self._log_deviation().detach().exp().mean())
        return Progress(self.commands, int(games), int(won), rewards / self._rewards.numel(), deviation)

    def look(self, observations: Any) -> None:
        """Take the observations (environments, ...) that are to be acted on next."""
        for name, part in self._inputs(parts_of(observations, self.device)).items():
            self._now[name].copy_(part)

    def _inputs(self, seen: Parts) -> Parts:
        inputs: Parts = self.policy.inputs(seen)
        if not self._in_bfloat16:
            return inputs
        return {name: blocks(part.bfloat16()) if name in self.policy.eyes else part for name, part in inputs.items()}

    def _rate(self, inputs: Parts) -> tuple[th.Tensor, th.Tensor]:
        """Return mean actions and values; in bfloat16, only the last layers compute in single precision."""
        if not self._in_bfloat16:
            rated: tuple[th.Tensor, th.Tensor] = self.policy(inputs)
            return rated
        pictures = {name: inputs[name].permute(0, 3, 1, 2) for name in self.policy.eyes}
        with th.autocast(self.device.type, th.bfloat16, cache_enabled=False):
            features = self.policy.features({**inputs, **pictures})
        found: tuple[th.Tensor, th.Tensor] = self.policy.rate(features.float())
        return found

    def _fly(self, step: int) -> None:
        """Fly one command in every environment, and note what came of it."""
        on_gpu = self.device.type == "cuda"
        actions = self._action.clamp(-1.0, 1.0)
        seen, rewards, terminated, truncated, infos = self.env.step(actions if on_gpu else actions.numpy())
        self.look(seen)
        reward, lost, cut = (th.as_tensor(part, device=self.device) for part in (rewards, terminated, truncated))
        over = lost | cut
        self._rewards[step] = reward.float() + self.options.gamma * self._values[step] * cut
        self._going[step] = (~over).float()
        won = infos.get("final_info", {}).get("is_success")
        won_now = th.zeros_like(over) if won is None else th.as_tensor(won, device=self.device) & over
        self._tally += th.stack([over.sum().double(), won_now.sum().double(), reward.double().sum()])

    @th.no_grad()
    def _act(self) -> None:
        """Choose actions for what is seen now, and store all that learning needs of it."""
        mean, value = self._rate(self._now)
        self._action.copy_(mean + self._log_deviation().exp() * th.randn_like(mean))
        for name, part in self._now.items():
            self._seen[name].index_copy_(0, self._step, part[None])
        chance = self._chance(mean, self._action)
        for rows, row in ((self._chosen, self._action), (self._values, value), (self._chances, chance)):
            rows.index_copy_(0, self._step, row[None])
        self._step += 1

    def _chance(self, mean: th.Tensor, action: th.Tensor) -> th.Tensor:
        """Return the log probabilities (n,) of actions (n, actions)."""
        log_deviation = self._log_deviation()
        distance = (action - mean) * (-log_deviation).exp()
        return (-0.5 * distance * distance - log_deviation - LOG_ROOT_TWO_PI).sum(1)

    def _log_deviation(self) -> th.Tensor:
        """Return the logarithms of the actions' standard deviations: what is learned, at most what is left of them."""
        learned = self.policy.log_deviation
        return learned if self.options.final_deviation is None else th.minimum(learned, self._most)

    @th.no_grad()
    def _estimate(self) -> None:
        """Compute advantages and returns of the rollout."""
        gamma, smoothing = self.options.gamma, self.options.smoothing
        after, gain = self._rate(self._now)[1], th.zeros_like(self._values[0])
        for step in reversed(range(self.options.rollout)):
            going = self._going[step]
            surprise = self._rewards[step] + gamma * going * after - self._values[step]
            gain = surprise + gamma * smoothing * going * gain
            self._gains[step], after = gain, self._values[step]
        self._targets.copy_(self._gains + self._values)

    def _descend(self) -> None:
        """Take one gradient step on the minibatch."""
        options, batch = self.options, self._batch
        seen = {name: part.flatten(0, 1)[batch] for name, part in self._seen.items()}
        plain = len(batch) if self._turn is None else len(batch) // 2
        action, before, gain, target = (
            part.flatten(0, 1)[batch] for part in (self._chosen, self._chances, self._gains, self._targets)
        )
        if self._turn is not None:
            turned = {name: self._turn.seen(name, part[plain:], self._in_bfloat16) for name, part in seen.items()}
            seen = {name: th.cat([part[:plain], turned[name]]) for name, part in seen.items()}
            action = th.cat([action[:plain], self._turn.action(action[plain:])])
        mean, value = self._rate(seen)
        log_ratio = self._chance(mean, action) - before
        ratio = log_ratio.exp()
        if options.divergence:
            self._pace((ratio - 1.0 - log_ratio)[:plain].mean().detach(), options.divergence)
        gain = (gain - gain.mean()) / (gain.std() + 1e-8)
        objective = th.min(gain * ratio, gain * ratio.clamp(1.0 - options.clip, 1.0 + options.clip)).mean()
        entropy = (self._log_deviation() + LOG_ROOT_TWO_PI_E).sum()
        error = ((value - target) ** 2).mean()
        loss = options.value_weight * error - objective - options.entropy_weight * entropy
        self.optimizer.zero_grad(set_to_none=False)
        loss.backward()
        nn.utils.clip_grad_norm_(self.policy.parameters(), options.max_grad_norm)
        self.optimizer.step()

    def _pace(self, divergence: th.Tensor, aim: float) -> None:
        """Change the learning rate by how far the policy is from that which flew (Schulman's estimator k3)."""
        for group in self.optimizer.param_groups:
            factor = th.where(divergence > 2.0 * aim, 2 / 3, th.where(divergence < 0.5 * aim, 1.5, 1.0))
            group["lr"].copy_(th.minimum((group["lr"] * factor).clamp(min=SLOWEST), self._fastest))


def options_of(config: LearnerConfig) -> PPOOptions:
    """Return PPO's options. Raises UserError for an unknown key or a value that does not fit."""
    settings = PPOSettings.of(config).model_dump()
    return PPOOptions(
        **settings, channels=config.channels, hidden=config.hidden, mirror=config.mirror, seed=config.seed
    )


def actor_of(config: LearnerConfig) -> ActorCritic:
    """Make the untrained policy of a configuration."""
    (actions,) = config.task.action_space().shape or (0,)
    return ActorCritic(config.task.observation_space(), actions, options_of(config), config.task.observation)


class PPOTraining(Learner):
    """PPO on a batch of the host, or on a CudaBatch, which flies the next round while the last one's games are told.

    A checkpoint can be taken between any two rounds, when none is in flight. `policy` is the network after the last
    round whose games were told.
    """

    counters = ("games", "returns", "commands")

    def __init__(self, config: LearnerConfig, lanes: Any) -> None:
        if config.device.startswith("cuda"):
            compute_the_same_each_time()
        super().__init__(config, lanes)
        self.options, self._on_host = options_of(config), isinstance(lanes, TurnBatch)
        self._games: HostGames | DeviceGames = (HostGames if self._on_host else DeviceGames)(self)
        self._ppo = PPO(self._games, self.options)
        self.optimizer, self._begun = self._ppo.optimizer, False
        self.seconds_of_learning = self.options.epochs * self.options.minibatches / lanes.num_envs * config.learning_s
        """What a round's gradient steps cost each lane."""
        self.policy = self._ppo.policy if self._on_host else deepcopy(self._ppo.policy)

    @property
    def commands(self) -> int:
        """Commands flown so far."""
        return self._ppo.commands

    @commands.setter
    def commands(self, commands: int) -> None:
        self._ppo.commands = commands

    def begin(self) -> None:
        """See `Learner`."""
        if not self._begun:
            self._ppo.look(self.lanes.reset(seed=first_seed(self.config.seed))[0])
        self._begun = True

    def advance(self) -> list[Game]:
        """Fly a rollout and learn from it; returns the games that ended in it."""
        self.begin()
        with self.stopwatch.phase("learning"):
            if self.at_rest:
                self._launch()
            self._ppo.finish()
            tell = self._games.pop()
            if not self._on_host:
                self.policy.load_state_dict(self._ppo.policy.state_dict())
                self.at_rest = self.holding or self.games == self.config.games
            if not self.at_rest:
                self._launch()
            return tell()

    def _launch(self) -> None:
        left = 1.0 - self.games / self.config.games
        self._ppo.launch(left, falling(1.0, self.config.final_learning_rate_share, left))

    def set_state(self, state: LearnerState, observations: Any) -> None:
        """See `Learner`."""
        super().set_state(state, observations)
        self._ppo.policy.load_state_dict(state.tensors["policy"])
        self._ppo.look(observations)
        self._begun = True


class Games:
    """The lanes of a training as PPO's environments."""

    def __init__(self, learner: PPOTraining) -> None:
        self._learner, self._lanes = learner, learner.lanes
        self.num_envs, self.task = self._lanes.num_envs, learner.config.task
        self.device = th.device(learner.config.device)
        self.single_observation_space = self._lanes.single_observation_space
        self.single_action_space = self._lanes.single_action_space


class HostGames(Games):
    """A batch of the host; it notes the games that end."""

    def __init__(self, learner: PPOTraining) -> None:
        super().__init__(learner)
        self._ended: list[Game] = []

    def step(self, actions: Any) -> tuple[Any, ...]:
        """Fly one command in every environment."""
        learner = self._learner
        learner.stopwatch.switch(None)
        self._lanes.step_async(th.as_tensor(actions).cpu().numpy())
        seen, rewards, terminated, truncated, infos = self._lanes.step_wait()
        learner.stopwatch.switch("learning")
        self._ended += learner.finished(rewards, terminated | truncated, infos, range(self.num_envs))
        learner.charge(learner.config.inference_s, "inference")
        won = np.array([info.get("final_info", info)["is_success"] for info in infos])
        return seen, rewards, terminated, truncated, {"final_info": {"is_success": won}}

    def pop(self) -> Callable[[], list[Game]]:
        """Return what tells the games that ended since the last call; charge the lanes for what was learned since."""
        self._learner.charge(self._learner.seconds_of_learning, "learning")
        ended, self._ended = self._ended, []
        return lambda: ended


class DeviceGames(Games):
    """A CudaBatch; the games that end are read once a round."""

    def __init__(self, learner: PPOTraining) -> None:
        super().__init__(learner)
        self.device = self._lanes.device
        self._returns: th.Tensor | None = None
        self._unread: list[tuple[th.Tensor, th.Tensor, dict[str, Any]]] = []

    def step(self, actions: th.Tensor) -> tuple[Any, ...]:
        """Fly one command in every environment."""
        stepped: tuple[Any, ...] = self._lanes.step(actions)
        _, rewards, terminated, truncated, infos = stepped
        if self._returns is None:
            self._returns = th.tensor(self._learner.returns, dtype=th.float64, device=self.device)
        over, returns = terminated | truncated, self._returns + rewards
        self._unread.append((over, returns, infos["final_info"]))
        self._charge(self._learner.config.inference_s, "inference")
        self._returns = th.where(over, 0.0, returns)
        return stepped

    def _charge(self, duration_s: float, phase: str) -> None:
        self._lanes.charge_each(np.full(self.num_envs, round(duration_s * NS_PER_S)), phase)

    def pop(self) -> Callable[[], list[Game]]:
        """See `HostGames`; the games, up to the configured number, can be told when the next round is in flight."""
        learner, ended = self._learner, []
        self._charge(learner.seconds_of_learning, "learning")
        for over, returns, infos in self._unread:
            lanes = over.nonzero()[:, 0]
            ended.append((lanes.tolist(), _of_lanes(infos, lanes), returns[lanes].tolist()))
        self._unread.clear()
        assert self._returns is not None
        learner.returns = self._returns.tolist()
        first = learner.games
        learner.games = min(first + sum(len(lanes) for lanes, _, _ in ended), learner.config.games)
        numbers, games = range(first, learner.games), chain.from_iterable(zip(*step, strict=True) for step in ended)
        return lambda: self._told(numbers, games)

    def _told(self, numbers: Iterable[int], ended: Iterable[tuple[int, dict[str, Any], float]]) -> list[Game]:
        games = []
        for number, (lane, info, reward) in zip(numbers, ended, strict=False):
            hit = info["collision"]
            info["collision"] = self._lanes.object_names[hit] if hit >= 0 else None
            info["host_phase_s"] = dict.fromkeys(PHASES, 0.0)
            games.append(Game(number, lane, info, reward, None))
        return games


def _of_lanes(info: dict[str, Any], lanes: th.Tensor) -> list[dict[str, Any]]:
    """Return the infos of lanes (n,), as plain values without their masks, from those of all."""
    columns = {
        name: _of_lanes(part, lanes) if isinstance(part, dict) else part[lanes].tolist()
        for name, part in info.items()
        if not name.startswith("_")
    }
    rows = zip(*columns.values(), strict=True) if columns else [()] * len(lanes)
    return [dict(zip(columns, row, strict=True)) for row in rows]
