"""The keys of every suite's YAML files as a page, from the schemas that `uavaccel init --schema` prints."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from uavaccel.config import schema
from uavaccel.suites.registry import SUITES, find_suite

Schema = Mapping[str, Any]

HEAD = """# Keys of the YAML files

A YAML file says which suite it is for by its key `suite`; these are the others. A key left out takes its default, a
dotted key is one of an inner mapping, and `--set dotted.key=value` sets any of them for a single run. `uavaccel init
--schema SUITE` prints the same as a JSON schema, which lets editors complete and check a file.
"""
TABLE = "| key | value | default | meaning |\n|---|---|---|---|\n"
BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
LONGEST_DEFAULT = 60  # characters; the schema has longer ones


def page() -> str:
    """Markdown with a table per suite; an inner mapping is laid out where it comes first."""
    shown: dict[str, str] = {}
    return HEAD + "".join(_suite(name, shown) for name in SUITES)


def _suite(name: str, shown: dict[str, str]) -> str:
    config = find_suite(name, "keys").config
    whole = schema(config)
    about = " ".join((config.__doc__ or "").split())
    rows = "".join(f"| {' | '.join(map(_cell, row))} |\n" for row in Rows(name, whole, shown).of(whole, ""))
    return f"\n## {name}\n\n{about}\n\n{TABLE}{rows}"


class Rows:
    """The rows of one suite's table; `shown` has the mappings laid out so far, and where."""

    def __init__(self, suite: str, whole: Schema, shown: dict[str, str]) -> None:
        self._suite, self._whole, self._shown = suite, whole, shown

    def of(self, part: Schema, prefix: str) -> Iterator[tuple[str, str, str, str]]:
        """Key, values, default and meaning of each property, those of inner mappings below it."""
        for key, value in part["properties"].items():
            name = f"{prefix}{key}"
            if key == "suite":
                continue
            about = " ".join(value.get("description", "").split())
            inner = self._mapping(value)
            if inner is None:
                yield f"`{name}`", self._values(value), _default(value), about
                continue
            seen = self._shown.setdefault(json.dumps(inner, sort_keys=True), f"{self._suite}: {name}")
            here = seen == f"{self._suite}: {name}"
            yield f"`{name}`", "mapping" if here else f"mapping, as `{seen}` above", "", about
            if here:
                yield from self.of(inner, f"{name}.")

    def _mapping(self, value: Schema) -> Schema | None:
        """The schema of a mapping with keys of its own, where a value is one."""
        return next((each for each in self._choices(value) if "properties" in each), None)

    def _choices(self, value: Schema) -> list[Schema]:
        return [self._resolved(each) for each in value.get("anyOf", [value])]

    def _resolved(self, value: Schema) -> Schema:
        definition: Schema = self._whole["$defs"][value["$ref"].rpartition("/")[2]] if "$ref" in value else value
        return definition

    def _values(self, value: Schema) -> str:
        return " or ".join(dict.fromkeys(map(self._one, self._choices(value))))

    def _one(self, value: Schema) -> str:
        if "enum" in value or "const" in value:
            return ", ".join(f"`{each}`" for each in value.get("enum", [value.get("const")]))
        kind = {"object": "mapping"}.get(value.get("type", "any"), value.get("type", "any"))
        if kind == "array":
            inner = [value["items"]] if "items" in value else value.get("prefixItems", ())
            return f"list of {', '.join(map(self._values, inner))}"
        bounds = [f"{sign} {value[name]:,}" for name, sign in BOUNDS.items() if name in value]
        return " ".join([kind, ", ".join(bounds)]).strip()


def _default(value: Schema) -> str:
    text = json.dumps(value["default"]) if "default" in value else ""
    return f"`{text}`" if 0 < len(text) <= LONGEST_DEFAULT else "…" if text else ""


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
