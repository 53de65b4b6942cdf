"""The copy of a broker: what counts as equal, and the limits of batches."""

from typing import Any

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.broker_copy.broker_side import MAX_BATCH, MAX_BATCH_BYTES, batches
from handover.broker_copy.entity_form import differences, expanded, with_terms
from handover_datamodels.contexts import term_map

N = "https://example.org/n"
CORE = term_map(None)


def entity(attribute: Any, **members: Any) -> dict[str, Any]:
    return {"id": "urn:x:1", "type": "https://example.org/T", N: attribute, **members}


def prop(value: Any, **members: Any) -> dict[str, Any]:
    return {"type": "Property", "value": value, **members}


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (prop(1), prop(1.0)),
        (prop(1, observedAt="2026-01-01T00:00:00Z"), prop(1, observedAt="2026-01-01T01:00:00.000+01:00")),
        ([prop(1), prop(2, datasetId="urn:d:1")], [prop(2, datasetId="urn:d:1"), prop(1)]),
        (prop(1), [prop(1)]),
    ],
)
def test_the_same_content_in_another_form_is_equal(first: Any, second: Any) -> None:
    assert not list(differences(entity(first), entity(second)))


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (prop(1), prop(True)),
        (prop(0), prop(False)),
        (prop([5]), prop(5)),
        (prop(2147483648), prop(-2147483648)),
        (prop({"observedAt": "2026-01-01T00:00:00Z"}), prop({"observedAt": "2026-01-01T00:00:00.0Z"})),
        (prop("1"), prop(1)),
        (prop(1, unitCode="MTR"), prop(1)),
        (prop(1), [prop(1), prop(1, datasetId="urn:d:1")]),
        (prop(1, **{f"{N}2": prop(1)}), prop(1, **{f"{N}2": prop(2)})),
    ],
)
def test_another_content_is_a_difference_of_its_attribute(first: Any, second: Any) -> None:
    for one, other in ((first, second), (second, first)):
        assert [found.member.partition(" ")[0] for found in differences(entity(one), entity(other))] == [N]


def test_types_scopes_and_expiry_are_compared_too() -> None:
    plain = entity(prop(1))
    for changed in (
        {"type": "https://example.org/U"},
        {"scope": "/a"},
        {"expiresAt": "2099-01-01T00:00:00Z"},
    ):
        assert [found.member for found in differences(plain, {**plain, **changed})] == list(changed)
    assert not list(differences({**plain, "scope": "/a"}, {**plain, "scope": ["/a"]}))


def test_names_become_iris_and_the_times_of_the_broker_are_left_out() -> None:
    found = expanded(
        {
            "id": "urn:x:1",
            "type": "T",
            "createdAt": "2026-01-01T00:00:00Z",
            "location": {"type": "GeoProperty", "value": {"type": "Point", "coordinates": [1, 2]}},
            "n": prop({"type": "Property", "value": 1}, modifiedAt="2026-01-01T00:00:00Z", below=prop(1)),
            "v": {"type": "VocabProperty", "vocab": ["a", "b"]},
        },
        CORE,
    )
    base = "https://uri.etsi.org/ngsi-ld/default-context/"
    assert found == {
        "id": "urn:x:1",
        "type": f"{base}T",
        "location": {"type": "GeoProperty", "value": {"type": "Point", "coordinates": [1, 2]}},
        f"{base}n": prop({"type": "Property", "value": 1}, **{f"{base}below": prop(1)}),
        f"{base}v": {"type": "VocabProperty", "vocab": [f"{base}a", f"{base}b"]},
    }


def test_an_iri_that_is_no_name_is_sent_as_a_term() -> None:
    odd = "https://example.org/b,c"
    sent = with_terms({**entity(prop(1)), odd: prop(2), "type": [odd, "https://example.org/T"]})
    assert odd not in sent
    assert expanded(sent, term_map(sent["@context"])) == {
        **entity(prop(1)),
        odd: prop(2),
        "type": [odd, "https://example.org/T"],
    }
    assert "@context" not in with_terms(entity(prop(1)))


@given(st.lists(st.integers(0, 3) | st.integers(0, 300_000), max_size=250))
def test_batches_have_everything_in_order_within_the_limits(sizes: list[int]) -> None:
    entities = [{"id": f"urn:x:{at}", "text": "x" * size} for at, size in enumerate(sizes)]
    made = list(batches(entities))
    assert [one for batch in made for one in batch] == entities
    for batch in made:
        assert len(batch) <= MAX_BATCH
        assert len(batch) == 1 or len(orjson.dumps(batch)) <= MAX_BATCH_BYTES
