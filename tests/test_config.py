"""Configurations: what is refused, what the one line says, and that YAML comes back as it went."""

import json
import re
from copy import deepcopy
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import Field, ValidationError, field_validator

from uavaccel.config import Config, apply_overrides, dump_yaml, load_yaml, parse_yaml, schema, to_yaml, validate
from uavaccel.errors import UserError
from uavaccel.suites.registry import merged

pytestmark = pytest.mark.usefixtures("whole_messages")


class Camera(Config):
    rate_hz: float = Field(30, gt=0)
    """Images a simulated second."""


class Flight(Config):
    suite: Literal["flight"] = "flight"
    clock_speeds: tuple[float, ...] = (1.0, 50.0)
    command: Literal["adsc", "tcsc"] = "tcsc"
    path: Literal["square"] | list[list[float]] = "square"
    camera: Camera = Camera()
    wind_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    games: int
    code: str = Field("a", pattern="^[a-c]+$")

    @field_validator("games")
    @classmethod
    def _even(cls, games: int) -> int:
        if games == 13:
            raise UserError("thirteen games bring bad luck")
        if games % 2:
            raise ValueError("should be even")
        return games


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)
NAN, INF = float("nan"), float("inf")
KEYS = st.text(alphabet="abcdefgh_", min_size=1, max_size=8)


def refusal(mapping: dict[str, Any]) -> str:
    with pytest.raises(UserError) as caught:
        validate(Flight, mapping, source="my.yaml")
    assert "\n" not in str(caught.value)
    return str(caught.value)


# --- validate -----------------------------------------------------------------------------------------------


def test_a_valid_mapping_becomes_a_frozen_configuration() -> None:
    flight = validate(Flight, {"games": 2, "clock_speeds": [10], "camera": {"rate_hz": 3}}, source="my.yaml")
    assert flight == Flight(games=2, clock_speeds=(10.0,), camera=Camera(rate_hz=3.0))
    with pytest.raises(ValidationError, match="frozen"):
        flight.games = 4  # type: ignore[misc]


@pytest.mark.parametrize(
    ("mapping", "line"),
    [
        ({}, "my.yaml: key 'games' is missing"),
        ({"game": 2}, "my.yaml: unknown key 'game'; did you mean 'games'?"),
        ({"games": 2, "camera": {"rate": 3}}, "my.yaml: unknown key 'camera.rate'; did you mean 'camera.rate_hz'?"),
        ({"games": 2, "camera": {"zoom": 3}}, "my.yaml: unknown key 'camera.zoom'; known: rate_hz"),
        ({"games": 2, "camera": {"rate_hz": -1}}, "my.yaml: camera.rate_hz = -1: should be greater than 0"),
        ({"games": 2, "camera": 3}, "my.yaml: camera = 3: should be a mapping"),
        ({"games": 2, "command": "tsc"}, "my.yaml: command = 'tsc': should be 'adsc' or 'tcsc'"),
        ({"games": 2, "clock_speeds": 5}, "my.yaml: clock_speeds = 5: should be a list"),
        ({"games": 2, "clock_speeds": [1, "x"]}, "my.yaml: clock_speeds.1 = 'x': should be a valid number"),
        ({"games": 2, "wind_m_s": 2}, "my.yaml: wind_m_s = 2: should be a list of 3"),
        ({"games": 2, "wind_m_s": [0, 2]}, "my.yaml: wind_m_s = [0, 2]: should be a list of 3"),
        ({"games": 2, "wind_m_s": [0, 2, 0, 0]}, "my.yaml: wind_m_s = [0, 2, 0, 0]: should be a list of 3"),
        ({"games": 2, "wind_m_s": [0, "x", 0]}, "my.yaml: wind_m_s.1 = 'x': should be a valid number"),
        ({"games": "2"}, "my.yaml: games = '2': should be a valid integer"),
        ({"games": True}, "my.yaml: games = True: should be a valid integer"),
        ({"games": 3}, "my.yaml: games = 3: should be even"),
        ({"games": 2, "code": "x"}, "my.yaml: code = 'x': should match pattern '^[a-c]+$'"),
        ({"games": 13}, "my.yaml: thirteen games bring bad luck"),
        ({"games": 2, "path": [[1, 0], [0, "n"]]}, "my.yaml: path.1.1 = 'n': should be a valid number"),
        ({"games": 2, "clock_speeds": [NAN]}, "my.yaml: clock_speeds.0 = nan: should be a finite number"),
        ({"games": 2, "clock_speeds": [-INF]}, "my.yaml: clock_speeds.0 = -inf: should be a finite number"),
    ],
)
def test_a_refusal_names_file_key_value_and_remedy(mapping: dict[str, Any], line: str) -> None:
    assert refusal(mapping) == line
    assert "not made of text, numbers, lists and mappings" in refusal({**mapping, "games": b"2"})


@pytest.mark.parametrize(("default", "line"), [
    (-1.0, "key = -1.0: should be greater than 0"), ([1, "x"], "key.1 = 'x': should be a valid integer"),
])  # fmt: skip
def test_a_default_that_does_not_fit_is_named(default: object, line: str) -> None:
    kind = list[int] if isinstance(default, list) else Annotated[float, Field(gt=0)]
    made: type[Config] = type("Made", (Config,), {"__annotations__": {"key": kind}, "key": default})
    with pytest.raises(UserError, match=f"^my.yaml: {re.escape(line)}$"):
        validate(made, {}, source="my.yaml")


@pytest.mark.parametrize(("key", "kind", "value", "wrong", "line"), [
    ("rate_hz", int, 5, -2, "should be greater than 0"),
    ("rate_hz", Annotated[float, Field(ge=-1)], 5, -2, "should be greater than or equal to -1"),
    ("command", str, "adsc", "tsc", "should be 'adsc' or 'tcsc'"),
    ("command", Literal["adsc"], "adsc", "tcsc", "should be 'adsc'"),
    ("games", float, 4, 2.5, "should be a valid integer"),
])  # fmt: skip
def test_a_key_that_is_named_again_by_a_bare_type_keeps_its_own(
    key: str, kind: object, value: object, wrong: object, line: str
) -> None:
    base = Camera if key in Camera.model_fields else Flight
    made: type[Config] = type("Again", (base,), {"__annotations__": {key: kind}, key: value})
    rest = {"games": 2} if key == "command" else {}
    assert getattr(validate(made, rest, "my.yaml"), key) == value
    with pytest.raises(UserError, match=f"^my.yaml: {key} = {wrong!r}: {line}$"):
        validate(made, {**rest, key: wrong}, "my.yaml")


# --- YAML ---------------------------------------------------------------------------------------------------


def test_load_yaml_reads_numbers_as_yaml_1_2_does(tmp_path: Path) -> None:
    file = tmp_path / "numbers.yaml"
    lines = "a: 1e-3\nb: 2E6\nc: 2026-11-21\nd: 1.5\ne: 10\nf: 010\ng: 1:30\nh: 0x1F\ni: 1_000\nj: -3\n"
    file.write_text(lines, encoding="utf-8")
    whole = {"e": 10, "f": 10, "g": "1:30", "h": 31, "i": 1000, "j": -3}
    assert load_yaml(file) == {"a": 0.001, "b": 2e6, "c": "2026-11-21", "d": 1.5, **whole}


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"a: 1\nb: [1, 2\n", r"line 3: expected ',' or '\]'"),
        (b"a: 1\n---\na: 2\n", "line 2: expected a single document in the stream, but found another document"),
        (b"a: 1\nb: 2\na: 3\n", "line 3: key 'a' stands twice in one mapping"),
        (b"a: {x: 1, x: 2}\n", "line 1: key 'x' stands twice in one mapping"),
        (b"? [1, 2]\n: 3\n", "line 1: a key is not text"),
        (b"a: !!python/object:os.system x\n", "line 1: could not determine a constructor"),
        (b"a: !!int x\n", "not YAML: invalid literal"),
        (b"- 1\n- 2\n", "must be a mapping, lines of 'key: value', but holds a list"),
        (b"", "must be a mapping, lines of 'key: value', but holds nothing"),
        (b"a: \xff\n", "not UTF-8 text"),
        (b"a: \x00\n", "not YAML"),
    ],
)
def test_a_file_that_is_no_mapping_is_refused_in_one_line(tmp_path: Path, content: bytes, line: str) -> None:
    file = tmp_path / "bad.yaml"
    file.write_bytes(content)
    for path, said in ((file, line), (tmp_path / "none.yaml", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(UserError, match=said) as caught:
            load_yaml(path)
        assert str(caught.value).startswith(f"{path}:")
        assert "\n" not in str(caught.value)


@pytest.mark.slow
@given(st.dictionaries(st.text(), PLAIN, max_size=4))
@example({text: text for text in ("1e3", "2026-11-21", "no", "1.0", "", "a: b")})  # which stay text
def test_plain_data_survives_yaml(mapping: dict[str, Any]) -> None:
    assert parse_yaml(dump_yaml(mapping), source="text") == mapping


def test_what_is_done_to_a_value_that_was_read_is_not_read_again() -> None:
    for _ in range(2):
        read = parse_yaml("a: {b: [1]}", "my.yaml")
        assert read == {"a": {"b": [1]}}
        read["a"]["b"].append(2)


def test_to_yaml_is_stable_readable_and_reads_back() -> None:
    flight = Flight(games=2, camera=Camera(rate_hz=1e-3))
    assert to_yaml(flight) == (
        "suite: flight\nclock_speeds: [1.0, 50.0]\ncommand: tcsc\npath: square\n"
        "camera:\n  rate_hz: 0.001\nwind_m_s: [0.0, 0.0, 0.0]\ngames: 2\ncode: a\n"
    )
    assert validate(Flight, parse_yaml(to_yaml(flight), source="text"), source="text") == flight


def test_the_schema_describes_the_fields() -> None:
    described = schema(Flight)
    json.dumps(described)
    assert described["additionalProperties"] is False
    assert described["$defs"]["Camera"]["properties"]["rate_hz"]["description"] == "Images a simulated second."


# --- overrides ----------------------------------------------------------------------------------------------


@given(st.lists(KEYS, min_size=1, max_size=3), PLAIN)
def test_an_override_sets_its_key(parts: list[str], value: Any) -> None:
    text = dump_yaml({"value": value}).removeprefix("value:")
    found: Any = apply_overrides({}, [f"{'.'.join(parts)}={text}"])
    for part in parts:
        found = found[part]
    assert found == value


def test_overrides_apply_in_turn_and_leave_the_original_alone() -> None:
    original = {"clock_speeds": [1, 5], "camera": {"rate_hz": 30}, "note": None}
    before = deepcopy(original)
    overrides = ["clock_speeds.1=50", "camera.rate_hz=3", "camera.rate_hz=4", "note.author=me", "empty="]
    assert apply_overrides(original, overrides) == {
        "clock_speeds": [1, 50],
        "camera": {"rate_hz": 4},
        "note": {"author": "me"},
        "empty": None,
    }
    keys = {"camera": {"rate_hz": 5}, "camera.rate_hz": 6}
    assert merged(original, keys, ["games=3"]) == {**before, "camera": {"rate_hz": 6}, "games": 3}
    assert (original, keys["camera"]) == (before, {"rate_hz": 5})
