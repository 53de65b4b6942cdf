"""Patterns: any that can be asked for is answered in a blink, and the rest is refused with the reason."""

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover.errors import Problem
from services.context_broker.query.automaton import MOST_STATES, Automaton, Unsupported
from services.context_broker.query.patterns import LONGEST_TEXT, fits, pattern


@pytest.mark.parametrize("text", ["^urn:.*:demo:[0-9]{1,4}$", "a|b", "(ab){2,3}", r"\d+-\d+", "(a|b)?c*", ""])
def test_plain_patterns_are_taken(text: str) -> None:
    assert pattern(text).pattern == text


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("(", "cannot be used"),
        ("a{9999999999999}", "cannot be used"),
        (r"(a)\1", "looks back"),
        ("(?=a+)b", "looks back or ahead"),
        (r"a*\bb*c*", "borders of words"),
        ("(?i)a*b*c*", "IGNORECASE"),
        ("(((a{1,100}){1,100}){1,100})", "written out"),
        ("x" * 600, "512"),
    ],
)
def test_broken_patterns_and_those_that_look_back_are_refused(text: str, reason: str) -> None:
    with pytest.raises(Problem, match=reason):
        pattern(text)


@pytest.mark.parametrize(
    "text",
    ["(a+)+$", "(a*b*)*c", "(a|a)*b", "(?:(?:a?)+)+b", ".*.*.*.*=", "(a{0,8}){8}b", "((a?){8}){8}b",
     "a?" * 30 + "b", "((a{1,30}){1,30})b", "(a|a){8}(a|a){8}b", "(.*)(.*)(.*)(.*)(.*)[^a]"],
)  # fmt: skip
def test_patterns_with_very_many_ways_are_answered_in_a_blink(text: str) -> None:
    # Tried one after the other, the ways through any of these would take days.
    assert fits(pattern(text), "a" * LONGEST_TEXT) is (text == "(a+)+$")
    assert fits(pattern(text), "a" * 5 + "!") is text.endswith("[^a]")


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


@settings(deadline=None)
@given(PIECES, st.text(alphabet="ab1.é\n_", max_size=6))
def test_the_machine_finds_what_the_library_finds(text: str, read: str) -> None:
    found = re.search(text, read) is not None
    assert Automaton(text).found_in(read) is found
    assert fits(pattern(text), read) is found


def test_a_machine_forgets_before_it_grows_without_end() -> None:
    machine = Automaton("a[ab]{12}c")
    texts = [f"{number:014b}".replace("0", "a").replace("1", "b") for number in range(3 * MOST_STATES)]
    assert not any(machine.found_in(text) for text in texts)
    assert machine.found_in("b" + "a" * 13 + "c")
    assert len(machine._states) <= MOST_STATES
    with pytest.raises(Unsupported):
        Automaton(r"\bx")


def test_a_pattern_is_found_anywhere_in_a_text() -> None:
    assert fits(pattern("demo"), "urn:ngsi-ld:Task:demo:1")
    assert not fits(pattern("^demo"), "urn:ngsi-ld:Task:demo:1")
