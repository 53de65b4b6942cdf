"""Values of users on a broker that changes integers and lists: what is read is what was written."""

import copy
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.formats.free_values import AS_TEXT, FREE_VALUES, reduced, with_texts, without_texts

INTEGERS = st.one_of(
    st.integers(-(2**63), 2**63), st.sampled_from((2**31 - 1, 2**31, -(2**31), 1764408000000))
)
VALUES = st.recursive(
    st.one_of(
        st.none(), st.booleans(), INTEGERS, st.floats(allow_nan=False, allow_infinity=False), st.text()
    ),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=12,
)


def stored(entity: dict[str, Any]) -> dict[str, Any]:
    """Return what such a broker makes of an entity."""
    kept = copy.deepcopy(entity)
    for name in FREE_VALUES:
        if name in kept:
            kept[name]["value"] = reduced(kept[name]["value"])
    return kept


@given(st.sampled_from(FREE_VALUES), VALUES)
def test_what_is_read_is_what_was_written(name: str, value: Any) -> None:
    entity = {"id": "urn:x", name: {"type": "Property", "value": value, "unitCode": "MTR"}}
    for makes in (stored, copy.deepcopy):
        read = without_texts(makes(dict(with_texts(entity))))
        assert repr(read[name]["value"]) == repr(value) or read[name]["value"] == value
        assert read == entity, "nothing of the text is left"


@given(VALUES)
def test_what_such_a_broker_keeps_gets_no_text(value: Any) -> None:
    kept = {"workParameters": {"type": "Property", "value": reduced(value)}}
    assert with_texts(kept) is kept


@given(VALUES, VALUES)
def test_what_somebody_else_writes_counts(value: Any, other: Any) -> None:
    read = stored(dict(with_texts({"workParameters": {"type": "Property", "value": value}})))
    read["workParameters"]["value"] = changed = {"other": other}
    if reduced(value) != reduced(changed):
        assert without_texts(read)["workParameters"] == {"type": "Property", "value": changed}


def test_integers_become_what_was_observed() -> None:
    assert reduced(2147483648) == -2147483648
    assert reduced(1764408000000) == -823558656
    assert reduced({"a": [[7]], "b": [1, 2], "c": []}) == {"a": 7, "b": [1, 2], "c": []}


@pytest.mark.parametrize("text", [{"value": "{"}, {"value": 1}, {}, "x", None])
def test_a_text_that_is_none_does_not_count(text: Any) -> None:
    read = {"outputParameters": {"type": "Property", "value": 1, AS_TEXT: text}}
    assert without_texts(read) == {"outputParameters": {"type": "Property", "value": 1}}
