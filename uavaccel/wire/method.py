"""An entry of the table of calls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Handler = Callable[..., Any]


class Method:
    """A call of the table: how many arguments it needs, and how many it takes at most."""

    def __init__(self, handler: Handler, required: int, optional: int = 0) -> None:
        self.handler = handler
        self.required = required
        self.most = required + optional
