"""What comes from the broker: state counts, not how often or in which order; and nothing goes round."""

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from ros_fiware_bridge.rules import origin
from ros_fiware_bridge.rules.latest import Latest


def entity(value: Any, at: str | None = None, **more: Any) -> dict[str, Any]:
    written = {"type": "Property", "value": value, **more}
    return {"id": "e", "type": "Device", "speed": {**written, "observedAt": at} if at else written}


def test_the_same_state_is_news_once() -> None:
    latest = Latest(["speed"])
    assert [latest.take(entity(value), 0.0) for value in (1, 1, 2)] == [True, False, True]


def test_the_same_value_observed_later_is_news_and_earlier_is_not() -> None:
    latest = Latest(["speed"])
    told = [latest.take(entity(3, f"2026-01-01T00:00:0{second}Z"), 0.0) for second in (2, 3, 1, 3)]
    assert told == [True, True, False, False]


def test_attributes_that_nobody_listens_to_are_no_news() -> None:
    latest = Latest(["speed"])
    assert not latest.take({"id": "e", "type": "Device", "mode": {"type": "Property", "value": 1}}, 0.0)


def test_what_came_from_the_graph_is_not_sent_back_until_somebody_changes_it() -> None:
    ours = origin.marked({"type": "Property", "value": 1.0}, "/bridge")
    latest = Latest(["speed"])
    assert not latest.take({"id": "e", "speed": ours}, 0.0)
    assert not Latest(["speed"]).take({"id": "e", "speed": ours}, 0.0), "not even after a restart"
    assert latest.take({"id": "e", "speed": {**ours, "value": 2}}, 0.0), "changed, the mark left in place"
    assert latest.take({"id": "e", "speed": {"type": "Property", "value": 3}}, 0.0)


def test_what_others_wrote_need_not_be_written_again() -> None:
    latest = Latest(["speed"])
    latest.take(entity(0.1), 0.0)
    assert latest.is_echo("e", "speed", 0.1, 1.0)
    assert latest.is_echo("e", "speed", 0.10000000149011612, 1.0), "as a float32 it comes back like this"
    assert not latest.is_echo("e", "speed", 2, 1.0)
    assert not latest.is_echo("f", "speed", 1, 1.0)
    assert not latest.is_echo("e", "speed", 0.1, 6.0), "after a while somebody says it"


def test_what_the_graph_says_after_something_else_is_no_echo() -> None:
    latest = Latest(["speed"])
    latest.take(entity(1.0), 0.0)
    latest.wrote("e", "speed")
    assert not latest.is_echo("e", "speed", 1, 1.0)
    latest.take({"id": "e", "speed": origin.marked({"type": "Property", "value": 2}, "/bridge")}, 0.0)
    assert not latest.is_echo("e", "speed", 2, 1.0)


values = st.recursive(
    st.booleans()
    | st.integers(-(2**53), 2**53)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)


@given(values)
def test_a_mark_fits_what_it_was_made_of_however_a_broker_writes_numbers(value: Any) -> None:
    marked = origin.marked({"type": "Property", "value": value}, "/bridge")
    assert origin.is_ours(marked)
    assert origin.is_ours({**marked, "value": _with_whole_floats_as_integers(value)})
    assert not origin.is_ours({**marked, "value": [value, "changed"]})


def _with_whole_floats_as_integers(value: Any) -> Any:
    if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
        return int(value)
    if isinstance(value, list):
        return [_with_whole_floats_as_integers(one) for one in value]
    if isinstance(value, dict):
        return {key: _with_whole_floats_as_integers(one) for key, one in value.items()}
    return value
