"""Fragments of one entity: the newest counts, and the order of responses never matters."""

import itertools
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.model.attribute_selection import select_attributes
from handover_broker.model.entity import Attributes, Entity
from handover_datamodels.contexts import TermMap, resolve
from handover_federation.distribution.forwarding.translation import translated
from handover_federation.distribution.reads.fragments import (
    Fragment,
    merged,
    read_fragment,
    without_expired,
)

TERMS = TermMap(None, resolve)
DEFAULT = "https://uri.etsi.org/ngsi-ld/default-context/"
EARLY, LATE = "2026-01-01T00:00:00Z", "2026-01-02T00:00:00Z"


def entity(**attributes: Any) -> Entity:
    named: Attributes = {f"urn:x:{name}": instances for name, instances in attributes.items()}
    return Entity("urn:x:1", ("urn:x:T",), named, EARLY, EARLY, 1)


def one(value: Any, **times: str) -> list[dict[str, Any]]:
    return [{"type": "Property", "value": value, **times}]


def value_of(found: Entity, name: str) -> Any:
    return found.attributes[f"urn:x:{name}"][0]["value"]


@pytest.mark.parametrize(
    ("ours", "theirs", "winner"),
    [
        ({"observedAt": EARLY}, {"observedAt": LATE}, "theirs"),
        ({"observedAt": LATE}, {"observedAt": EARLY}, "ours"),
        ({"observedAt": EARLY, "modifiedAt": LATE}, {"observedAt": LATE, "modifiedAt": EARLY}, "theirs"),
        ({"observedAt": EARLY, "modifiedAt": EARLY}, {"observedAt": EARLY, "modifiedAt": LATE}, "theirs"),
        ({"modifiedAt": EARLY}, {"modifiedAt": LATE}, "theirs"),
        ({"modifiedAt": LATE}, {"observedAt": EARLY}, "theirs"),
        ({}, {"modifiedAt": EARLY}, "theirs"),
        ({}, {}, "ours"),
        ({"observedAt": "2026-01-02T01:00:00+02:00"}, {"observedAt": LATE}, "theirs"),
    ],
)
def test_the_latest_observation_counts_then_the_latest_write_then_the_own_part(
    ours: dict[str, str], theirs: dict[str, str], winner: str
) -> None:
    fragments = [
        Fragment(entity(a=one("ours", **ours)), (0, "")),
        Fragment(entity(a=one("theirs", **theirs)), (3, "urn:r")),
    ]
    assert value_of(merged(fragments), "a") == winner


def test_an_auxiliary_source_only_fills_gaps() -> None:
    fragments = [
        Fragment(entity(a=one(1, observedAt=EARLY)), (0, "")),
        Fragment(entity(a=one(2, observedAt=LATE), b=one(3)), (4, "urn:r"), fills_gaps=True),
    ]
    found = merged(fragments)
    assert (value_of(found, "a"), value_of(found, "b")) == (1, 3)


def test_instances_of_several_datasets_are_kept() -> None:
    first = entity(
        a=[{"type": "Property", "value": 1}, {"type": "Property", "value": 2, "datasetId": "urn:d:1"}]
    )
    second = entity(a=[{"type": "Property", "value": 3, "datasetId": "urn:d:2"}])
    found = merged([Fragment(first, (0, "")), Fragment(second, (3, "urn:r"))])
    assert [instance["value"] for instance in found.attributes["urn:x:a"]] == [1, 2, 3]


_TIMES = st.sampled_from([None, EARLY, LATE])
_INSTANCES = st.builds(
    lambda value, observed, written, dataset: {
        "type": "Property",
        "value": value,
        **({"observedAt": observed} if observed else {}),
        **({"modifiedAt": written} if written else {}),
        **({"datasetId": dataset} if dataset else {}),
    },
    st.integers(0, 3),
    _TIMES,
    _TIMES,
    st.sampled_from([None, "urn:d:1"]),
)
_FRAGMENTS = st.lists(
    st.builds(
        lambda attributes, rank, fills_gaps: Fragment(entity(**attributes), rank, fills_gaps),
        st.dictionaries(st.sampled_from("abc"), st.lists(_INSTANCES, min_size=1, max_size=1)),
        st.tuples(st.integers(0, 4), st.sampled_from(["", "urn:r:1", "urn:r:2"])),
        st.booleans(),
    ),
    min_size=1,
    max_size=4,
)


@given(_FRAGMENTS)
def test_the_order_of_responses_does_not_matter(fragments: list[Fragment]) -> None:
    expected = merged(fragments).stored()
    assert all(merged(some).stored() == expected for some in itertools.permutations(fragments))


@given(_FRAGMENTS)
def test_a_merge_adds_and_loses_no_attribute(fragments: list[Fragment]) -> None:
    found = merged(fragments)
    returned = {name for one in fragments for name in one.entity.attributes}
    assert found.attributes.keys() == returned
    for name, instances in found.attributes.items():
        everything = [one for each in fragments for one in each.entity.attributes.get(name, ())]
        assert all(instance in everything for instance in instances)


def test_attributes_of_an_entity_are_selected() -> None:
    whole = entity(a=one(1), b=one(2), c=one(3))
    assert select_attributes(whole, None) is whole
    assert select_attributes(
        whole, frozenset({"urn:x:a", "urn:x:b"}), frozenset({"urn:x:b"})
    ).attributes.keys() == {"urn:x:a"}


def test_timestamps_of_a_source_are_kept() -> None:
    document = {
        "id": "urn:x:1",
        "type": "T",
        "createdAt": EARLY,
        "modifiedAt": LATE,
        "a": {"type": "Property", "value": 1, "createdAt": EARLY, "modifiedAt": LATE, "b": {"value": 2}},
    }
    found = read_fragment(document, TERMS, 7)
    assert (found.created_at, found.modified_at, found.seq) == (EARLY, LATE, 7)
    (instance,) = found.attributes[f"{DEFAULT}a"]
    assert (instance["createdAt"], instance["modifiedAt"]) == (EARLY, LATE)


def test_expired_parts_are_removed() -> None:
    over, to_come = {"expiresAt": EARLY}, {"expiresAt": "2999-01-01T00:00:00Z"}
    assert without_expired({"id": "urn:x:1", "type": "T", **over}, 2e9) is None
    returned: dict[str, Any] = {
        "id": "urn:x:1",
        "type": "T",
        **to_come,
        "a": {"value": 1, **over},
        "b": [{"value": 1, **over}, {"value": 2, "datasetId": "urn:x:d", **to_come}],
        "c": [{"value": 1, **over}],
        "d": {"value": []},
    }
    left = {name: said for name, said in returned.items() if name not in {"a", "b", "c"}}
    assert without_expired(returned, 2e9) == {**left, "b": returned["b"][1:]}


PIECES = st.sampled_from(
    ["id", "type", "@id", "@type", "scope", "expiresAt", "createdAt", "modifiedAt", "observedAt", "datasetId",
     "value", "object", "languageMap", "json", "vocab", "valueList", "objectList", "entity", "previousValue",
     "urn:x:1", "T", "Property", "Relationship", "GeoProperty", "urn:ngsi-ld:null", EARLY, "@context", "a"]
)  # fmt: skip
ANYTHING = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=False)
    | st.text(max_size=3)
    | PIECES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(PIECES, inner, max_size=5),
    max_leaves=12,
)


@given(ANYTHING)
def test_any_document_of_a_source_is_an_entity_or_a_problem(said: Any) -> None:
    try:
        found = read_fragment(without_expired(said, 2e9), TERMS, 1)
    except Problem:
        return
    assert merged([Fragment(found, (1, "urn:x:r")), Fragment(found, (0, ""))]).id == found.id


@given(ANYTHING)
def test_any_document_of_a_source_can_be_translated(said: Any) -> None:
    if isinstance(said, dict):
        translated(said, TERMS, TERMS)
