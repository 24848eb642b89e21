"""Regular expressions of clients: what std::regex_match with icase finds, and never for long."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.airsim_wire import AirSimWire
from uavaccel.sim.scene.objects import matching
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
def test_it_finds_what_pythons_own_matcher_finds(expression: str, names: list[str]) -> None:
    every, other = [*NAMES[:6], *names], re.compile(expression, re.IGNORECASE)
    assert matching(expression, every) == [name for name in every if other.fullmatch(name)]


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
    (r"r.\w+", []),  # as in the C locale, ASCII's letters alone
    ("[[:upper:]]+", ["a", "ab", "aab", "B", "Ground"]),
    (r"(.)\1.*", ["aab"]),
    ("[^]{1}|[]", ["a", "B"]),
    (r"\A{1}|a\{,2}|a{2\}", ["a", "a{2}"]),
])  # fmt: skip
def test_whole_names_whatever_their_case(expression: str, found: list[str]) -> None:
    assert matching(expression, NAMES) == found


def test_the_end_is_not_before_a_last_line_break_nor_a_dot_one() -> None:
    assert matching("a$", ["a", "a\n"]) == ["a"]
    assert matching("a$.*|a.", ["a", "a\n", "a\u2028"]) == ["a"]


@pytest.mark.parametrize(("expression", "reason"), [
    ("(", r"missing \)"),
    ("a)", "unbalanced"),
    ("*", "nothing to repeat"),
    ("a{3,2}", "greater than max"),
    ("[", "unterminated"),
    ("[b-a]", "bad character range"),
    ("[[:vowel:]]", "unknown property"),
    ("(?<=a)b", r"\(\?< is not known"),
    ("(?i)a", r"\(\?i is not known"),
    ("(*FAIL)", r"\(\* is not known"),
    ("a++", r"\+\+ is not known"),
    (r"(a)\2", "group"),
    ("\\", "end of pattern"),
    ("(" * 5000 + ")" * 5000, "nested too deeply"),
    ("((a{1000}){1000}){1000}", "repetitions written out"),
    ("(" * 80 + "a" + "+)" * 80 + "+", "repetitions written out"),
])  # fmt: skip
def test_what_is_none_is_refused_in_words(expression: str, reason: str) -> None:
    with pytest.raises(ValueError, match=f"is no regular expression: .*{reason}"):
        matching(expression, NAMES)


@pytest.mark.parametrize("expression", ["(a+)+$", "(a|a)*b", "((a*)*)*b", "(x+x+)+y", "(.*.*.*)*!", "(?:(?:a+)+)+!"])
def test_what_naive_backtracking_never_ends_is_answered(expression: str) -> None:
    assert matching(expression, ["a" * 200, "x" * 200]) == ["a" * 200] * (expression == "(a+)+$")


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
