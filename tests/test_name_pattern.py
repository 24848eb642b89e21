"""Regular expressions of clients: what std::regex_match with icase finds, and never for long."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.airsim_wire import AirSimWire
from uavaccel.sim.scene.name_pattern import NamePattern
from uavaccel.wire import rpc

NAMES = ["", "a", "ab", "aab", "B", "TemplateCube_Rounded_45", "Ground", "x.y-z", "a{2}", "1 b", "Rück_ß"]

letters = st.sampled_from([*"ab1_-.", r"\.", r"\d", r"\W", "[a-c]", "[^b_]", "[.-]", r"[\d-]"])
expressions = st.recursive(
    letters,
    lambda inner: (
        st.tuples(inner, st.sampled_from(["*", "+", "?", "{2}", "{0,1}", "{1,}", "*?", "+?"])).map(
            lambda part: f"(?:{part[0]}){part[1]}"
        )
        | st.lists(inner, min_size=1, max_size=3).map("".join)
        | st.lists(inner, min_size=2, max_size=3).map(lambda parts: f"({'|'.join(parts)})")
        | inner.map(lambda part: f"(?={part})")
        | inner.map(lambda part: f"(?!{part})")
        | inner.map(lambda part: rf"\b{part}")
    ),
    max_leaves=6,
)


@given(expressions, st.lists(st.text("aAbB1_-. ", max_size=8), max_size=8))
def test_it_finds_what_a_matcher_that_backtracks_finds(expression: str, names: list[str]) -> None:
    pattern, other = NamePattern(expression), re.compile(expression, re.IGNORECASE)
    for name in [*NAMES[:6], *names]:
        assert pattern.matches(name) == bool(other.fullmatch(name)), name


@pytest.mark.parametrize(("expression", "found"), [
    (".*", NAMES),
    ("", [""]),
    ("templatecube.*", ["TemplateCube_Rounded_45"]),
    (r"^(?!.*ground|.*cube).{2,4}$", ["ab", "aab", "a{2}", "1 b"]),
    (r"a\{2}", ["a{2}"]),
    ("a{2}", []),
    ("[[:alpha:]]{3}", ["aab"]),
    (r"\x42|\u0061", ["a", "B"]),
    (r".*\d\d", ["TemplateCube_Rounded_45"]),
    ("RÜCK.*", ["Rück_ß"]),
])  # fmt: skip
def test_whole_names_whatever_their_case(expression: str, found: list[str]) -> None:
    pattern = NamePattern(expression)
    assert [name for name in NAMES if pattern.matches(name)] == found


@pytest.mark.parametrize(("expression", "reason"), [
    ("(", "not closed"),
    ("a)", "unbalanced"),
    ("*", "nothing to repeat"),
    ("a{3,2}", "fewer"),
    ("[", "ends too soon"),
    ("[b-a]", "backwards"),
    ("[[:vowel:]]", "vowel"),
    ("(?<=a)b", "not known"),
    (r"(a)\1", "back reference"),
    ("\\", "ends too soon"),
    ("(" * 5000 + ")" * 5000, "nested too deeply"),
    ("((a{1000}){1000}){1000}", "repetitions written out"),
])  # fmt: skip
def test_what_is_none_is_refused_in_words(expression: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        NamePattern(expression)


@pytest.mark.parametrize(
    "expression", ["(a+)+$", "(a|a)*b", "((a*)*)*b", "(x+x+)+y", "(.*.*.*)*!", "(a?){60}a{60}", "(?:(?:a+)+)+!"]
)
def test_expressions_for_which_backtracking_takes_for_ever_do_not(expression: str) -> None:
    """Each would take 2^200 steps: that the test ends is what it shows."""
    assert NamePattern(expression).matches("a" * 200) == (expression == "(a+)+$")
    assert not NamePattern(expression).matches("x" * 200)


@pytest.mark.parametrize("expression", [".*" * 120, "(?!.*(?!.*(?!.*q)))*" * 12])
def test_what_takes_long_all_the_same_is_given_up(expression: str) -> None:
    pattern = NamePattern(expression)
    with pytest.raises(ValueError, match="takes too long"):
        any(pattern.matches("a" * 255 + str(number)) is None for number in range(64))


@pytest.mark.parametrize("call", [
    ("simListSceneObjects",),
    ("simSetSegmentationObjectID", 7, True),
])  # fmt: skip
def test_both_calls_match_in_bounded_time(call: tuple[object, ...]) -> None:
    wire, (method, *rest) = AirSimWire(), call
    name = wire.call("simSpawnObject", "x" * 200, "Cube", POSE, {"x_val": 1.0, "y_val": 1.0, "z_val": 1.0})
    try:
        assert not wire.call(str(method), "(x+x+)+y", *rest)
        assert wire.call(str(method), "(x+x+)+", *rest) in ([name], True)
        with pytest.raises(rpc.RpcError, match="no regular expression"):
            wire.call(str(method), "(", *rest)
    finally:
        wire.call("simDestroyObject", name)


POSE = {
    "position": {"x_val": 3000.0, "y_val": 0.0, "z_val": -50.0},
    "orientation": {"w_val": 1.0, "x_val": 0.0, "y_val": 0.0, "z_val": 0.0},
}
