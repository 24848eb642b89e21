"""cli.md says what the command line says."""

from pathlib import Path

from uavaccel.cli.docs import reference

PAGE = Path(__file__).parents[1] / "cli.md"


def test_reference_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == reference(), "python -m uavaccel.cli.docs > cli.md"
