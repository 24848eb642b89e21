"""YAML as plain data, read and written by the same rules.

They differ from PyYAML's own in four points: 1e-3 is a number, as in YAML 1.2; a date is text; a duplicate key in a
mapping and tags such as !!binary, which no JSON has, are refused.
"""

import re
from collections.abc import Hashable, Iterable, Mapping
from copy import deepcopy
from functools import lru_cache
from pathlib import Path

import yaml
from yaml.constructor import ConstructorError, SafeConstructor

from uavaccel.errors import UserError
from uavaccel.files import Plain, read_bounded

_FLOAT = "tag:yaml.org,2002:float"
_TIMESTAMP = "tag:yaml.org,2002:timestamp"
_NOT_PLAIN = {_TIMESTAMP, *(f"tag:yaml.org,2002:{kind}" for kind in ("binary", "omap", "pairs", "set"))}
_EXPONENT_ALONE = re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+$")


def _resolvers() -> dict[str, list[tuple[str, re.Pattern[str]]]]:
    rules = {
        first: [(tag, pattern) for tag, pattern in rules if tag != _TIMESTAMP]
        for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    for first in "-+0123456789":
        rules.setdefault(first, []).append((_FLOAT, _EXPONENT_ALONE))
    return rules


MOST_VALUES = 1_000_000


class _Rules(SafeConstructor):
    yaml_implicit_resolvers = _resolvers()
    yaml_constructors = {  # noqa: RUF012  as PyYAML has it
        tag: construct for tag, construct in yaml.SafeLoader.yaml_constructors.items() if tag not in _NOT_PLAIN
    }

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
    """libyaml's, twenty times as fast; text that is nested too deep crashes it."""


class _Dumper(yaml.SafeDumper):
    yaml_implicit_resolvers = _resolvers()

    def ignore_aliases(self, data: object) -> bool:
        return True  # a value that stands twice is written twice

    def represent_sequence(
        self, tag: str, sequence: Iterable[object], flow_style: bool | None = None
    ) -> yaml.SequenceNode:
        node = super().represent_sequence(tag, sequence, flow_style)
        node.flow_style = all(isinstance(item, yaml.ScalarNode) for item in node.value)
        return node


def load_yaml(path: str | Path, shipped: bool = False) -> dict[str, Plain]:
    """Return the mapping in a YAML file; one that is `shipped` with the package is read by a quicker parser.

    Raises UserError, naming the file and where possible the line, if it cannot be read, is not YAML, has a duplicate
    key or is not a mapping.
    """
    try:
        text = read_bounded(Path(path)).decode("utf-8")
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: not UTF-8 text") from error
    value = parse_yaml(text, str(path), shipped)
    if not isinstance(value, dict):
        found = "nothing" if value is None else f"a {type(value).__name__}"
        raise UserError(f"{path}: must be a mapping, lines of 'key: value', but holds {found}")
    return value


def parse_yaml(text: str, source: str, shipped: bool = False) -> Plain:
    """Return the value of a YAML text. Raises UserError, naming `source`, if it is not YAML."""
    try:
        return deepcopy(_bounded(_read(text, shipped), source))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f" line {mark.line + 1}:" if mark else ""
        raise UserError(f"{source}:{line} {error.problem or error.context}") from error
    except RecursionError:
        raise UserError(f"{source}: not YAML: nested too deep") from None
    except (yaml.YAMLError, ValueError) as error:
        raise UserError(f"{source}: not YAML: {str(error).splitlines()[0]}") from error


@lru_cache(maxsize=8)
def _read(text: str, shipped: bool) -> Plain:
    """Return the value of a text; cached, as a report reads its run's configuration a dozen times."""
    return yaml.load(text, Loader=_QuickLoader if shipped else _Loader)


def _bounded(value: Plain, source: str) -> Plain:
    """Return the value. Raises UserError where aliases expand it beyond any reasonable size."""
    pending, count = [value], 0
    while pending:
        each = pending.pop()
        count += 1
        if count > MOST_VALUES:
            raise UserError(f"{source}: more than {MOST_VALUES:,} values, aliases counted each time")
        if isinstance(each, dict):
            pending.extend(each.values())
        elif isinstance(each, list):
            pending.extend(each)
    return value


def dump_yaml(mapping: Mapping[str, object]) -> str:
    """Return YAML of plain data, keys in their order, short lists on one line; equal data give equal text."""
    return yaml.dump(dict(mapping), Dumper=_Dumper, sort_keys=False, default_flow_style=False, width=110)
