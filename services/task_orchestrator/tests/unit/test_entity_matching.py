"""Which entities are news: each state of an entity once, whatever fails in between."""

from hypothesis import given
from hypothesis import strategies as st

from handover_processes.events.entity_matching import BASELINE, SeenEntities, digest_of, replay

STATES = st.dictionaries(st.sampled_from("abcd"), st.sampled_from("123"))
"""What a filter selects at a moment: entity to digest."""


def reconcile(seen: SeenEntities, stored: dict[tuple[str, str], str], present: dict[str, str]) -> set[str]:
    """Apply what a query has found, as the orchestrator does, and return the events."""
    changes: dict[tuple[str, str], str | None] = {}
    events: set[str] = set()
    if seen.has_baseline("f"):
        events = set(seen.news("f", present))
    changes |= {("f", entity): digest for entity, digest in present.items()}
    changes |= {("f", entity): None for entity in seen.gone("f", present)}
    changes["f", BASELINE] = BASELINE
    seen.apply(changes)
    for (key, entity), digest in changes.items():
        if digest is None:
            stored.pop((key, entity), None)
        else:
            stored[key, entity] = digest
    return events


@given(st.lists(st.tuples(STATES, st.booleans()), min_size=1))
def test_an_entity_is_an_event_when_its_state_differs_from_the_last_one_that_was_seen(
    history: list[tuple[dict[str, str], bool]],
) -> None:
    stored: dict[tuple[str, str], str] = {}
    seen = SeenEntities()
    before: dict[str, str] | None = None
    for present, is_restarted in history:
        events = reconcile(seen, stored, present)
        if before is None:
            assert not events
        else:
            assert events == {name for name in present if before.get(name) != present[name]}
        if is_restarted:
            seen = SeenEntities((key, entity, digest) for (key, entity), digest in stored.items())
        assert reconcile(seen, stored, present) == set()
        assert seen.entities("f") == {BASELINE, *present}
        before = present


def test_changes_of_the_present_step_count_before_it_is_written() -> None:
    seen = SeenEntities([("f", "a", "1")])
    assert seen.digest("f", "a", {}) == "1"
    assert seen.digest("f", "a", {("f", "a"): "2"}) == "2"
    assert seen.digest("f", "a", {("f", "a"): None}) is None
    assert seen.digest("g", "a", {}) is None


def test_what_is_forgotten_leaves_nothing_behind() -> None:
    seen = SeenEntities([("f", "a", "1"), ("f", BASELINE, BASELINE)])
    seen.apply({("f", "a"): None, ("f", BASELINE): None, ("g", "b"): None})
    assert seen.keys() == set()


def test_the_order_of_members_does_not_change_a_digest() -> None:
    assert digest_of({"a": 1, "b": [2]}) == digest_of({"b": [2], "a": 1})
    assert digest_of({"a": 1}) != digest_of({"a": 2})


def at(second: int, value: object) -> dict[str, object]:
    return {"type": "Property", "value": value, "modifiedAt": f"2026-05-04T08:00:{second:02}Z"}


def test_the_states_of_an_entity_are_replayed_in_their_order() -> None:
    evolution = {
        "id": "urn:x:1",
        "type": "Tank",
        "level": [at(3, 2), at(1, 8), {"type": "Property", "value": 9, "modifiedAt": "soon"}],
        "open": [at(3, True)],
    }
    present = {
        "id": "urn:x:1",
        "type": "Tank",
        "level": {"type": "Property", "value": 2},
        "colour": {"type": "Property", "value": "red"},
    }
    first, second = replay(evolution, present)
    assert first == present | {"level": {"type": "Property", "value": 8}}
    assert second == present | {"open": {"type": "Property", "value": True}}


def test_an_entity_that_was_deleted_is_replayed_from_its_history_alone() -> None:
    (state,) = replay({"id": "urn:x:1", "type": "Tank", "level": [at(1, 8)]}, {})
    assert state == {"id": "urn:x:1", "type": "Tank", "level": {"type": "Property", "value": 8}}
