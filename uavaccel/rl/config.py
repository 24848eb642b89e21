"""Configuration of a learner: the task, the algorithm with its options, and the length of the training."""

from __future__ import annotations

import inspect
import json
import math
from collections.abc import Mapping
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, Literal

from gymnasium import spaces
from pydantic import (
    AfterValidator,
    Field,
    SerializeAsAny,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from uavaccel.config import MOST_PROCESSES, Config, Cost, Count, Device, Games, Lanes, Processes, Seed, validate
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.envs.simulators import Simulator, check_flyable
from uavaccel.envs.task import Positive, Task
from uavaccel.errors import UserError, suggestion
from uavaccel.files import Plain
from uavaccel.machine import memory_bytes
from uavaccel.own_code import module_of, name_beside, own_class, own_module
from uavaccel.resources import require

if TYPE_CHECKING:
    from pydantic import GetJsonSchemaHandler
    from pydantic.json_schema import JsonSchemaValue
    from pydantic_core import CoreSchema

    from uavaccel.envs.flight_env import FlightEnv

DOUBLE_DQN, PPO = OWN = "double_dqn", "ppo"
SB3 = "sb3_"  # begins the names of stable-baselines3's algorithms
ALGORITHMS = f"{DOUBLE_DQN}, {PPO}, {SB3}dqn, {SB3}ppo, {SB3}a2c"
RESERVED = ("policy", "env", "policy_kwargs", "seed", "device", "verbose", "tensorboard_log", "_init_setup_model")
SIZES = ("buffer_size", "batch_size", "n_steps", "n_epochs")
LARGEST_SIZE = 1_000_000_000
HALF_CONTRAST = 24.0

Channels = Annotated[int, Field(ge=1, le=1_024)]
Width = Annotated[int, Field(ge=1, le=8_192)]
Size = Annotated[int, Field(ge=1, le=LARGEST_SIZE)]
Ratio = Annotated[float, Field(ge=0.0, le=1.0)]
Weight = Annotated[float, Field(ge=0.0, le=1e3)]

LANE = "uavaccel/ObstacleLane-v0"
SHORT = {"lane": LANE, "hover": "uavaccel/Hover-v0", "gates": "uavaccel/Gates-v0", "navigate": "uavaccel/Navigate-v0"}
"""The environments that ship, by the names that Python takes too."""
ENVIRONMENTS = tuple(SHORT.values())


def environment_class(env_id: str) -> type[FlightEnv[Any]]:
    """Return the class of an environment of this package by its id, or of one's own by "file.py:Class".

    Own code is found, and runs, as uavaccel.own_code has it; its class may be that of an environment or of a task.
    Raises UserError where there is none, and where nobody has told to run it.
    """
    if ":" in env_id:
        from uavaccel.envs.flight_env import FlightEnv, environment_of

        own = own_class(env_id, f"task {env_id!r}", Task, FlightEnv)
        if issubclass(own, FlightEnv) and not hasattr(own, "task_class"):
            raise UserError(f"task {env_id!r}: {own.__name__} has no task_class, which is the class of its task")
        return environment_of(own)  # type: ignore[arg-type]  # mypy doubts that classes are hashable
    if env_id == LANE:
        return ObstacleLane
    name = env_id.removeprefix("uavaccel/").removesuffix("-v0")
    found: type[FlightEnv[Any]] = getattr(import_module(f"uavaccel.envs.{name.lower()}"), name)
    return found


def _known(env_id: str) -> str:
    if env_id not in ENVIRONMENTS and ":" not in env_id:
        raise ValueError(f"unknown; {suggestion(env_id, [*ENVIRONMENTS, 'my_task.py:MyTask'])}")
    return env_id


EnvId = Annotated[str, AfterValidator(_known)]


def only_task(place: str) -> str:
    """Return the "file.py:Class" of the only task in "file.py". Raises UserError unless there is exactly one.

    An environment and the task that it names are one.
    """
    from uavaccel.envs.flight_env import FlightEnv

    where = f"task {place!r}"
    module = own_module(module_of(place), where)
    here = [each for each in vars(module).values() if isinstance(each, type) and each.__module__ == module.__name__]
    environments = [each for each in here if issubclass(each, FlightEnv)]
    flown = {getattr(each, "task_class", None) for each in environments}
    found = environments + [each for each in here if issubclass(each, Task) and each not in flown]
    if not found:
        raise UserError(f"{where}: has no class of a task: a subclass of uavaccel.envs.task.Task, or of FlightEnv")
    names = [f"{place}:{each.__name__}" for each in found]
    if len(names) > 1:
        raise UserError(f"{where}: has {len(names)} tasks: name one, {' or '.join(names)}")
    return names[0]


def with_env_id(mapping: Mapping[str, Any]) -> dict[str, Any]:
    """Return the mapping of a training with `env_id` and `task` for a `task` that is, or whose `class` is, a name.

    Raises UserError for names of no environment.
    """
    task = mapping.get("task")
    keys = {"class": task} if isinstance(task, str) else dict(task) if isinstance(task, Mapping) else {}
    if "class" not in keys:
        return dict(mapping)
    name = keys.pop("class")
    if not isinstance(name, str):
        raise UserError(f"task = {name!r}: should be the name of an environment, or a mapping of keys")
    env_id = only_task(name) if name.endswith(".py") else SHORT.get(name, name)
    if env_id not in ENVIRONMENTS and ":" not in env_id:
        raise UserError(f"task = {name!r}: {suggestion(name, [*SHORT, *ENVIRONMENTS, 'my_task.py:MyTask'])}")
    return {**mapping, "env_id": env_id, "task": keys}


def _of_the_environment(task: Any, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
    """Validate the keys of a task by the environment that `env_id` names."""
    if "env_id" not in info.data:  # it is wrong itself
        return LaneTask()
    task_class = environment_class(info.data["env_id"]).task_class
    if isinstance(task, task_class):
        return task
    if isinstance(task, Task):  # the field's default
        task = task.model_dump(mode="json", exclude_unset=True)
    if not isinstance(task, Mapping):
        return handler(task)  # which refuses it
    made = task_class.model_validate_json(json.dumps(task), strict=True)
    if ":" in info.data["env_id"]:
        from uavaccel.envs.checks import check_functions

        check_functions(made)
    return made


class _OfEach:
    """Lets the JSON schema have the keys of any environment's task, or its name."""

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        tasks = [handler(environment_class(name).task_class.__pydantic_core_schema__) for name in ENVIRONMENTS]
        for task in tasks:
            handler.resolve_ref_schema(task)["properties"]["class"] = TASK_NAME
        return {"anyOf": [TASK_NAME, *tasks]}


TASK_NAME = {"type": "string", "description": "The task: an environment, or one of your own, file.py:Class."}


AnyTask = Annotated[SerializeAsAny[LaneTask], WrapValidator(_of_the_environment), _OfEach()]
"""A LaneTask; with another `env_id`, that environment's task."""


class LearnerConfig(Config):
    """How a policy is trained. Network, algorithm and their settings are this project's own choice."""

    seed: Seed = 0
    """Seed of the lanes, of exploration and of the initial weights."""
    games: Games = 5000
    """Games of the training."""
    simulator: Simulator = "mujoco"
    """mujoco, the exact simulator, or kernels: lanes over arrays, in threads or, with device cuda, on the GPU."""
    environments: Lanes = 1
    """Lanes flown in parallel, with mujoco each in its own process; must be 1 with timing wall."""
    turns: Processes = 1
    """Groups into which double_dqn divides the lanes: while it acts for and learns from one, the others fly."""
    env_id: EnvId = LANE
    """The environment: one of this package, or of one's own, a class as file.py:Class."""
    task: AnyTask = LaneTask()
    """The task that is learned: the keys of the environment. Its name in place of the keys, or as the key `class`
    beside them, is that of the environment: `task: my_task.py:MyTask`."""

    algorithm: str = DOUBLE_DQN
    """double_dqn or ppo, or an algorithm of stable-baselines3, which is an extra: sb3_dqn, sb3_ppo, sb3_a2c."""
    options: dict[str, Plain] = Field(default_factory=dict)
    """Hyperparameters that differ from the algorithm's defaults: the keys of DqnOptions for double_dqn, of PPOSettings
    for ppo, the keyword arguments of the class for an algorithm of stable-baselines3."""
    final_learning_rate_share: Ratio = 0.02
    """Learning rate at the last game, as a share of the initial one; it falls linearly over the games."""
    commands_per_gradient_step: Count = 4
    """Commands flown per gradient step, for algorithms with a replay buffer."""
    mirror: bool = True
    """Whether half of each batch is mirrored left to right: by double_dqn, as on average the lane is symmetric, and by
    ppo in tasks that say how, as Navigate (Task.mirrored)."""
    mirrored_decisions: bool = False
    """Whether the trained double_dqn policy averages its action values over the observation and its mirror image;
    otherwise it uses those of the observation alone."""
    start_from: Annotated[str, AfterValidator(name_beside)] | None = None
    """Policy whose weights double_dqn starts from: its folder, or default for the one that ships; None: random."""
    channels: Annotated[tuple[Channels, ...], Field(min_length=1, max_length=4)] = (16, 32)
    """Channels of each convolutional layer."""
    hidden: Annotated[tuple[Width, ...], Field(max_length=8)] = (256,)
    """Units of each fully connected hidden layer."""

    device: Device = "cpu"
    """PyTorch device on which the learner runs: cpu, mps, cuda or cuda:N."""
    torch_threads: Processes = 1
    """CPU threads of PyTorch; equal weights need an equal number."""
    checkpoint_games: Count = 250
    """Games between two checkpoints."""
    inference_s: Cost = 0.0005
    """Seconds that one decision takes on the simulated wall clock of timing virtual."""
    learning_s: Cost = 0.01
    """Seconds that one gradient step takes on the simulated wall clock of timing virtual."""

    @property
    def environment_class(self) -> type[FlightEnv[Any]]:
        """The class of the environment."""
        return environment_class(self.env_id)

    @property
    def on_device(self) -> bool:
        """Whether lanes and learner are together on a GPU."""
        return self.simulator == "kernels" and self.device.startswith("cuda")

    @model_validator(mode="after")
    def _lanes_fit(self) -> LearnerConfig:
        if getattr(self.task, "split", None) == "test":
            raise ValueError("task.split must be training: test lanes are kept for the numbers that are published")
        if self.task.timing == "wall" and self.environments > 1:
            raise ValueError("environments must be 1 with timing wall, and turns 1: neighbours would disturb the clock")
        if self.simulator == "mujoco" and self.environments > MOST_PROCESSES:
            raise ValueError(f"environments must be at most {MOST_PROCESSES}, a process each, with simulator mujoco")
        if self.simulator == "kernels":
            check_flyable(self.task, self.environments, self.device)
        if self.on_device and self.algorithm not in (PPO, DOUBLE_DQN):
            raise ValueError(f"simulator kernels with device cuda needs algorithm {DOUBLE_DQN} or {PPO}")
        if self.on_device and self.turns > 1:
            raise ValueError("turns must be 1 with simulator kernels and device cuda: all lanes fly at once")
        if self.turns > self.environments:
            raise ValueError(f"turns must be at most environments: {self.turns} of {self.environments} lanes")
        return self

    @model_validator(mode="after")
    def _algorithm_fits(self) -> LearnerConfig:
        discrete = is_discrete(self.task)
        if (self.algorithm == PPO) == discrete:
            actions, needed = ("discrete", DOUBLE_DQN) if discrete else ("continuous", PPO)
            raise ValueError(
                f"algorithm {self.algorithm} does not learn {self.env_id}, whose actions are {actions}: it needs "
                f"algorithm {needed}"
            )
        space: Any = self.task.action_space()
        if not discrete and not ((space.low == -1.0).all() and (space.high == 1.0).all()):
            raise ValueError(
                f"algorithm {PPO} learns actions from -1 to 1, which {self.env_id}.goal scales, not {space}"
            )
        for key in ("start_from", "mirrored_decisions"):
            if getattr(self, key) and self.algorithm != DOUBLE_DQN:
                raise ValueError(f"{key} needs algorithm double_dqn, not {self.algorithm}")
        if self.task.also_state and self.algorithm not in (PPO, DOUBLE_DQN):
            raise ValueError(f"task.also_state needs algorithm {DOUBLE_DQN} or {PPO}, not {self.algorithm}")
        for key in ("mirror", "mirrored_decisions"):
            if getattr(self, key) and self.algorithm != PPO and not is_symmetric(self.task):
                raise ValueError(f"{key} must be false: it needs pictures alone, and headings symmetric about 0")
        return self

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Let `options` have the keys of the algorithm, where that is one of this package's own."""
        made, own = super().__get_pydantic_json_schema__(core_schema, handler), (DqnOptions, PPOSettings)
        options = [handler(getattr(kind, "__pydantic_core_schema__")) for kind in own]  # noqa: B009
        named = [{"properties": {"algorithm": {"const": name}}, "required": ["algorithm"]} for name in OWN]
        cases = [*zip(named, options, strict=True), ({"properties": {"algorithm": False}}, {"anyOf": options})]
        whole = handler.resolve_ref_schema(made)
        whole["allOf"] = [{"if": case, "then": {"properties": {"options": keys}}} for case, keys in cases]
        whole["properties"]["algorithm"]["enum"] = ALGORITHMS.split(", ")
        return made

    @classmethod
    def keys_of(cls, mapping: Mapping[str, Any]) -> dict[str, Any]:
        """Return its keys with those of the task and of the algorithm's options that the mapping names."""
        every = {DOUBLE_DQN: DqnOptions.keys_of({}), PPO: PPOSettings.keys_of({})}
        options = every.get(str(mapping.get("algorithm")), every[DOUBLE_DQN] | every[PPO])
        return keys_with_task(super().keys_of(mapping), mapping) | {"options": options}


def keys_with_task(tree: dict[str, Any], mapping: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a configuration with those of the task of its `env_id`."""
    with suppress(UserError, AttributeError, ImportError, TypeError):  # which is wrong itself
        return tree | {"task": environment_class(mapping.get("env_id", LANE)).task_class.keys_of({})}
    return tree


def is_discrete(task: Task) -> bool:
    """Return whether a task's actions are numbered."""
    return isinstance(task.action_space(), spaces.Discrete)


def is_symmetric(task: Task) -> bool:
    """Return whether an observation that is turned left to right is one of the task, too, by its actions' headings."""
    headings = getattr(task, "headings_deg", ())
    mirrored = {-heading for heading in headings} == set(headings)
    return isinstance(task, LaneTask) and mirrored and task.observation != "state" and not task.also_state


class DqnOptions(Config):
    """Keys of `options` for `algorithm: double_dqn`, under the names that stable-baselines3 gives them."""

    learning_rate: Annotated[float, Field(gt=0.0, le=1.0)] = 3e-4
    """Initial learning rate of Adam."""
    buffer_size: Size = 150_000
    """Capacity of the replay buffer in commands, of all lanes together."""
    learning_starts: Annotated[int, Field(ge=0, le=LARGEST_SIZE)] = 2_000
    """Commands flown before learning begins, with random actions or, with start_from, those of that policy."""
    batch_size: Size = 32
    """Transitions per gradient step."""
    gamma: Ratio = 0.95
    """Discount factor per command."""
    n_steps: Annotated[int, Field(ge=1, le=1_000)] = 3
    """Commands whose rewards an n-step return adds before it bootstraps."""
    target_update_interval: Size = 2_000
    """Commands between two copies of the online network to the target network."""
    exploration_initial_eps: Ratio = 1.0
    """Share of random actions at the first game."""
    exploration_fraction: Ratio = 0.3
    """Share of the games over which exploration falls."""
    exploration_final_eps: Ratio = 0.01
    """Share of random actions from then on."""
    max_grad_norm: Positive = 10.0
    """Norm to which gradients are clipped."""

    @model_validator(mode="after")
    def _batches_come_from_the_buffer(self) -> DqnOptions:
        if self.batch_size > self.buffer_size:
            raise ValueError(
                f"batch_size must be at most buffer_size: {self.batch_size} of {self.buffer_size} commands"
            )
        return self

    @classmethod
    def of(cls, config: LearnerConfig) -> DqnOptions:
        """Return the options of a configuration. Raises UserError for an unknown key or a value out of range."""
        return validate(cls, config.options, f"options of {config.algorithm}")

    def exploration_rate(self, remaining: float) -> float:
        """Share of random actions while `remaining`, a share of the games from 1 to 0, is still to be flown."""
        done = 1.0 - remaining
        if done > self.exploration_fraction or not self.exploration_fraction:
            return self.exploration_final_eps
        fall = self.exploration_final_eps - self.exploration_initial_eps
        return self.exploration_initial_eps + done * fall / self.exploration_fraction


def check_algorithm(config: LearnerConfig) -> None:
    """Check algorithm and options without making a learner, as a dry run does.

    Raises UserError for an unknown algorithm, one whose package is missing, an unknown option, and a replay buffer that
    does not fit into this machine's memory.
    """
    key, stored = check_options(config)
    space, memory = config.task.observation_space(), memory_bytes()
    boxes = space.spaces.values() if config.task.also_state else [space]
    least = 4 if config.algorithm == PPO else 1  # bytes of a number: PPO keeps what its network takes
    needed = stored * sum(math.prod(box.shape) * max(box.dtype.itemsize, least) for box in boxes)
    if memory is not None and needed > memory and config.device == "cpu":
        raise UserError(
            f"options of {config.algorithm}: {key}: "
            f"{stored} observations take {needed / 1e9:.3g} GB; this machine has {memory / 1e9:.3g} GB"
        )


class PPOSettings(Config):
    """Keys of `options` for `algorithm: ppo`."""

    rollout: Annotated[int, Field(ge=1, le=1_000_000)] = 32
    """Commands of each environment between two updates, T."""
    epochs: Annotated[int, Field(ge=1, le=1_000)] = 2
    """Passes over a rollout."""
    minibatches: Annotated[int, Field(ge=1, le=1_000_000)] = 8
    """Gradient steps of a pass."""
    learning_rate: Annotated[float, Field(gt=0.0, le=1.0)] = 5e-4
    """Adam's learning rate at first."""
    gamma: Ratio = 0.99
    """Discount of a command."""
    smoothing: Ratio = 0.95
    """Lambda of the generalised advantages."""
    clip: Annotated[float, Field(gt=0.0, le=1.0)] = 0.2
    """Largest change of a probability ratio that is rewarded."""
    value_weight: Weight = 0.5
    """Weight of the value's error in the loss."""
    entropy_weight: Weight = 0.001
    """Weight of the entropy in the loss."""
    max_grad_norm: Annotated[float, Field(gt=0.0, le=1e6)] = 0.5
    """Norm to which gradients are clipped."""
    first_deviation: Annotated[float, Field(gt=0.0, le=10.0)] = 0.6
    """Standard deviation of the actions at first."""
    final_deviation: Annotated[float, Field(gt=0.0, le=10.0)] | None = None
    """Largest standard deviation at the end, to which it falls linearly, so that the policy learns to do without the
    noise; None: the deviation is learned freely."""
    divergence: Annotated[float, Field(gt=0.0, le=10.0)] | None = None
    """Kullback-Leibler divergence that gradient steps are to keep from the policy that flew: above twice this the
    learning rate falls by a third, below half of it it rises by half, at most to the schedule. None: as scheduled."""
    half_contrast: Annotated[float, Field(gt=0.0, le=1e6)] = HALF_CONTRAST
    """Distance from "no events", in grey levels, that the network sees at half strength."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """Number format in which the network computes during training; bfloat16 halves a GPU's time on pictures."""

    def check_samples(self, environments: int) -> None:
        """Raise UserError unless the minibatches divide the samples of a rollout in at least two samples each."""
        samples = environments * self.rollout
        if samples % self.minibatches or samples < 2 * self.minibatches:
            raise UserError(f"minibatches = {self.minibatches}: must divide the {samples} samples, 2 or more in each")

    @classmethod
    def of(cls, config: LearnerConfig) -> PPOSettings:
        """Return the options of a configuration. Raises UserError for an unknown key or a value that does not fit."""
        settings = validate(cls, config.options, f"options of {config.algorithm}")
        try:
            settings.check_samples(config.environments)
        except UserError as error:
            raise UserError(f"options of {config.algorithm}: {error}") from None
        return settings


def learns_from_a_buffer(algorithm: str) -> bool:
    """Return whether an algorithm has a replay buffer."""
    return algorithm in (DOUBLE_DQN, f"{SB3}dqn")


def check_options(config: LearnerConfig) -> tuple[str, int]:
    """Return how many observations the algorithm stores, and the option that decides it.

    Raises UserError for an unknown algorithm or option.
    """
    if config.algorithm == DOUBLE_DQN:
        return "buffer_size", DqnOptions.of(config).buffer_size
    if config.algorithm == PPO:
        return "rollout", PPOSettings.of(config).rollout * config.environments
    if config.algorithm not in ALGORITHMS.split(", "):
        raise UserError(f"algorithm = {config.algorithm!r} is unknown; there are {ALGORITHMS}")
    require("stable_baselines3", f"algorithm = {config.algorithm!r}", "sb3", "stable-baselines3")
    from uavaccel.rl.baseline import baseline_class  # loads PyTorch

    known = inspect.signature(baseline_class(config.algorithm)).parameters
    for name, value in config.options.items():
        if name not in known or name in RESERVED:
            there = ", ".join(each for each in known if each not in RESERVED)
            raise UserError(f"options of {config.algorithm}: unknown key {name!r}; known: {there}")
        if name in SIZES and not (type(value) is int and 1 <= value <= LARGEST_SIZE):
            raise UserError(
                f"options of {config.algorithm}: {name} = {value!r}: must be a whole number, 1 to {LARGEST_SIZE}"
            )
    size = "buffer_size" if "buffer_size" in known else "n_steps"
    held = int(config.options.get(size, known[size].default))
    return size, held if size == "buffer_size" else held * config.environments
