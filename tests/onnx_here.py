"""ONNX files by the packages for these or, where they are not installed, files that hold the module itself."""

from __future__ import annotations

import pickle
import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from inspect import signature
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import cloudpickle
import pytest
import torch as th

PACKAGES = ("onnxscript", "onnxruntime")


@pytest.fixture
def onnx(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let ONNX files be written and run."""
    if all(find_spec(name) for name in PACKAGES):
        return
    for name in PACKAGES:
        module: Any = ModuleType(name)
        module.__spec__ = ModuleSpec(name, None)
        module.SessionOptions, module.InferenceSession = SimpleNamespace, Session
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(th.onnx, "export", export)


def write(path: str, module: th.nn.Module, *inputs: th.Tensor, batch: bool = False, **names: Any) -> None:
    shapes: Any = [{0: th.export.Dim("n", min=1)}] * len(inputs) if batch else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        how: Any = {"dynamic_shapes": shapes, "dynamo": True, "verbose": False, **names}
        program: Any = th.onnx.export(module.eval(), inputs, **how)
    Path(path).write_bytes(program.model_proto.SerializeToString())


def several(answer: Any) -> Sequence[th.Tensor]:
    return answer if isinstance(answer, tuple) else (answer,)


def export(module: Any, inputs: tuple[th.Tensor, ...], *, dynamic_shapes: Any, **names: Any) -> Any:
    """As torch.onnx.export: a program of the module, of its inputs and outputs, and of metadata."""

    def forms(named: Sequence[str], tensors: Sequence[th.Tensor]) -> list[SimpleNamespace]:
        shapes = [["n" if dynamic_shapes else len(each), *each.shape[1:]] for each in tensors]
        each_form = zip(named, shapes, strict=True)
        return [SimpleNamespace(name=name, shape=shape, type="tensor(float)") for name, shape in each_form]

    given = names.get("input_names") or [*signature(module.forward).parameters]
    about = (module, forms(given, inputs), forms(names.get("output_names", ["it"]), several(module(*inputs))))
    metadata: dict[str, str] = {}
    proto = SimpleNamespace(SerializeToString=lambda: cloudpickle.dumps((*about, metadata)))
    return SimpleNamespace(model=SimpleNamespace(metadata_props=metadata), model_proto=proto)


class Session:
    """As onnxruntime.InferenceSession, which takes inputs of these shapes and of float32 alone."""

    def __init__(self, content: bytes, options: Any, providers: Any) -> None:
        self._module, self._inputs, self._outputs, metadata = pickle.loads(content)
        self.get_inputs, self.get_outputs = lambda: self._inputs, lambda: self._outputs
        self.get_modelmeta = lambda: SimpleNamespace(custom_metadata_map=metadata)

    def run(self, names: Sequence[str], given: Mapping[str, Any]) -> list[Any]:
        tensors = [th.from_numpy(given[form.name]) for form in self._inputs]
        for form, each in zip(self._inputs, tensors, strict=True):
            sizes = zip(form.shape, each.shape, strict=True)
            if each.dtype != th.float32 or any(size not in (there, "n") for size, there in sizes):
                raise ValueError(f"{form.name} is {each.dtype} {each.shape}")
        with th.inference_mode():
            answers = several(self._module(*tensors))
        known = {form.name: each.numpy() for form, each in zip(self._outputs, answers, strict=True)}
        return [known[name] for name in names]
