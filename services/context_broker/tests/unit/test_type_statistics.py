"""Type statistics: counts that are updated with each change equal the stored entities."""

from collections import Counter
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from handover_broker.model.entity import Entity
from handover_broker.storage.type_statistics import TypeStatistics

KINDS = ("Property", "Relationship", "GeoProperty")
instances = st.lists(st.fixed_dictionaries({"type": st.sampled_from(KINDS)}), min_size=1, max_size=3)
attributes = st.dictionaries(st.sampled_from(["u:a", "u:b", "u:c"]), instances)
types = st.lists(st.sampled_from(["u:A", "u:B", "u:C"]), min_size=1, max_size=2, unique=True)
bodies = st.none() | st.tuples(types, attributes)
changes = st.lists(
    st.tuples(st.sampled_from(["urn:1", "urn:2", "urn:3"]), bodies, st.booleans()), max_size=30
)


def entity(one: str, kinds: list[str], said: dict[str, Any]) -> Entity:
    return Entity(one, tuple(kinds), said, "", "")


@given(changes)
def test_counts_equal_the_stored_entities(made: list[tuple[str, Any, bool]]) -> None:
    type_statistics, there = TypeStatistics(), dict[str, Entity]()
    for one, body, keeps in made:
        before = there.pop(one, None)
        after = None if body is None else entity(one, *body)
        if before is not None and after is not None and keeps:
            after = entity(one, list(before.types), {**before.attributes, **after.attributes})
        type_statistics.note(before, after)
        if after is not None:
            there[one] = after
    expected_types = Counter(kind for one in there.values() for kind in one.types)
    assert {kind: type_statistics.entities_of(kind) for kind in type_statistics.types()} == dict(
        expected_types
    )
    by_attribute = Counter(
        (name, instance["type"])
        for one in there.values()
        for name, said in one.attributes.items()
        for instance in said
    )
    counted = {
        (name, kind): number
        for name in type_statistics.attributes()
        for kind, number in type_statistics.kinds_of(name).items()
    }
    assert counted == dict(by_attribute)
    by_type = {
        (kind, name, instance["type"])
        for one in there.values()
        for kind in one.types
        for name, said in one.attributes.items()
        for instance in said
    }
    assert by_type == {
        (kind, name, said)
        for kind in expected_types
        for name, kinds in type_statistics.attributes_of(kind).items()
        for said in kinds
    }
    for name in type_statistics.attributes():
        assert set(type_statistics.types_with(name)) == {kind for kind, known, _ in by_type if known == name}


def test_missing_types_and_attributes_count_as_zero() -> None:
    type_statistics = TypeStatistics()
    assert type_statistics.types() == type_statistics.attributes() == type_statistics.types_with("u:a") == []
    assert type_statistics.entities_of("u:A") == 0
    assert not type_statistics.attributes_of("u:A")
    assert not type_statistics.kinds_of("u:a")
