"""The keys of every suite's YAML files as a page, from the schemas that `uavaccel schema` prints."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from uavaccel.config import schema
from uavaccel.suites.registry import SUITES, find_suite

Schema = Mapping[str, Any]

HEAD = """# Keys of the YAML files

A YAML file says which suite it is for by its key `suite`; these are the others. A key left out takes its default, a dotted key
is one of an inner mapping, and `--set dotted.key=value` sets any of them for a single run. `uavaccel schema SUITE` prints the
same as a JSON schema, which lets editors complete and check a file.
"""
TABLE = "| key | value | default | meaning |\n|---|---|---|---|\n"
BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


def page() -> str:
    """Markdown with a table per suite."""
    return HEAD + "".join(_suite(name) for name in SUITES)


def _suite(name: str) -> str:
    config = find_suite(name, "keys").config
    whole = schema(config)
    about = " ".join((config.__doc__ or "").split())
    rows = "".join(f"| {' | '.join(map(_cell, row))} |\n" for row in _rows(whole, whole, ""))
    return f"\n## {name}\n\n{about}\n\n{TABLE}{rows}"


def _rows(part: Schema, whole: Schema, prefix: str) -> Iterator[tuple[str, str, str, str]]:
    """Key, values, default and meaning of each property, those of inner mappings below it."""
    for key, value in part["properties"].items():
        name = f"{prefix}{key}"
        if name == "suite":
            continue
        about = " ".join(value.get("description", "").split())
        inner = _mapping(value, whole)
        if inner is None:
            yield f"`{name}`", _values(value, whole), _default(value), about
        else:
            yield f"`{name}`", "mapping", "", about
            yield from _rows(inner, whole, f"{name}.")


def _mapping(value: Schema, whole: Schema) -> Schema | None:
    """The schema of a mapping with keys of its own, where a value is one."""
    found = [each for each in map(lambda each: _resolved(each, whole), _choices(value)) if "properties" in each]
    return found[0] if found else None


def _resolved(value: Schema, whole: Schema) -> Schema:
    return whole["$defs"][value["$ref"].rpartition("/")[2]] if "$ref" in value else value


def _choices(value: Schema) -> list[Schema]:
    return list(value.get("anyOf", [value]))


def _values(value: Schema, whole: Schema) -> str:
    return " or ".join(dict.fromkeys(_one(_resolved(each, whole), whole) for each in _choices(value)))


def _one(value: Schema, whole: Schema) -> str:
    if "enum" in value or "const" in value:
        return ", ".join(f"`{each}`" for each in value.get("enum", [value.get("const")]))
    if value.get("type") == "array" and "items" in value:
        return f"list of {_values(value['items'], whole)}"
    if value.get("type") == "array":
        return "list of " + ", ".join(_values(each, whole) for each in value.get("prefixItems", ()))
    bounds = [f"{sign} {value[name]:g}" for name, sign in BOUNDS.items() if name in value]
    return " ".join([str(value.get("type", "any")), ", ".join(bounds)]).strip()


def _default(value: Schema) -> str:
    return f"`{json.dumps(value['default'])}`" if "default" in value else ""


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
