"""Parts of compiled functions, which numba type-checks once and compiles only within the functions that call them.

`numba.njit` optimises each function with all of its callees, compiles it and a wrapper for Python, and then repeats
this for its caller: in a call tree of ten levels the leaves are compiled ten times. A `part` is kept as numba's first,
unoptimised intermediate code, which is linked into the entry points and compiled with them, once. Results are equal to
numba's, as without fast maths the order of optimisations does not change them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, ParamSpec, Protocol, TypeVar, overload
from uuid import uuid4

import numba
import numpy as np
from llvmlite import binding, ir
from numba import extending, types
from numba.core import caching, compiler
from numba.core.base import BaseContext
from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary
from numba.core.imputils import lower_constant
from numba.core.registry import CPUDispatcher
from numba.core.typing import Signature
from numba.extending import models, register_model
from numba.np import linalg

from uavaccel.errors import naming

P = ParamSpec("P")
R = TypeVar("R", covariant=True)

# numba asks for SciPy's BLAS when it loads its functions on arrays, which takes a quarter of a second, and again where
# one of them needs it.
_ask, linalg.ensure_blas = linalg.ensure_blas, lambda: None
import_module("numba.np.arraymath")
linalg.ensure_blas = _ask


class Compiled(Protocol[P, R]):
    """A compiled function, which is called as the Python function is declared."""

    @property
    def py_func(self) -> Callable[P, R]:
        """The function itself, in Python."""
        ...

    def __call__(self, *arguments: P.args, **named: P.kwargs) -> R: ...


class _Library(JITCodeLibrary):
    """Intermediate code that is linked into that of other functions, and never compiled by itself."""

    _merged: binding.ModuleRef | None = None

    def finalize(self) -> None:
        """Optimise nothing; callees are linked in where the caller is compiled."""
        self._finalize_dynamic_globals()
        self._finalized = True

    def _within(self) -> list[CPUCodeLibrary]:
        """Return this library and all that it needs, each after those that need it: the linker drops what is unused."""
        found: dict[CPUCodeLibrary, None] = {}
        for library in self._linking_libraries:
            for needed in library._within() if isinstance(library, _Library) else [library]:
                found.pop(needed, None)
                found[needed] = None
        return [self, *found]

    def _get_module_for_linking(self) -> binding.ModuleRef:
        if self._merged is None:
            self._merged = super()._get_module_for_linking().clone()
            for library in self._within()[1:]:
                self._reload_init.update(library._reload_init)
                module = (
                    super(_Library, library)._get_module_for_linking()
                    if isinstance(library, _Library)
                    else library._get_module_for_linking()
                )
                self._merged.link_in(module, preserve=True)
        return self._merged


class _Compiler(compiler.CompilerBase):
    """numba's own passes, without machine code and wrappers."""

    def define_pipelines(self) -> list[compiler.PassManager]:
        state = self.state
        state.flags.no_compile = state.flags.no_cpython_wrapper = state.flags.no_cfunc_wrapper = True
        state.library = _Library(state.targetctx.codegen(), state.func_id.func_qualname)
        return [compiler.DefaultPassBuilder.define_nopython_pipeline(state)]


class PartType(types.Dispatcher):
    """The type of a part; as an argument of another part it has no value, so that numba can cache its callers."""


register_model(PartType)(models.OpaqueModel)


@lower_constant(PartType)
def _no_value(context: BaseContext, builder: object, part_type: PartType, value: object) -> ir.Constant:
    return context.get_dummy_value()


class Part(CPUDispatcher):
    """A function that compiled functions call; called from Python, it is compiled by itself."""

    def __init__(self, function: Callable[..., object], inline: bool, options: dict[str, object]) -> None:
        super().__init__(function, targetoptions={"nopython": True, **options}, pipeline_class=_Compiler)
        self._inline = inline

    @property
    def _numba_type_(self) -> PartType:
        return PartType(self)

    def add_overload(self, result: compiler.CompileResult) -> None:
        """Register a specialisation for its callers, under a key of its own in place of an address."""
        result = result._replace(entry_point=object())
        if not self._inline:
            result.library.get_function(result.fndesc.llvm_func_name).add_function_attribute("noinline")
        self.targetctx.insert_user_function(result.entry_point, result.fndesc, [result.library])
        self.overloads[tuple(result.signature.args)] = result

    def get_call_template(self, args: tuple[types.Type, ...], kws: dict[str, types.Type]) -> tuple[object, ...]:
        """Compile for integers, not for each constant that is passed: an entry point folds constants anyway."""
        named = {name: types.unliteral(each) for name, each in kws.items()}
        template: tuple[object, ...] = super().get_call_template(tuple(map(types.unliteral, args)), named)
        return template

    def __call__(self, *arguments: object, **named: object) -> object:
        return self._alone(*arguments, **named)

    @cached_property
    def _alone(self) -> Callable[..., object]:
        options = {name: value for name, value in self.targetoptions.items() if name != "nopython"}
        return njit(**options)(self.py_func)


class _ChosenType(PartType):
    """The type of what `chosen_by_types` makes."""

    def _of(self, args: tuple[types.Type, ...]) -> PartType:
        chosen: PartType = self.dispatcher.choose(*args)._numba_type_
        return chosen

    def get_call_type(self, context: object, args: tuple[types.Type, ...], kws: dict[str, types.Type]) -> object:
        return self._of(args).get_call_type(context, args, kws)

    def get_overload(self, sig: Signature) -> object:
        return self._of(sig.args).get_overload(sig)


register_model(_ChosenType)(models.OpaqueModel)


class _Chosen:
    is_compiling = False  # which numba asks of dispatchers

    def __init__(self, choose: Callable[..., object]) -> None:
        self.choose = choose

    @property
    def _numba_type_(self) -> _ChosenType:
        return _ChosenType(self)


def chosen_by_types(choose: Callable[..., object]) -> Any:
    """Decorate a function of numba's types of arguments that returns the part to call with them: a `Part` as they are.

    numba's own `overload` compiles what it chooses by itself, with all that this calls.
    """
    return _Chosen(choose)


@overload
def part(function: Callable[P, R], /) -> Compiled[P, R]: ...
@overload
def part(*, inline: bool = True, **options: object) -> Callable[[Callable[P, R]], Compiled[P, R]]: ...
def part(function: Callable[..., object] | None = None, /, *, inline: bool = True, **options: object) -> object:
    """Decorate a function that compiled functions call, with njit's options or without.

    Without `inline` it is compiled once and called; otherwise each of its callers may inline it.
    """
    if function is None:
        return lambda inner: Part(inner, inline, options)
    return Part(function, inline, options)


def njit(**options: object) -> Callable[[Callable[P, R]], Compiled[P, R]]:
    """Return `numba.njit`, with options, as a typed decorator."""
    decorator: Callable[[Callable[P, R]], Compiled[P, R]] = numba.njit(**options)
    return decorator


Real = TypeVar("Real", float, np.float32)


def times(a: Real, b: Real) -> Real:
    """Return a * b, rounded before anything is added to it, on CPU and GPU alike.

    A GPU's compiler fuses a product with a following sum, which rounds once where v2e rounds twice. With numba-cuda
    `uavaccel.kernels.cuda` defines it for the GPU.
    """
    return a * b


@extending.overload(times)
def _on_cpu(a, b):  # type: ignore[no-untyped-def]  # numba compares its signature with the lambda's
    return lambda a, b: a * b


# --- code on disk ---------------------------------------------------------------------------------------------------


def save_apart(self: caching.IndexDataCacheFile, key: object, code: object) -> None:
    """Save code in a file of its own, and then the index that tells of it.

    numba tells of it first, under a number that is free in the index that it has read. Of many processes that start at
    once, one could load code of older sources, or of another specialisation that was given the same number meanwhile.
    Raises UserError, naming the folder, where the system refuses to write.
    """
    with naming(folder := Path(self._cache_path)):
        if not self._load_index():  # there is none, or it is of older sources
            for old in folder.glob(self._index_name.removesuffix("nbi") + "*.nbc"):
                old.unlink(missing_ok=True)
        name = self._data_name(uuid4().int)
        self._save_data(name, code)
        self._save_index({**self._load_index(), key: name})


caching.IndexDataCacheFile.save = save_apart
