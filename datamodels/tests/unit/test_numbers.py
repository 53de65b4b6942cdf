"""Numbers that a broker with integers of 32 bits keeps as they are."""

from collections.abc import Iterator
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from handover_datamodels.numbers import MAX_INTEGER, MIN_INTEGER, portable

integers = st.integers(-(2**70), 2**70) | st.integers(MIN_INTEGER - 2, MIN_INTEGER + 2)
integers |= st.integers(MAX_INTEGER - 2, MAX_INTEGER + 2) | st.just(10**400)
values = st.recursive(
    integers | st.booleans() | st.none() | st.text(max_size=3) | st.floats(allow_nan=False),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
)


def integers_in(value: Any) -> Iterator[int]:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        for inner in value:
            yield from integers_in(inner)
    elif isinstance(value, int) and not isinstance(value, bool):
        yield value


@given(values)
def test_no_number_changes_and_no_large_integer_is_left_that_a_float_can_hold(value: Any) -> None:
    written = portable(value)
    assert written == value
    for number in integers_in(written):
        assert MIN_INTEGER <= number <= MAX_INTEGER or abs(number) > 2**53


def test_times_in_ms_and_counters_become_floats() -> None:
    written = portable({"ms": 1_764_408_000_000, "small": MAX_INTEGER, "on": True, "list": [2**31]})
    assert written == {"ms": 1_764_408_000_000, "small": MAX_INTEGER, "on": True, "list": [2**31]}
    assert isinstance(written["ms"], float)
    assert isinstance(written["list"][0], float)
    assert isinstance(written["small"], int)
    assert written["on"] is True
