"""Patterns: matching takes time linear in the text; what needs backtracking is refused with the reason."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.query.patterns import fits, pattern


@pytest.mark.parametrize("text", ["^urn:.*:demo:[0-9]{1,4}$", "a|b", "(ab){2,3}", r"\d+-\d+", "(a|b)?c*", ""])
def test_a_pattern_keeps_its_text(text: str) -> None:
    assert pattern(text).text == text


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("(", "missing \\)"),
        ("a{1001}", "repetition size"),
        (r"(a)\1", "invalid escape sequence"),
        ("(?=a+)b", "invalid perl operator"),
        ("(((a{1,100}){1,100}){1,100})", "repetition size"),
        ("(.{100}){9}" * 40, "written out|too large|repetition size"),
        ("x" * 600, "512"),
        ("\ud800", "surrogates not allowed"),
    ],
)
def test_a_pattern_that_cannot_be_used_is_refused_with_the_reason(text: str, reason: str) -> None:
    with pytest.raises(Problem, match=reason):
        pattern(text)


@pytest.mark.parametrize(
    "text",
    ["(a+)+$", "(a*b*)*c", "(a|a)*b", "(?:(?:a?)+)+b", ".*.*.*.*=", "(a{0,8}){8}b", "((a?){8}){8}b",
     "a?" * 30 + "b", "((a{1,30}){1,30})b", "(a|a){8}(a|a){8}b", "(.*)(.*)(.*)(.*)(.*)[^a]", "a.{500}b"],
)  # fmt: skip
def test_a_pattern_that_would_backtrack_for_days_is_answered(text: str) -> None:
    assert fits(pattern(text), "a" * 100_000) is (text == "(a+)+$")
    assert fits(pattern(text), "a" * 5 + "!") is text.endswith("[^a]")


def test_a_pattern_that_needs_many_states_is_answered_correctly() -> None:
    machine = pattern("a[ab]{12}c")
    texts = [f"{number:014b}".replace("0", "a").replace("1", "b") for number in range(1 << 14)]
    assert not any(fits(machine, text) for text in texts)
    assert not fits(machine, "".join(texts))
    assert fits(machine, "".join(texts) + "b" + "a" * 13 + "c")


PIECES = st.recursive(
    st.sampled_from(
        ["a", "b", ".", "[ab]", "[^a]", r"\d", r"\w", r"\S", "^", "$", "é", "[0-9b-c]", r"\.", ""]
    ),
    lambda inner: st.one_of(
        st.tuples(inner, inner).map("".join),
        st.tuples(inner, inner).map(lambda two: f"(?:{two[0]}|{two[1]})"),
        st.tuples(inner, st.sampled_from(["*", "+", "?", "{2}", "{0,2}", "{1,}", "*?"])).map(
            lambda two: f"({two[0]}){two[1]}"
        ),
    ),
    max_leaves=5,
)


@given(PIECES, st.text(alphabet="ab1.é_", max_size=6))
def test_a_pattern_matches_what_the_standard_library_matches(text: str, read: str) -> None:
    """\\w and \\S are those of ASCII in RE2, so the library is asked for the same."""
    assert fits(pattern(text), read) is (re.search(text, read, re.ASCII) is not None)


def test_a_pattern_is_found_anywhere_in_a_text() -> None:
    assert fits(pattern("demo"), "urn:ngsi-ld:Task:demo:1")
    assert not fits(pattern("^demo"), "urn:ngsi-ld:Task:demo:1")
