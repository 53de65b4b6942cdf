"""The change tracker: state counts, not the number or order of notifications; echoes are suppressed."""

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from handover_ros.rules import origin
from handover_ros.rules.change_tracker import MISSED_AFTER_S, ChangeTracker


def entity(value: Any, at: str | None = None, **more: Any) -> dict[str, Any]:
    written = {"type": "Property", "value": value, **more}
    return {"id": "e", "type": "Device", "speed": {**written, "observedAt": at} if at else written}


def test_the_same_state_is_a_change_once() -> None:
    tracker = ChangeTracker(["speed"])
    assert [tracker.take(entity(value), 0.0) for value in (1, 1, 2)] == [True, False, True]


def test_a_later_observation_is_a_change_and_an_earlier_one_is_not() -> None:
    tracker = ChangeTracker(["speed"])
    changed = [tracker.take(entity(3, f"2026-01-01T00:00:0{second}Z"), 0.0) for second in (2, 3, 1, 3)]
    assert changed == [True, True, False, False]


def test_a_polled_state_is_missed_only_without_notifications_for_a_while() -> None:
    tracker = ChangeTracker(["speed"])
    tracker.take(entity(1), 0.0)
    assert not tracker.is_missed(entity(4), 1.0), "the notifications of 2, 3 and 4 may be on their way"
    tracker.take(entity(2), 2.0)
    assert not tracker.is_missed(entity(4), 3.0)
    assert not tracker.is_missed(entity(4), 3.0 + MISSED_AFTER_S - 0.1)
    assert not tracker.is_missed(entity(5), 3.0 + MISSED_AFTER_S), "the value still changes"
    assert tracker.is_missed(entity(5), 3.0 + 2 * MISSED_AFTER_S)
    assert tracker.take(entity(5), 3.0 + 2 * MISSED_AFTER_S)
    assert not tracker.is_missed(entity(5), 100.0), "the known state is not missed"


def test_a_state_of_an_entity_that_was_never_notified_is_missed_after_a_while() -> None:
    tracker = ChangeTracker(["speed"])
    assert not tracker.is_missed(entity(1), 0.0)
    assert tracker.is_missed(entity(1), MISSED_AFTER_S)


def test_a_read_that_began_before_the_last_state_was_taken_is_recognized() -> None:
    tracker = ChangeTracker(["speed"])
    assert not tracker.was_taken_since("e", 0.0)
    tracker.take(entity(1), 5.0)
    assert tracker.was_taken_since("e", 4.0)
    assert not tracker.was_taken_since("e", 6.0)


def test_a_change_of_another_attribute_is_ignored() -> None:
    tracker = ChangeTracker(["speed"])
    assert not tracker.take({"id": "e", "type": "Device", "mode": {"type": "Property", "value": 1}}, 0.0)


def test_a_value_of_the_graph_is_not_sent_back_until_another_client_changes_it() -> None:
    ours = origin.marked({"type": "Property", "value": 1.0}, "/bridge")
    tracker = ChangeTracker(["speed"])
    assert not tracker.take({"id": "e", "speed": ours}, 0.0)
    assert not ChangeTracker(["speed"]).take({"id": "e", "speed": ours}, 0.0), "also after a restart"
    assert tracker.take({"id": "e", "speed": {**ours, "value": 2}}, 0.0), "changed without removing the mark"
    assert tracker.take({"id": "e", "speed": {"type": "Property", "value": 3}}, 0.0)


def test_a_value_that_another_client_wrote_is_an_echo_for_a_while() -> None:
    tracker = ChangeTracker(["speed"])
    tracker.take(entity(0.1), 0.0)
    assert tracker.is_echo("e", "speed", 0.1, 1.0)
    assert tracker.is_echo("e", "speed", 0.10000000149011612, 1.0), "the same number as float32"
    assert not tracker.is_echo("e", "speed", 2, 1.0)
    assert not tracker.is_echo("f", "speed", 1, 1.0)
    assert not tracker.is_echo("e", "speed", 0.1, 6.0), "an echo has a time limit"


def test_a_value_of_the_graph_ends_the_echo() -> None:
    tracker = ChangeTracker(["speed"])
    tracker.take(entity(1.0), 0.0)
    tracker.wrote("e", "speed")
    assert not tracker.is_echo("e", "speed", 1, 1.0)
    tracker.take({"id": "e", "speed": origin.marked({"type": "Property", "value": 2}, "/bridge")}, 0.0)
    assert not tracker.is_echo("e", "speed", 2, 1.0)


values = st.recursive(
    st.booleans()
    | st.integers(-(2**53), 2**53)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)


@given(values)
def test_a_mark_matches_its_value_in_any_number_format(value: Any) -> None:
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
