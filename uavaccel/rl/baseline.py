"""stable-baselines3's algorithms as learners: their networks, one rollout at a time, schedules by games.

Needs stable-baselines3, the extra `sb3`. `vec_env` adapts a batch of environments to this library.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import stable_baselines3
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from stable_baselines3.dqn.policies import DQNPolicy

from uavaccel.envs.batch import TurnBatch
from uavaccel.envs.values import Action, Answer, Frame
from uavaccel.errors import UserError
from uavaccel.realtime.policy_files import NoOptimizer
from uavaccel.rl.config import SB3, LearnerConfig
from uavaccel.rl.learner import (
    Game,
    Learner,
    LearnerState,
    falling,
    first_seed,
    learning_rhythm,
    plain_generator,
    set_generator,
)
from uavaccel.rl.network import LaneFeatures, contrast

COUNTERS = ("num_timesteps", "_n_calls", "_n_updates", "exploration_rate", "_current_progress_remaining")
BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


# --- networks -----------------------------------------------------------------------------------------------------


class Sb3Features(BaseFeaturesExtractor):
    """`LaneFeatures` for policies of stable-baselines3."""

    def __init__(self, observation_space: spaces.Box, channels: Sequence[int]) -> None:
        features = LaneFeatures(observation_space.shape, channels)
        super().__init__(observation_space, features.features_dim)
        self.layers = features.layers

    def forward(self, observations: th.Tensor) -> th.Tensor:
        """As `LaneFeatures`."""
        features: th.Tensor = self.layers(contrast(observations))
        return features


def baseline_class(name: str) -> type[BaseAlgorithm]:
    """Return the class of an algorithm such as `sb3_dqn`."""
    found: type[BaseAlgorithm] = getattr(stable_baselines3, name.removeprefix(SB3).upper())
    return found


def policy_of(config: LearnerConfig) -> tuple[str, dict[str, object]]:
    """Return the name of the policy that fits the observations, and the keywords that make its network."""
    if config.task.observation == "state":
        return "MlpPolicy", {"net_arch": list(config.hidden)}
    return "CnnPolicy", {
        "net_arch": list(config.hidden),
        "normalize_images": False,  # the network reads grey levels
        "features_extractor_class": Sb3Features,
        "features_extractor_kwargs": {"channels": list(config.channels)},
    }


def make_baseline_policy(config: LearnerConfig) -> BasePolicy:
    """Make an untrained policy, without an optimizer."""
    name, keywords = policy_of(config)
    make: Callable[..., BasePolicy] = baseline_class(config.algorithm).policy_aliases[name]
    space, actions = config.task.observation_space(), config.task.action_space()
    return make(space, actions, lambda _: 0.0, **keywords | {"optimizer_class": NoOptimizer})


def greedy(policy: BasePolicy, observations: Frame) -> NDArray[np.int64]:
    """Return the greedy actions (n,) for observations (n, ...)."""
    return np.asarray(policy.predict(observations, deterministic=True)[0])


def tensor_ratings(policy: BasePolicy, seen: th.Tensor) -> th.Tensor:
    """Return (n, actions) what the greedy action is the largest of: action values, or logits of the probabilities."""
    if isinstance(policy, DQNPolicy):
        values: th.Tensor = policy.q_net(seen)
        return values
    actor: Any = policy
    features = actor.extract_features(seen, actor.pi_features_extractor)
    logits: th.Tensor = actor.action_net(actor.mlp_extractor.forward_actor(features))
    return logits


def ratings(policy: BasePolicy, observations: Frame) -> tuple[str, NDArray[np.float64]]:
    """Return what the numbers are, and (n, actions) of them: action values or probabilities."""
    with th.inference_mode():
        rated = tensor_ratings(policy, th.from_numpy(observations).to(policy.device))
        if isinstance(policy, DQNPolicy):
            return "action values", rated.cpu().numpy().astype(np.float64)
        chances = th.distributions.Categorical(logits=rated).probs
        return "probabilities of the actions", chances.cpu().numpy().astype(np.float64)


# --- environments -------------------------------------------------------------------------------------------------


class BatchVecEnv(VecEnv):
    """Adapts a batch with autoreset SAME_STEP to stable-baselines3's VecEnv."""

    def __init__(self, batch: TurnBatch) -> None:
        self.batch = batch
        super().__init__(batch.num_envs, batch.single_observation_space, batch.single_action_space)

    def reset(self) -> VecEnvObs:
        options = [option or None for option in self._options]
        infos = self.batch.reset_each(self._seeds, options)
        self.reset_infos = infos
        self._reset_seeds()
        self._reset_options()
        observations: VecEnvObs = self.batch.observations()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        self.batch.step_async(actions)

    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, terminated, truncated, infos = self.batch.step_wait()
        for lane, (info, cut) in enumerate(zip(infos, (truncated & ~terminated).tolist(), strict=True)):
            if "final_info" in info:
                self.reset_infos[lane] = info
                infos[lane] = {**info.pop("final_info"), "terminal_observation": info.pop("final_obs")}
            infos[lane]["TimeLimit.truncated"] = cut
        return observations, rewards, terminated | truncated, infos

    def close(self) -> None:
        self.batch.close()

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Answer]:
        return [getattr(self.batch, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: object, indices: int | Iterable[int] | None = None) -> None:
        raise AttributeError(f"{attr_name}: environments of a batch have no attributes of their own")

    def env_method(
        self,
        method_name: str,
        *method_args: object,
        indices: int | Iterable[int] | None = None,
        **method_kwargs: object,
    ) -> list[Answer]:
        if method_kwargs:
            raise TypeError(f"{method_name}: keywords do not travel, pass the arguments by position")
        lanes = list(self._get_indices(indices))
        return self.batch.call_each(method_name, [method_args] * len(lanes), lanes)

    def env_is_wrapped(
        self,
        wrapper_class: type[gymnasium.Wrapper[Frame, Action, Frame, Action]],
        indices: int | Iterable[int] | None = None,
    ) -> list[bool]:
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[np.ndarray | None]:
        return self.env_method("render")


# --- learners -----------------------------------------------------------------------------------------------------


class Baseline(Learner):
    """A stable-baselines3 algorithm that learns from lanes; `algorithm` is the library's own object."""

    counters = ("games", "returns")

    def __init__(self, config: LearnerConfig, lanes: TurnBatch) -> None:
        super().__init__(config, lanes)
        self.vector = BatchVecEnv(lanes)
        self.algorithm = self._make(baseline_class(config.algorithm))
        self.policy, self.optimizer = self.algorithm.policy, self.algorithm.policy.optimizer
        for method, phase in (("train", "learning"), ("predict", "inference")):
            setattr(self.algorithm, method, self.stopwatch_of(phase, getattr(self.algorithm, method)))
        self._callback, self._begun = _Games(self), False
        self.vector.seed(first_seed(config.seed))

    @property
    def exploration_rate(self) -> float | None:
        """Share of random actions; None for an algorithm that explores differently."""
        return getattr(self.algorithm, "exploration_rate", None)

    @property
    def loss(self) -> float | None:
        """The last update's loss as the algorithm logs it; None before it, and where it has several losses."""
        logged = self.algorithm.logger.name_to_value.get("train/loss")
        return None if logged is None else float(logged)

    def stopwatch_of(self, phase: str, work: Callable[..., object]) -> Callable[..., object]:
        """Return work that is counted for a phase."""

        def watched(*arguments: object, **keywords: object) -> object:
            with self.stopwatch.phase(phase):
                return work(*arguments, **keywords)

        return watched

    def begin(self) -> None:
        """See `Learner`: here the algorithm resets the lanes itself."""

    def advance(self) -> list[Game]:
        """Collect one rollout and learn from it."""
        self._callback.finished = []
        self.algorithm.learn(1, self._callback, log_interval=1 << 30, reset_num_timesteps=not self._begun)
        self._begun = True
        steps = getattr(self.algorithm, "gradient_steps", 0)
        self.charge(steps / self.lanes.num_envs * self.config.learning_s, "learning")
        return self._callback.finished

    def _make(self, base: type[BaseAlgorithm]) -> BaseAlgorithm:
        """Make the algorithm. Raises UserError for options that it rejects."""
        config, keywords = self.config, dict(self.config.options)
        remaining = lambda: 1.0 - self.games / config.games  # noqa: E731
        scheduled: Any = type(f"{base.__name__}ByGames", (_ByGames, base), {"remaining": staticmethod(remaining)})
        if issubclass(base, OffPolicyAlgorithm):
            steps, gradient_steps = learning_rhythm(config.commands_per_gradient_step, config.environments)
            keywords = {"train_freq": steps, "gradient_steps": gradient_steps, **keywords}
        if (rate := keywords.get("learning_rate")) is not None:
            keywords["learning_rate"] = partial(falling, float(rate), config.final_learning_rate_share)
        name, layout = policy_of(config)
        try:
            algorithm: BaseAlgorithm = scheduled(
                name, self.vector, policy_kwargs=layout, seed=config.seed, device=config.device, **keywords
            )
        except (TypeError, ValueError, AssertionError) as error:
            raise UserError(f"options of {config.algorithm}: {error}") from error
        algorithm.set_logger(Logger(None, []))
        return algorithm

    # --- going on after a stop --------------------------------------------------------------------

    def get_state(self) -> LearnerState:
        """Return also the replay buffer, if there is one, and the generators."""
        state, model = super().get_state(), self.algorithm
        counters = {name: getattr(model, name) for name in COUNTERS if hasattr(model, name)}
        counters["random"] = plain_generator(np.random.mtrand._rand)
        counters["actions"] = self.lanes.single_action_space.np_random.bit_generator.state
        arrays, buffer = {}, getattr(model, "replay_buffer", None)
        if buffer is not None:
            filled = buffer.buffer_size if buffer.full else buffer.pos
            arrays = {name: getattr(buffer, name)[:filled] for name in BUFFER}
            arrays["place"] = np.array([buffer.pos, buffer.full])
        return LearnerState(state.tensors, arrays, {**counters, **state.counters})

    def set_state(self, state: LearnerState, observations: Frame) -> None:
        """See `Learner`."""
        super().set_state(state, observations)
        model: Any = self.algorithm
        buffer = getattr(model, "replay_buffer", None)
        if buffer is not None:
            buffer.pos, buffer.full = int(state.arrays["place"][0]), bool(state.arrays["place"][1])
            for name in BUFFER:
                getattr(buffer, name)[: len(state.arrays[name])] = state.arrays[name]
        for name in COUNTERS:
            if name in state.counters:
                setattr(model, name, state.counters[name])
        model._last_obs, model._last_episode_starts = observations, np.zeros(self.lanes.num_envs, bool)
        set_generator(np.random.mtrand._rand, state.counters["random"])
        self.lanes.single_action_space.np_random.bit_generator.state = state.counters["actions"]
        self._begun = True


class _ByGames:
    """Mixin that lets an algorithm's schedules follow the share of games flown instead of time steps."""

    remaining: Callable[[], float]

    def _update_current_progress_remaining(self, num_timesteps: int, total_timesteps: int) -> None:
        self._current_progress_remaining = self.remaining()


class _Games(BaseCallback):
    """Collects the games that end during a rollout, and stops it after the last one of the training."""

    def __init__(self, learner: Baseline) -> None:
        super().__init__()
        self.learner = learner
        self.finished: list[Game] = []

    def _on_step(self) -> bool:
        learner, now = self.learner, self.locals
        games = learner.finished(now["rewards"], now["dones"], now["infos"], range(learner.lanes.num_envs))
        self.finished += [replace(game, loss=learner.loss) for game in games]
        learner.charge(learner.config.inference_s, "inference")
        return learner.games < learner.config.games
