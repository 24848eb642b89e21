"""Strict configurations: one clear line for what is invalid, and stable YAML of what is valid.

A suite declares a subclass of `Config`; the key `suite` of an experiment's YAML selects it. Values are checked as in
JSON: "3" is not a number, yes is not an integer, and a list may fill a tuple.

YAML is read and written by rules that differ from PyYAML's own in four points: 1e-3 is a number, as in YAML 1.2; a date
is text; a duplicate key in a mapping and tags such as !!binary, which no JSON has, are refused.

The types of values, such as `Seconds`, have limits far beyond any use, within what numbers, clocks and machines can
represent.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import reprlib
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from difflib import get_close_matches
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from textwrap import dedent
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, TypeVar, get_args, get_origin

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails
from yaml.constructor import ConstructorError, SafeConstructor

from uavaccel.errors import UsageError, UserError, suggestion
from uavaccel.files import Plain, read_bounded
from uavaccel.units import CLOCK_SPEEDS, plain

if TYPE_CHECKING:
    from pydantic import GetJsonSchemaHandler
    from pydantic.json_schema import JsonSchemaValue
    from pydantic_core import CoreSchema

MOST_GAMES = 1_000_000
MOST_ROUNDS = 100_000
MOST_SPEED_M_S = 1_000.0
MOST_HEIGHT_M = 4_000.0  # in the thinner air above, the quadrotor soon cannot hover
MOST_SECONDS = 86_400.0
MOST_LATENCY_US = 60e6
MOST_SCALE = 1_000.0
MOST_PROCESSES = 1_024
MOST_LANES = 65_536  # over arrays
MOST_SEEDS = 1 << 32

CommandName = Annotated[
    Literal["adsc", "tcsc"],
    BeforeValidator(
        lambda name: name.lower() if isinstance(name, str) else name,
        json_schema_input_type=Literal["adsc", "tcsc", "ADSC", "TCSC"],
    ),
]
"""In any case, as the paper and the pages have capitals; kept in lower case."""
Seed = Annotated[int, Field(ge=0, lt=MOST_SEEDS)]
"""A seed that NumPy's and torch's generators accept."""
Count = Annotated[int, Field(ge=1, le=1_000_000)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Games = Annotated[int, Field(ge=1, le=MOST_GAMES)]
Processes = Annotated[int, Field(ge=1, le=MOST_PROCESSES)]
Lanes = Annotated[int, Field(ge=1, le=MOST_LANES)]
ClockSpeed = Annotated[float, Field(gt=0.0, ge=CLOCK_SPEEDS[0], le=CLOCK_SPEEDS[1])]
Speed = Annotated[float, Field(gt=0.0, le=MOST_SPEED_M_S)]
Velocity = Annotated[float, Field(ge=-MOST_SPEED_M_S, le=MOST_SPEED_M_S)]
Height = Annotated[float, Field(gt=0.0, le=MOST_HEIGHT_M)]
Seconds = Annotated[float, Field(gt=0.0, le=MOST_SECONDS)]
Cost = Annotated[float, Field(ge=0.0, le=3_600.0)]
"""A cost in seconds on a modelled wall clock."""
LatencyUs = Annotated[float, Field(ge=0.0, le=MOST_LATENCY_US)]


class Config(BaseModel):
    """Base of every configuration, which has no unknown keys and no infinite numbers, and is immutable.

    A docstring below a field is that field's description in the JSON schema.
    """

    # With use_attribute_docstrings the source of each class would be read at every program's start.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True)

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Keep a key's words and limits where a class names it again, with another default, by a bare type."""
        found = False
        for base in (each for each in cls.__bases__ if issubclass(each, Config)):
            for name, before in base.model_fields.items():
                now = cls.model_fields.get(name, before)
                bare = isinstance(now.annotation, type) and not (now.metadata or issubclass(now.annotation, Config))
                if bare and (now.annotation, []) != (before.annotation, before.metadata):
                    now.annotation, now.metadata, found = before.annotation, [*before.metadata], True
        if found:
            cls.model_rebuild(force=True)

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        made = handler(core_schema)
        properties = handler.resolve_ref_schema(made).get("properties", {})
        for name, text in _field_docstrings(cls).items():
            properties.get(name, {}).setdefault("description", text)
        return made

    @classmethod
    def keys_of(cls, mapping: Mapping[str, Any]) -> KeyTree:
        """Return the keys that a mapping of this configuration may have, nested as they are."""
        return _key_tree(cls)


KeyTree: TypeAlias = dict[str, Any]  # keys, and below each those of what it holds
_YAML_WORDS = {
    "list_type": "should be a list",
    "tuple_type": "should be a list",
    "model_type": "should be a mapping",
    "model_attributes_type": "should be a mapping",
    "dict_type": "should be a mapping",
}
_NAME, _NAME_OR_NONE, _DEVICE = r"^[a-z0-9_]+$", r"^[a-z0-9_]*$", r"^(cpu|mps|cuda(:[0-9]+)?)$"
_PATTERN_WORDS = {
    _NAME: "should be lower-case letters, digits and underscores",
    _NAME_OR_NONE: "should be lower-case letters, digits and underscores",
    _DEVICE: "should be cpu, mps, cuda or one of several GPUs, as cuda:1",
}
Name = Annotated[str, Field(pattern=_NAME)]
NameOrNone = Annotated[str, Field(pattern=_NAME_OR_NONE)]
Device = Annotated[str, Field(pattern=_DEVICE)]

ConfigType = TypeVar("ConfigType", bound=Config)


def apply_overrides(mapping: Mapping[str, object], overrides: Iterable[str]) -> dict[str, Plain]:
    """Return a copy of `mapping` with each "dotted.key=value" applied in turn; values are YAML.

    A number indexes a list; missing mappings on the way to a key are created. Raises UsageError if an override is not
    key=value, UserError if its key leads through a value without keys, or if its value is not YAML.
    """
    result = deepcopy(dict(mapping))
    for override in overrides:
        dotted, value = parse_override(override)
        assign(result, dotted, value, f"--set {override}")
    return result


def parse_override(override: str) -> tuple[str, Plain]:
    """Return key and value of a "dotted.key=value". Raises UsageError or UserError as `apply_overrides` does."""
    dotted, equals, text = override.partition("=")
    if not equals or not all(dotted.split(".")):
        raise UsageError(f"--set {override}: must be dotted.key=value")
    return dotted, parse_yaml(text, source=f"--set {override}")


def dotted_keys(value: object, key: str = "") -> dict[str, Plain]:
    """Return the values in nested mappings by dotted key; an empty mapping is a value."""
    if not isinstance(value, Mapping) or not value:
        return {key: value}
    leaves: dict[str, Plain] = {}
    for name, inner in value.items():
        leaves |= dotted_keys(inner, f"{key}.{name}" if key else str(name))
    return leaves


def assign(target: Plain, dotted: str, value: object, source: str) -> None:
    """Assign a value in nested mappings and lists, creating mappings on the way. Raises UserError, naming `source`."""
    parts = dotted.split(".")
    for depth in range(1, len(parts)):
        position = _position(target, parts[:depth], source)
        if isinstance(target, dict) and target.get(position) is None:
            target[position] = {}
        target = target[position]
    target[_position(target, parts, source)] = value


def _position(container: object, parts: list[str], source: str) -> str | int:
    """Return the last of `parts` as a key or index of `container`."""
    part = parts[-1]
    if isinstance(container, dict):
        return part
    if isinstance(container, list) and part.isdecimal() and int(part) < len(container):
        return int(part)
    held = f"elements 0 to {len(container) - 1}" if isinstance(container, list) else reprlib.repr(container)
    raise UserError(f"{source}: no {part!r} in {'.'.join(parts[:-1])}, which holds {held}")


def validate(
    cls: type[ConfigType], mapping: Mapping[str, object], source: str, given: Mapping[str, str] | None = None
) -> ConfigType:
    """Return an instance of `cls` from plain data; UserError names `source`, key, value and what would be right.

    `given` names, by dotted key, the options that gave values in place of `source`.
    """
    try:
        return cls.model_validate_json(json.dumps(mapping, default=_as_yaml), strict=True)
    except ValidationError as error:
        first = _leading(error)
        key = _dotted(mapping, first)
        held = key.rpartition(".")[0] if first["type"] == "missing" else key  # a missing key's input holds the others
        giver = _giver(dotted_keys(first["input"], held) if held else (), first["msg"], given or {}, source)
        raise UserError(f"{giver}: {_explain(cls, mapping, error)}") from error
    except UserError as error:  # raised by a validator
        giver, said = _giver((), str(error), given or {}, source), str(error)
        raise type(error)(said if said.startswith(giver) else f"{giver}: {said}") from error
    except (TypeError, ValueError) as error:
        raise UserError(f"{source}: not made of text, numbers, lists and mappings: {error}") from error


def _as_yaml(value: object) -> object:
    """Return NumPy's numbers and arrays, and paths, as YAML has them. Raises TypeError for anything else."""
    if (made := str(value) if isinstance(value, Path) else plain(value)) is value:
        raise TypeError(f"{value!r} is none of these")
    return made


def _giver(keys: Collection[str], said: str, given: Mapping[str, str], source: str) -> str:
    """Return the option that gave all `keys` of a wrong value, or one of those that an error names; else `source`."""
    givers = [next((given[own] for own in given if f"{key}.".startswith(f"{own}.")), "") for key in keys]
    if givers and all(givers):
        return givers[0]
    for own, option in given.items():
        name = own.rstrip(".0123456789").rpartition(".")[2]  # of a list's element, the list's
        if re.search(rf"\b{re.escape(name)}\b", f"{' '.join(keys)} {said}"):
            return option
    return source


def to_yaml(config: Config) -> str:
    """Return YAML of a configuration, keys in the order of its fields; equal configurations give equal text."""
    return dump_yaml(config.model_dump(mode="json"))


def schema(cls: type[Config]) -> dict[str, Plain]:
    """Return the JSON schema of a configuration's YAML, for editors."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **cls.model_json_schema()}


def _field_docstrings(cls: type[Config]) -> dict[str, str]:
    """Return what stands below the fields of a class and of those that it is derived from."""
    found: dict[str, str] = {}
    for each in [each for each in cls.__mro__[::-1] if issubclass(each, Config)]:
        with suppress(OSError, TypeError):  # its source is not there
            [definition] = ast.parse(dedent(inspect.getsource(each))).body
            for pair in pairwise(getattr(definition, "body", [])):
                match pair:
                    case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                        found[name] = inspect.cleandoc(text)
    return found


def _leading(error: ValidationError) -> ErrorDetails:
    """Return the most helpful error: an unknown key, which may be why another is missing, or the innermost one.

    A key that one of a union's mappings knows, with another value, is not unknown.
    """
    errors = error.errors(include_url=False)
    lacking = ("extra_forbidden", "missing")
    known = {(each["loc"][0], each["loc"][-1]) for each in errors if each["type"] not in lacking and each["loc"]}

    def order(each: ErrorDetails) -> tuple[bool, int, bool]:
        unknown = each["type"] == "extra_forbidden" and (each["loc"][0], each["loc"][-1]) not in known
        return not unknown, -len(each["loc"]), each["type"] in lacking

    return min(errors, key=order)


def _explain(cls: type[Config], mapping: Mapping[str, object], error: ValidationError) -> str:
    first = _leading(error)
    key = _dotted(mapping, first)
    if first["type"] == "extra_forbidden":
        unknown = str(first["loc"][-1])
        above = key.removesuffix(unknown).split(".")[:-1]
        return f"unknown key {key!r}; {suggested_key(cls.keys_of(mapping), above, unknown)}"
    field = (
        cls.model_fields.get(str(first["loc"][0])) if len(first["loc"]) == 1 + (first["type"] == "missing") else None
    )
    members = get_args(field.annotation) if field is not None and get_origin(field.annotation) is tuple else ()
    if first["type"] in ("tuple_type", "too_long", "missing") and members and Ellipsis not in members:
        return f"{first['loc'][0]} = {reprlib.repr(first['input'])}: should be a list of {len(members)}"
    if first["type"] == "missing" and isinstance(first["input"], list):
        whole = key.rpartition(".")[0]  # the key is that of the first value it lacks
        return f"{whole} = {reprlib.repr(first['input'])}: should have more values"
    return explain_value(mapping, first)


def explain_value(mapping: object, error: ErrorDetails) -> str:
    """Return the dotted key of an error in plain data, the value, and what would be right."""
    key = _dotted(mapping, error)
    if error["type"].startswith("union_tag_"):  # of the key that says which of several mappings this one is
        *_, name, _ = error["ctx"]["discriminator"].split("'")  # its alias is the last one in quotes
        inner = f"{key}.{name}" if key else name
        if "tag" not in error["ctx"]:
            return f"key '{inner}' is missing"
        given = reprlib.repr(error["input"].get(name, error["ctx"]["tag"]))
        return f"{inner} = {given}: should be one of {error['ctx']['expected_tags']}"
    if error["type"] == "missing":
        return f"key {key!r} is missing"
    wanted = _wanted(error)
    return f"{key} = {reprlib.repr(error['input'])}: {wanted}" if key else wanted


def _wanted(error: ErrorDetails) -> str:
    """Return what would be right."""
    kind, limits = error["type"], error.get("ctx", {})
    if kind in ("too_short", "too_long"):
        count = limits["min_length"] if kind == "too_short" else limits["max_length"]
        number = "one value" if count == 1 else f"{count} values"
        return f"needs at least {number}" if kind == "too_short" else f"may have at most {number}"
    if kind == "string_pattern_mismatch" and (words := _PATTERN_WORDS.get(limits["pattern"])):
        return words
    return _YAML_WORDS.get(
        kind, error["msg"].removeprefix("Value error, ").removeprefix("Input ").removeprefix("String ")
    )


def _dotted(mapping: object, error: ErrorDetails) -> str:
    """Return the key of an error as `apply_overrides` takes it, without pydantic's names of a union's members."""
    parts: list[str] = []
    value: Plain = mapping
    above = error["loc"][:-1] if error["type"] in ("missing", "extra_forbidden") else error["loc"]
    found = 0
    for depth, part in enumerate(above, start=1):
        with suppress(KeyError, IndexError, TypeError):
            value = value[part]
            parts.append(str(part))
            found = depth
    if above is error["loc"] and isinstance(value, Mapping) and error["input"] != value:  # of a default
        parts += map(str, above[found:])
    return ".".join([*parts, *map(str, error["loc"][len(above) :])])


def _key_tree(annotation: object) -> KeyTree:
    """Return the keys of a model, or of those in an annotation, of which a union has several."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return {name: _key_tree(field.annotation) for name, field in annotation.model_fields.items()}
    return {name: tree for inner in get_args(annotation) for name, tree in _key_tree(inner).items()}


def suggested_key(tree: KeyTree, path: Sequence[str], unknown: str) -> str:
    """Suggest what an unknown key at `path` in a configuration may mean, there or at another level of it, dotted."""
    here = tree
    for part in path:
        here = here.get(part, here)  # list indices and names of entries have no keys of their own
    if unknown in here:
        return "it does not go with those beside it"
    elsewhere: dict[str, list[str]] = {}
    for dotted in dotted_keys(tree):
        parts = dotted.split(".")
        for end in range(1, len(parts) + 1):
            elsewhere.setdefault(parts[end - 1], []).append(".".join(parts[:end]))
    close, beside = get_close_matches(unknown, elsewhere, n=1, cutoff=0.85), get_close_matches(unknown, here, n=1)
    for name in [unknown] * (unknown in elsewhere) + close * (not beside):
        if name not in here:
            return f"did you mean {min(elsewhere[name], key=lambda dotted: dotted.count('.'))!r}?"
    return f"did you mean {'.'.join([*path, *beside])!r}?" if beside else suggestion(unknown, list(here))


_FLOAT = "tag:yaml.org,2002:float"
_INT, _TIMESTAMP = "tag:yaml.org,2002:int", "tag:yaml.org,2002:timestamp"
_NOT_PLAIN = {_TIMESTAMP, *(f"tag:yaml.org,2002:{kind}" for kind in ("binary", "omap", "pairs", "set"))}
_EXPONENT_ALONE = re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+$")
_WHOLE = re.compile(r"[-+]?[0-9][0-9_]*$|0x[0-9a-fA-F]+$")  # neither 010 for 8 nor 1:30 for 90, as YAML 1.1 has it

_RESOLVERS = {
    first: [(tag, pattern) for tag, pattern in rules if tag not in (_INT, _TIMESTAMP)]
    for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _first in "-+0123456789":
    _RESOLVERS.setdefault(_first, []).extend([(_INT, _WHOLE), (_FLOAT, _EXPONENT_ALONE)])
MOST_VALUES = 1_000_000
MOST_LEVELS = 5_000  # of nesting, far below those at which libyaml crashes


def _whole(loader: object, node: yaml.ScalarNode) -> int:
    return int(node.value, 16 if node.value.startswith("0x") else 10)


class _Rules(SafeConstructor):
    yaml_implicit_resolvers = _RESOLVERS
    yaml_constructors = {
        tag: construct for tag, construct in yaml.SafeLoader.yaml_constructors.items() if tag not in _NOT_PLAIN
    } | {_INT: _whole}

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Plain]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise ConstructorError(problem="a key is not text", problem_mark=key.start_mark)
            if key.value in seen:
                problem = f"key {key.value!r} stands twice in one mapping"
                raise ConstructorError(problem=problem, problem_mark=key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


class _Loader(_Rules, yaml.SafeLoader):
    pass


class _QuickLoader(_Rules, getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """libyaml's, seven times as fast; text that is nested too deep crashes it, and it says less of what is wrong."""


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    yaml_implicit_resolvers = _RESOLVERS

    def ignore_aliases(self, data: object) -> bool:
        return True  # a value that stands twice is written twice

    def represent_sequence(
        self, tag: str, sequence: Iterable[object], flow_style: bool | None = None
    ) -> yaml.SequenceNode:
        node: yaml.SequenceNode = super().represent_sequence(tag, sequence, flow_style)
        node.flow_style = all(isinstance(item, yaml.ScalarNode) for item in node.value)
        return node


def load_yaml(path: str | Path) -> dict[str, Plain]:
    """Return the mapping in a YAML file.

    Raises UserError, with the file and the line, if it cannot be read, is not YAML, no mapping, or has a key twice.
    """
    try:
        text = read_bounded(Path(path)).decode("utf-8")
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: not UTF-8 text") from error
    value = parse_yaml(text, str(path))
    if isinstance(value, dict):
        return value
    found = "nothing" if value is None else f"a {type(value).__name__}"
    raise UserError(f"{path}: must be a mapping, lines of 'key: value', but holds {found}")


def parse_yaml(text: str, source: str) -> Plain:
    """Return the value of a YAML text. Raises UserError, naming `source`, if it is not YAML."""
    try:
        return deepcopy(_bounded(_read(text), source))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f" line {mark.line + 1}:" if mark else ""
        said = error.problem or error.context
        said = f"{error.context}, {said}" if str(said).startswith("but ") else said  # the half of a sentence
        raise UserError(f"{source}:{line} {said}") from error
    except RecursionError:
        raise UserError(f"{source}: not YAML: nested too deep") from None
    except (yaml.YAMLError, ValueError) as error:
        raise UserError(f"{source}: not YAML: {str(error).splitlines()[0]}") from error


@lru_cache(maxsize=8)
def _read(text: str) -> Plain:
    """Return the value of a text; cached, as a report reads its run's configuration a dozen times."""
    longest = max(map(len, text.splitlines()), default=0)  # a block's levels take a character of a line each
    if text.count("[") + text.count("{") + longest < MOST_LEVELS:
        with suppress(yaml.YAMLError, ValueError):
            return yaml.load(text, Loader=_QuickLoader)
    return yaml.load(text, Loader=_Loader)


def _bounded(value: Plain, source: str) -> Plain:
    """Return the value. Raises UserError where aliases expand it beyond any reasonable size."""
    pending = [value]
    for _ in range(MOST_VALUES):
        each = pending.pop()
        pending.extend(each.values() if isinstance(each, dict) else each if isinstance(each, list) else ())
        if not pending:
            return value
    raise UserError(f"{source}: more than {MOST_VALUES:,} values, aliases counted each time")


def dump_yaml(mapping: Mapping[str, object]) -> str:
    """Return YAML of plain data, keys in their order, short lists on one line; equal data give equal text."""
    return yaml.dump(dict(mapping), Dumper=_Dumper, sort_keys=False, default_flow_style=False, width=110)
