"""Files with trained policies: models of stable-baselines3, ONNX files, TorchScript; each for any Gymnasium spaces.

PyTorch, stable-baselines3 and onnxruntime are imported where a file needs them. An ONNX file is data. A `model.zip` of
stable-baselines3 has classes and spaces pickled, and unpickling runs any code: so its weights alone are read, and
beside them what is said in plain text of how the network is made: the policy's module, and its keywords as far as they
are plain or name classes of PyTorch and stable-baselines3. What else it needs is unpickled only if it is trusted. A
TorchScript file runs no Python, but PyTorch's own advice is to take it for a program: it is loaded if it is trusted.
"""

from __future__ import annotations

import io
import warnings
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.files import ARRAYS_BYTES, TEXT_BYTES, Plain, file_sha256, open_bounded, parse_json, read_bounded
from uavaccel.own_code import is_trusted
from uavaccel.realtime.server import one_line
from uavaccel.resources import require

Space: TypeAlias = spaces.Space[Any]
Observations: TypeAlias = Any
"""Observations (n, ...), or a mapping of parts (n, ...)."""
BatchPolicy = Callable[[Observations], NDArray[Any]]
"""Returns the actions, (n,) or (n, size), for observations (n, ...)."""

ALGORITHMS = {
    "stable_baselines3.common.policies": "PPO",  # A2C's are the same
    "stable_baselines3.dqn.policies": "DQN",
    "stable_baselines3.sac.policies": "SAC",
    "stable_baselines3.td3.policies": "TD3",  # and DDPG's
}
"""The algorithm that has the policies of a module."""
KNOWN = ("torch.nn.", "torch.optim.", "stable_baselines3.")  # begin the names of classes that a keyword may be
TORCHSCRIPT = (".pt", ".pth", ".ts", ".torchscript")
ONNX_BYTES = 64 * TEXT_BYTES
DTYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64, "tensor(uint8)": np.uint8}


def form_of(space: Space) -> str:
    """Return the form of observations or actions in words, as in "(13,)" or "one of 5"."""
    if isinstance(space, spaces.Discrete):
        return f"one of {space.start} to {space.start + space.n - 1}"
    if isinstance(space, spaces.Dict):
        return ", ".join(f"{name} {form_of(part)}" for name, part in sorted(space.spaces.items()))
    return str(space.shape)


def policy_file(name: str) -> PolicyFile | None:
    """Return the policy in a file of a known kind, by the ending of its name; None for any other name.

    Raises UserError where there is no such file, where it is of another kind, and where what runs it is not installed.
    """
    if name.endswith(".zip"):
        return Sb3File(name)
    if name.endswith(".onnx"):
        return OnnxFile(name)
    return TorchScriptFile(name) if name.endswith(TORCHSCRIPT) else None


class PolicyFile(ABC):
    """A file with a policy, which does not say what environment it was trained in."""

    state: Any = None
    """What has the `reset` of the policy that was loaded last, if it has one."""

    def __init__(self, name: str) -> None:
        self.name, self.file = name, Path(name)

    def forms(self, seen: Space, actions: Space) -> Iterator[tuple[str, str, str]]:
        """Yield "observations" and "actions", as far as their form is known, with the file's form and the space's."""
        yield from ()

    @abstractmethod
    def load(self, seen: Space, actions: Space) -> BatchPolicy:
        """Make the policy for two spaces. Raises UserError for weights that do not fit, and code that is not trusted.

        So does the policy, for answers that are no actions.
        """


def actions_of(answer: Any, count: int, space: Space, name: str) -> NDArray[Any]:
    """Return the actions in a network's answer (count, ...): vectors or, of discrete ones, numbers or ratings of each.

    Vectors are clipped to the bounds of their space. Raises UserError for an answer of another shape, and for numbers
    between two actions.
    """
    answer = np.atleast_1d(np.asarray(answer))
    if answer.dtype.kind not in "fiub":
        raise UserError(f"{name}: gives {one_line(answer)}, where numbers are needed")
    if not np.isfinite(answer).all():
        raise UserError(f"{name}: gives numbers that are NaN or infinite")
    taken: NDArray[Any]
    if isinstance(space, spaces.Discrete):
        if answer.shape == (count, space.n) and space.n > 1:
            return np.asarray(answer.argmax(axis=1) + space.start)
        taken = answer.astype(np.int64).ravel()
        fits = len(answer) == taken.size == count and bool((answer.ravel() == taken).all())
        fits = fits and bool(((taken >= space.start) & (taken < space.start + space.n)).all())
    elif isinstance(space, spaces.Box):
        fits = answer.shape == (count, *space.shape)
        taken = np.asarray(np.clip(answer, space.low, space.high) if fits else answer, space.dtype)
    else:
        raise UserError(f"{name}: flies one of a number of actions, or a Box of them, not {space}")
    if not fits:
        one_each = isinstance(space, spaces.Discrete) and answer.size == count
        what = one_line(answer.ravel().tolist()) if one_each else f"{answer.shape} numbers"
        raise UserError(f"{name}: gives {what} for {count} actions, each {form_of(space)}")
    return taken


# --- stable-baselines3 ------------------------------------------------------------------------------------------------


class NoOptimizer:
    """Stands for the optimizer of a policy that only flies: PyTorch's load its compiler, most of the start-up time."""

    def __init__(self, parameters: object, **_: object) -> None: ...


class Sb3File(PolicyFile):
    """A `model.zip` of PPO, A2C, DQN, SAC, TD3 or DDPG."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
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

    def forms(self, seen: Space, actions: Space) -> Iterator[tuple[str, str, str]]:
        for what, space in (("observation", _channels_first(seen)), ("action", actions)):
            own = {} if isinstance(space, spaces.Dict) else self._entry(f"{what}_space")
            if "n" in own and not own.get("_shape"):
                yield f"{what}s", f"one of 0 to {int(own['n']) - 1}", form_of(space)
            elif "_shape" in own:
                yield f"{what}s", str(tuple(own["_shape"] or ())), form_of(space)

    def load(self, seen: Space, actions: Space) -> BatchPolicy:
        """Make the policy. Raises UserError for weights that do not fit, and where only unpickling would restore it."""
        import torch as th

        try:
            policy = self._untrained(_channels_first(seen), actions)
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
        return lambda seen: np.asarray(policy.predict(seen, deterministic=True)[0])

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
            if isinstance(value, str) and not _known_class(value):
                return f"its policy_kwargs have {key} = {value}"
        return ""

    @cached_property
    def _keywords(self) -> dict[str, Plain]:
        """The keywords of the policy; what is not plain is a text, as Python prints it."""
        return {key: value for key, value in self._entry("policy_kwargs").items() if not key.startswith(":")}

    def _untrained(self, seen: Space, actions: Space) -> Any:
        """Make the policy with random weights, without its optimizers."""
        if not self._foreign:
            import stable_baselines3

            algorithm = ALGORITHMS[self._entry("policy_class")["__module__"]]
            keywords = {
                key: _known_class(value) if isinstance(value, str) else value
                for key, value in self._keywords.items()
                if not key.startswith("optimizer_")
            }
            if algorithm == "PPO":
                keywords["use_sde"] = bool(self._data.get("use_sde"))
            kind = "MultiInputPolicy" if isinstance(seen, spaces.Dict) else "CnnPolicy" if self._sees else "MlpPolicy"
            make: Any = getattr(stable_baselines3, algorithm).policy_aliases[kind]
            return make(seen, actions, lambda _: 0.0, **keywords, optimizer_class=NoOptimizer)
        _check_trusted(self.file, f"{self._foreign}: only unpickling restores that, which may run any code")
        from stable_baselines3.common.save_util import load_from_zip_file

        data, _, _ = load_from_zip_file(self.file, device="cpu")
        assert data is not None
        return data["policy_class"](seen, actions, lambda _: 0.0, **data["policy_kwargs"])

    @property
    def _sees(self) -> bool:
        """Whether its policy is the one of pictures."""
        return "CnnPolicy" in str(self._entry("policy_class").get("__init__"))


def _channels_first(seen: Space) -> Space:
    """Return observations as stable-baselines3 gives them to a policy, in whose pictures the channels come first."""
    from stable_baselines3.common.preprocessing import is_image_space, is_image_space_channels_first
    from stable_baselines3.common.vec_env import VecTransposeImage

    if isinstance(seen, spaces.Dict):
        return spaces.Dict({name: _channels_first(part) for name, part in seen.spaces.items()})
    if isinstance(seen, spaces.Box) and is_image_space(seen) and not is_image_space_channels_first(seen):
        return VecTransposeImage.transpose_space(seen)
    return seen


def _check_trusted(file: Path, why: str) -> None:
    if not is_trusted(file.resolve(), file_sha256(file)):
        raise UserError(f"{file}: {why}; if you trust the file, add --trust, once")


def _known_class(text: str) -> Any:
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


# --- networks alone ---------------------------------------------------------------------------------------------------


class OnnxFile(PolicyFile):
    """An ONNX file. Its inputs are named and shaped as the observations, or it has one; axis 0 is that of the batch.

    The output `action`, `actions` or the first is the action or, of discrete ones, a rating of each.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        require("onnxruntime", name, "onnx")
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1  # results do not depend on the machine's cores
        options.log_severity_level = 4
        try:
            content = read_bounded(self.file, ONNX_BYTES)
            self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except OSError as error:
            raise UserError(f"{name}: {error.strerror}") from error
        except UserError:
            raise
        except Exception as error:  # those of the runtime have no base class of their own
            raise UserError(f"{name}: is no ONNX file that onnxruntime runs: {one_line(error)}") from error
        self.metadata: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map

    def forms(self, seen: Space, actions: Space) -> Iterator[tuple[str, str, str]]:
        inputs = sorted((each.name, str(tuple(each.shape[1:]))) for each in self._session.get_inputs())
        named = len(inputs) > 1 or isinstance(seen, spaces.Dict)
        yield "observations", ", ".join(f"{name} {form}" if named else form for name, form in inputs), form_of(seen)
        shape = self._output.shape[1:]
        if len(shape) == 1 and isinstance(shape[0], int):
            first = actions.start if isinstance(actions, spaces.Discrete) else None
            own = f"({shape[0]},)" if first is None else form_of(spaces.Discrete(shape[0], start=first))
            yield "actions", own, form_of(actions)

    def load(self, seen: Space, actions: Space) -> BatchPolicy:
        return lambda observations: actions_of(*self._answer(observations), actions, self.name)

    @property
    def _output(self) -> Any:
        outputs = {each.name: each for each in self._session.get_outputs()}
        return outputs.get("action") or outputs.get("actions") or next(iter(outputs.values()))

    def _answer(self, observations: Observations) -> tuple[NDArray[Any], int]:
        """Return its answer, and to how many observations."""
        inputs = self._session.get_inputs()
        parts = observations if isinstance(observations, Mapping) else {inputs[0].name: observations}
        feeds = {each.name: parts[each.name].astype(DTYPES.get(each.type, np.float32)) for each in inputs}
        count = len(next(iter(feeds.values())))
        one_by_one = any(isinstance(each.shape[0], int) for each in inputs)
        groups = [slice(n, n + 1) for n in range(count)] if one_by_one else [slice(None)]
        try:
            runs = ({name: part[group] for name, part in feeds.items()} for group in groups)
            answers = [self._session.run([self._output.name], run)[0] for run in runs]
        except Exception as error:  # as above
            raise UserError(f"{self.name}: cannot be run on these observations: {one_line(error)}") from error
        return np.concatenate([np.atleast_1d(answer) for answer in answers]), count


class TorchScriptFile(PolicyFile):
    """What `torch.jit.save` has written: a module of a batch of observations, as a tensor or a dictionary of tensors.

    It answers as `module_policy` has it, on the CPU.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        if not self.file.is_file():
            raise UserError(f"{name}: no such file")
        require("torch", name, "realtime")

    def load(self, seen: Space, actions: Space) -> BatchPolicy:
        _check_trusted(self.file, "a TorchScript file is a program")
        import torch as th

        try:
            with open_bounded(self.file, ARRAYS_BYTES) as file, warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # of TorchScript itself
                module = th.jit.load(file, map_location="cpu")  # type: ignore[no-untyped-call]
        except UserError:
            raise
        except Exception as error:  # a file from elsewhere may have anything in it
            raise UserError(f"{self.name}: is no TorchScript file: {one_line(error)}") from error
        self.state = module.eval()
        return module_policy(self.state, actions, self.name)


def module_policy(module: Any, actions: Space, name: str) -> BatchPolicy:
    """Return the policy that a module of PyTorch is: observations of floats are given to it as float32.

    Its answer, or the first of several, is the action or, of discrete ones, a rating of each.
    """
    import torch as th

    weights = next(iter(module.parameters()), None)

    def tensor(part: Any) -> th.Tensor:
        part = np.asarray(part)
        found = th.as_tensor(part.astype(np.float32) if part.dtype.kind == "f" else part)
        return found if weights is None else found.to(weights.device)

    def policy(observations: Observations) -> NDArray[Any]:
        several = isinstance(observations, Mapping)
        given = {key: tensor(part) for key, part in observations.items()} if several else tensor(observations)
        count = len(next(iter(given.values())) if isinstance(given, dict) else given)
        try:
            with th.inference_mode():
                answer = module(given)
            answer = answer[0] if isinstance(answer, tuple | list) else answer
            answer = answer.cpu().numpy() if isinstance(answer, th.Tensor) else answer
        except Exception as error:  # whatever a module of anybody's raises
            raise UserError(f"{name}: cannot be run on these observations: {_last_line(error)}") from error
        return actions_of(answer, count, actions, name)

    return policy


def _last_line(error: Exception) -> str:
    """Return the last line of an error, since one of TorchScript lists the calls first, and its kind where that says
    more.
    """
    said = (str(error).strip().splitlines() or [""])[-1]
    return one_line(said if said and isinstance(error, RuntimeError) else f"{type(error).__name__}: {said}")
