"""Our terms mean the same to every broker, whatever version of the core context it appends."""

from functools import cache
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyld import jsonld

from datamodels.tests.unit.drawn_entities import entities
from handover_datamodels import TYPES
from handover_datamodels.contexts import (
    CORE_EXCEPTIONS,
    CORE_MINORS,
    CORE_URL,
    HANDOVER_URL,
    SHOP4CF_URL,
    SMART_DATA_MODELS_URL,
    TermMap,
    core_terms,
    handover_context,
    resolve,
)

DEFAULT = "https://uri.etsi.org/ngsi-ld/default-context/"
OURS = (HANDOVER_URL, SMART_DATA_MODELS_URL, SHOP4CF_URL)
MEMBERS = {"@id", "@type", "@container"}
"""What JSON-LD 1.0 knows in the definition of a term and NGSI-LD uses."""
LAST = CORE_MINORS[-1]


def core_url(minor: int) -> str:
    return f"https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context-v1.{minor}.jsonld"


def terms_of(url: str) -> dict[str, Any]:
    document = resolve(url)
    assert document is not None
    terms: dict[str, Any] = document["@context"]
    return terms


@pytest.mark.parametrize("url", OURS)
def test_a_context_of_ours_is_plain_json_ld_1_0(url: str) -> None:
    for term, meant in terms_of(url).items():
        assert not term.startswith("@"), f"{term} is refused by brokers that know JSON-LD 1.0 only"
        assert isinstance(meant, str | dict), term
        if isinstance(meant, dict):
            assert meant.keys() <= MEMBERS, term
            assert all(isinstance(each, str) for each in meant.values()), term


@pytest.mark.parametrize("minor", CORE_MINORS)
@pytest.mark.parametrize("url", OURS)
def test_no_term_of_ours_has_another_iri_or_type_in_a_core_context(url: str, minor: int) -> None:
    ours = terms_of(url)
    core = terms_of(core_url(minor))
    for term in ours.keys() & core.keys():
        same = _definition(term, ours) == _definition(term, core)
        assert same == (not (term in CORE_EXCEPTIONS and minor < 3)), term


def _definition(term: str, terms: dict[str, Any]) -> dict[str, Any]:
    """Return what `term` means: its IRI in full, its type and container."""
    meant = terms[term] if isinstance(terms[term], dict) else {"@id": terms[term]}
    prefix, _, name = meant["@id"].partition(":")
    return {**meant, "@id": terms[prefix] + name if prefix in terms and name else meant["@id"]}


def test_the_exceptions_have_no_type_in_any_core_context() -> None:
    for minor in CORE_MINORS:
        assert all(isinstance(core_terms(minor).get(term, ""), str) for term in CORE_EXCEPTIONS)


def test_every_name_of_the_data_model_is_free_of_the_core_contexts_or_means_the_same() -> None:
    ours = terms_of(HANDOVER_URL)
    names = {
        field.alias or name
        for model in TYPES.values()
        for name, field in model.model_fields.items()
        if name not in {"id", "type", "context", "created_at", "modified_at"}
    }
    assert names <= ours.keys()
    assert not {"start", "end", "endTime", "expires", "time", "relationships"} & ours.keys()


@cache
def iri(name: str, minor: int | None) -> str:
    """Return what a JSON-LD processor expands a name to, with our context and then a core context."""
    core = {"@vocab": DEFAULT} if minor is None else terms_of(core_url(minor))
    ours = handover_context()["@context"]
    (expanded,) = jsonld.expand({"@context": [ours, core], "@type": name})
    found: str = expanded["@type"][0]
    return found


@pytest.mark.nightly
@pytest.mark.parametrize("kind", sorted(TYPES))
@given(data=st.data())
@settings(max_examples=5)
def test_any_entity_has_the_same_iris_with_every_core_context(kind: str, data: st.DataObject) -> None:
    entity = data.draw(entities(kind))
    ours = handover_context()["@context"].keys()
    names = {entity["type"]} | entity.keys() - {"id", "type", "@context"}
    for attribute in entity.values():
        for instance in attribute if isinstance(attribute, list) else [attribute]:
            if isinstance(instance, dict):
                names |= instance.keys() & ours - {"value"}
    for minor in CORE_MINORS:
        for name in names:
            if name in CORE_EXCEPTIONS and minor < 3:
                assert iri(name, minor) == f"https://uri.etsi.org/ngsi-ld/{name}"
            else:
                assert iri(name, minor) == iri(name, None), f"{name} with 1.{minor}"


@pytest.mark.parametrize("minor", CORE_MINORS)
def test_a_core_context_has_the_terms_of_its_version(minor: int) -> None:
    assert core_terms(minor).keys() <= terms_of(core_url(minor)).keys()
    terms = TermMap(core_url(minor))
    was, became = ("start", "startAt") if minor < 3 else ("startAt", "start")
    assert (was in core_terms(minor), became in core_terms(minor)) == (True, False)
    assert terms.expand("start") == ("https://uri.etsi.org/ngsi-ld/start" if minor < 3 else f"{DEFAULT}start")
    assert terms.expand("observedAt") == "https://uri.etsi.org/ngsi-ld/observedAt"
    assert terms.expand("type") == "@type"


def test_the_versions_add_rename_and_remove_terms() -> None:
    first, renamed, middle, last = (core_terms(minor) for minor in (0, 3, 7, LAST))
    assert {"start", "end", "endTime", "time", "expires", "relationships", "name"} <= first.keys()
    assert not {"start", "end", "endTime", "time", "expires", "relationships", "name"} & renamed.keys()
    assert (first["description"], renamed["description"]) == (
        "ngsi-ld:description",
        "http://purl.org/dc/terms/description",
    )
    assert "VocabularyProperty" in middle.keys() - last.keys()
    assert core_terms(0) == core_terms(1) == core_terms(2)


def test_the_terms_of_our_broker_are_those_of_the_last_version() -> None:
    ours, last = terms_of(CORE_URL), terms_of(core_url(LAST))
    assert ours.keys() <= last.keys()
    different = {
        term
        for term in ours.keys() & core_terms(LAST)
        if _definition(term, ours)["@id"] != _definition(term, last)["@id"]
    }
    assert different <= {"attributeCount", "attributeDetails"}, "names of answers, not of attributes"
