"""The base of AirSim's types: a map of fields on the wire, an object for scripts."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pprint import pformat
from typing import Self

from uavaccel.wire.rpc import Received


class MsgpackMixin:
    """An object whose attributes are the fields of a map on the wire."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__}> " + pformat(vars(self), indent=4, width=1)

    def to_msgpack(self, *args: object, **options: object) -> dict[str, object]:
        """The fields, nested objects as objects."""
        return self.__dict__

    @classmethod
    def from_msgpack(cls, encoded: Mapping[str, Received]) -> Self:
        """The object of a map; fields that the type does not have are kept, missing ones have their defaults."""
        self = cls.__new__(cls)
        fields = vars(self)
        nested: dict[str, type[MsgpackMixin] | None] = _fields(cls)  # type: ignore[arg-type]
        for key, value in encoded.items():
            inner = nested.get(key) if type(value) is dict else None
            fields[key] = inner.from_msgpack(value) if inner else value
        if not nested.keys() <= fields.keys():
            self.__dict__ = vars(cls()) | fields
        return self


@cache
def _fields(cls: type[MsgpackMixin]) -> dict[str, type[MsgpackMixin] | None]:
    """The fields of a type, and the types of those that are objects of AirSim's types themselves."""
    return {
        key: type(value) if isinstance(value, MsgpackMixin) else None for key, value in vars(cls()).items()
    }
