"""Models that stable-baselines3 has saved, as agents: `model.zip` of PPO, A2C, DQN, SAC, TD3 or DDPG.

Such a file has classes and spaces pickled, and unpickling runs any code. So its weights alone are read, and beside
them what is said in plain text of how the network is made: the policy's module, and its keywords as far as they are
plain or name classes of PyTorch and stable-baselines3. What else a file needs is unpickled only if it is trusted.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from uavaccel.envs.task import Task
from uavaccel.errors import UserError
from uavaccel.files import ARRAYS_BYTES, TEXT_BYTES, Plain, file_sha256, open_bounded, parse_json
from uavaccel.own_code import is_trusted
from uavaccel.resources import require
from uavaccel.rl.agents import Agent, BatchAgent, Origin, form_of

ALGORITHMS = {
    "stable_baselines3.common.policies": "PPO",  # A2C's are the same
    "stable_baselines3.dqn.policies": "DQN",
    "stable_baselines3.sac.policies": "SAC",
    "stable_baselines3.td3.policies": "TD3",  # and DDPG's
}
"""The algorithm that has the policies of a module."""
KNOWN = ("torch.nn.", "torch.optim.", "stable_baselines3.")  # begin the names of classes that a keyword may be


class Sb3File(Origin):
    """A `model.zip`; it does not say which environment it was trained in."""

    file: Path

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.file = Path(name)
        require("stable_baselines3", name, "sb3", "stable-baselines3")
        try:
            with open_bounded(self.file, ARRAYS_BYTES) as file, zipfile.ZipFile(file) as archive:
                if archive.getinfo("data").file_size > TEXT_BYTES:
                    raise UserError(f"{name}: its data have more than {TEXT_BYTES:,} bytes")
                self._data: Mapping[str, Plain] = parse_json(archive.read("data"))
        except FileNotFoundError:
            raise UserError(f"{name}: no such file") from None
        except (OSError, KeyError, ValueError, zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
            raise UserError(f"{name}: is no model that stable-baselines3 has saved: {error}") from error

    def forms(self, task: Task) -> Iterator[tuple[str, str, str]]:
        of_task = {"observation": task.observation_space(), "action": task.action_space()}
        for what, space in of_task.items():
            own = {} if isinstance(space, spaces.Dict) else self._entry(f"{what}_space")
            if "n" in own:
                yield f"{what}s", f"one of 0 to {int(own['n']) - 1}", form_of(space)
            elif "_shape" in own:
                yield f"{what}s", str(tuple(own["_shape"] or ())), form_of(space)

    def make(self, task: Task) -> Agent:
        """Make the agent. Raises UserError for weights that do not fit, and where only unpickling would restore it."""
        import torch as th

        seen, actions = task.observation_space(), task.action_space()
        try:
            policy = self._untrained(seen, actions)
            with zipfile.ZipFile(self.file) as archive:
                if archive.getinfo("policy.pth").file_size > ARRAYS_BYTES:
                    raise UserError(f"{self.name}: its weights have more than {ARRAYS_BYTES:,} bytes")
                weights = th.load(io.BytesIO(archive.read("policy.pth")), weights_only=True, map_location="cpu")
            policy.load_state_dict(weights)
        except UserError:
            raise
        except Exception as error:  # a file from elsewhere may have anything in it
            said = str(error).partition("\n")[0].rstrip(":")
            raise UserError(f"{self.name}: its policy cannot be made for this task: {said}") from error
        policy.eval()
        return BatchAgent(lambda seen: np.asarray(policy.predict(seen, deterministic=True)[0]))

    def _entry(self, key: str) -> Mapping[str, Plain]:
        """Return what is said in plain text of an object; empty if nothing is."""
        found = self._data.get(key)
        return found if isinstance(found, Mapping) else {}

    @cached_property
    def _foreign(self) -> str:
        """What of the file is neither plain nor a class that is known, in words; empty if there is nothing."""
        module = self._entry("policy_class").get("__module__")
        if module not in ALGORITHMS:
            return f"its policy_class is of {module}"
        for key, value in self._keywords.items():
            if isinstance(value, str) and not _named(value):
                return f"its policy_kwargs have {key} = {value}"
        return ""

    @cached_property
    def _keywords(self) -> dict[str, Plain]:
        """The keywords of the policy; what is not plain is a text, as Python prints it."""
        return {key: value for key, value in self._entry("policy_kwargs").items() if not key.startswith(":")}

    def _untrained(self, seen: spaces.Space[Any], actions: spaces.Space[Any]) -> Any:
        """Make the policy with random weights, without its optimizers."""
        if not self._foreign:
            import stable_baselines3

            from uavaccel.rl.baseline import NoOptimizer

            algorithm = ALGORITHMS[self._entry("policy_class")["__module__"]]
            keywords = {
                key: _named(value) if isinstance(value, str) else value
                for key, value in self._keywords.items()
                if not key.startswith("optimizer_")
            }
            if algorithm == "PPO":
                keywords["use_sde"] = bool(self._data.get("use_sde"))
            kind = "MultiInputPolicy" if isinstance(seen, spaces.Dict) else "CnnPolicy" if self._sees else "MlpPolicy"
            make: Any = getattr(stable_baselines3, algorithm).policy_aliases[kind]
            return make(seen, actions, lambda _: 0.0, **keywords, optimizer_class=NoOptimizer)
        if not is_trusted(self.file.resolve(), file_sha256(self.file)):
            raise UserError(
                f"{self.name}: {self._foreign}: only unpickling restores that, which may run any code; if you trust "
                "the file, add --trust, once"
            )
        from stable_baselines3.common.save_util import load_from_zip_file

        data, _, _ = load_from_zip_file(self.file, device="cpu")
        assert data is not None
        return data["policy_class"](seen, actions, lambda _: 0.0, **data["policy_kwargs"])

    @property
    def _sees(self) -> bool:
        """Whether its policy is the one of pictures."""
        return "CnnPolicy" in str(self._entry("policy_class").get("__init__"))


def _named(text: str) -> Any:
    """Return the module or optimizer of PyTorch or stable-baselines3 that Python prints so; None for anything else."""
    import torch as th

    name = text.removeprefix("<class '").removesuffix("'>")
    module, _, attribute = name.rpartition(".")
    if text != f"<class '{name}'>" or not name.startswith(KNOWN):
        return None
    try:
        found = getattr(import_module(module), attribute, None)
    except ImportError:
        return None
    return found if isinstance(found, type) and issubclass(found, (th.nn.Module, th.optim.Optimizer)) else None
