"""Patterns: those that could keep the broker busy for years are refused, and the rest is quick."""

import pytest

from handover.errors import Problem
from services.context_broker.patterns import fits, pattern


@pytest.mark.parametrize("text", ["^urn:.*:demo:[0-9]{1,4}$", "a|b", "(ab){2,3}", r"\d+-\d+", "(a|b)?c*", ""])
def test_plain_patterns_are_taken(text: str) -> None:
    assert pattern(text).pattern == text


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("(", "cannot be used"),
        ("a{9999999999999}", "cannot be used"),
        ("(a+)+$", "another repetition"),
        ("(a*b*)*", "another repetition"),
        ("(a|a)*", "alternatives"),
        ("(?:(?:a?)+)+", "another repetition"),
        ("((a{1,100}){1,100})", "another repetition"),
        (r"(a)\1", "looks back"),
        ("(?=a+)b", "looks back or ahead"),
        (".*.*.*.*=", "side by side"),
        ("x" * 600, "512"),
    ],
)
def test_dangerous_and_broken_patterns_are_refused(text: str, reason: str) -> None:
    with pytest.raises(Problem, match=reason):
        pattern(text)


def test_a_pattern_is_found_anywhere_in_a_text() -> None:
    assert fits(pattern("demo"), "urn:ngsi-ld:Task:demo:1")
    assert not fits(pattern("^demo"), "urn:ngsi-ld:Task:demo:1")
