"""The console on which all commands print: plain text, as it is, on lines that are not wrapped."""

from __future__ import annotations

from rich.console import Console

console = Console(highlight=False, markup=False, soft_wrap=True)
