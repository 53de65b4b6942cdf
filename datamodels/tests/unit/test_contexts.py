"""Words expand to the names the world knows them by, and come back, without any network."""

import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pyld import jsonld

from handover_datamodels import TYPES, DataModelError
from handover_datamodels.contexts import (
    CORE_URL,
    HANDOVER_URL,
    SHOP4CF_URL,
    SMART_DATA_MODELS_URL,
    ContextNotAvailable,
    TermMap,
    handover_context,
    resolve,
    term_map,
)

DEFAULT = "https://uri.etsi.org/ngsi-ld/default-context/"
FIWARE = "https://uri.fiware.org/ns/data-models#"
CORE = "https://uri.etsi.org/ngsi-ld/"
PUBLISHED = [SMART_DATA_MODELS_URL, SHOP4CF_URL]

NAMES = sorted(
    {
        field.alias or name
        for model in TYPES.values()
        for name, field in model.model_fields.items()
        if name not in {"id", "type", "context", "created_at", "modified_at"}
    }
)


@pytest.mark.parametrize("context", [HANDOVER_URL, PUBLISHED, handover_context()])
def test_the_vocabulary_expands_alike_under_our_context_and_the_published_ones(context: Any) -> None:
    terms = term_map(context)
    for name in TYPES:
        assert terms.expand(name) == (FIWARE if name in {"Device", "Alert"} else DEFAULT) + name
    assert terms.expand("status") == CORE + "status"
    special = {
        "status": CORE + "status",
        "location": CORE + "location",
        "reason": CORE + "reason",
        "value": CORE + "hasValue",
        "description": "http://purl.org/dc/terms/description",
    }
    for name in NAMES:
        assert terms.expand(name) == special.get(name, DEFAULT + name)
        assert terms.compact(terms.expand(name)) == name


def test_our_context_holds_every_word_of_the_vocabulary() -> None:
    assert {*TYPES, *NAMES, "locationFunction"} <= handover_context()["@context"].keys()


@pytest.mark.parametrize("version", ["", "-v1.23"])
@pytest.mark.parametrize("scheme", ["https", "http"])
def test_a_core_context_without_a_known_version_has_the_terms_of_the_broker(
    version: str, scheme: str
) -> None:
    url = f"{scheme}://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context{version}.jsonld"
    assert resolve(url) == resolve(CORE_URL)


@pytest.mark.parametrize(
    "url",
    [
        "https://example.com/context.jsonld",
        "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-contextXjsonld",
        f"{CORE_URL}?x",
        "",
    ],
)
def test_a_context_that_is_not_shipped_is_not_there(url: str) -> None:
    assert resolve(url) is None


@pytest.mark.parametrize("url", [HANDOVER_URL, *PUBLISHED, CORE_URL])
def test_a_shipped_document_is_the_callers_own(url: str) -> None:
    document = resolve(url)
    assert document is not None
    before = json.dumps(document)
    document["@context"].clear()
    assert json.dumps(resolve(url)) == before


def test_the_context_files_name_no_term_twice() -> None:
    for path in files("handover_datamodels.contexts").iterdir():
        if path.name.endswith(".jsonld"):
            pairs: list[tuple[str, Any]] = json.loads(
                path.read_text(encoding="utf-8"), object_pairs_hook=list
            )[0][1]
            terms = [term for term, _ in pairs]
            assert len(terms) == len(set(terms)), path.name


@pytest.mark.parametrize(
    ("term", "iri"),
    [
        ("id", "@id"),
        ("type", "@type"),
        ("observedAt", CORE + "observedAt"),
        ("unitCode", CORE + "unitCode"),
        ("object", CORE + "hasObject"),
        ("languageMap", CORE + "hasLanguageMap"),
        ("json", CORE + "hasJSON"),
        ("vocab", CORE + "hasVocab"),
        ("valueList", CORE + "hasValueList"),
        ("Property", CORE + "Property"),
        ("GeoProperty", CORE + "GeoProperty"),
        ("Point", "https://purl.org/geojson/vocab#Point"),
        ("coordinates", "https://purl.org/geojson/vocab#coordinates"),
        ("observationSpace", CORE + "observationSpace"),
        ("title", "http://purl.org/dc/terms/title"),
        ("DateTime", CORE + "DateTime"),
    ],
)
def test_core_terms_are_there_without_any_context(term: str, iri: str) -> None:
    terms = TermMap(None)
    assert terms.expand(term) == iri
    assert terms.compact(iri) == term


def test_the_core_cannot_be_overridden() -> None:
    terms = term_map({"observedAt": "https://example.com/seen", "type": "https://example.com/type"})
    assert terms.expand("observedAt") == CORE + "observedAt"
    assert terms.expand("type") == "@type"


def test_prefixes_and_iris() -> None:
    terms = term_map({"ex": "https://example.com/ns#", "Robot": "ex:Robot"})
    assert terms.expand("ex:Arm") == "https://example.com/ns#Arm"
    assert terms.expand("Robot") == "https://example.com/ns#Robot"
    assert terms.expand("https://example.com/x") == "https://example.com/x"
    assert terms.expand("urn:ngsi-ld:x") == "urn:ngsi-ld:x"
    assert terms.expand("ngsi-ld:status") == CORE + "status"
    assert terms.expand("@none") == "@none"
    assert terms.compact("https://example.com/ns#Arm") == "ex:Arm"
    assert terms.compact("https://example.com/ns#Robot") == "Robot"
    assert terms.compact("https://example.com/other") == "https://example.com/other"
    assert terms.compact(DEFAULT + "colour") == "colour"


def test_a_name_is_not_shortened_to_one_that_means_something_else() -> None:
    terms = term_map({"colour": "https://example.com/colour"})
    assert terms.expand(terms.compact(DEFAULT + "colour")) == DEFAULT + "colour"
    assert terms.expand(terms.compact(DEFAULT + "observedAt")) == DEFAULT + "observedAt"


def test_terms_may_be_defined_in_any_order_and_by_objects() -> None:
    terms = term_map(
        {
            "arm": {"@id": "ex:arm", "@type": "@id"},
            "ex": {"@id": "base:things/", "@prefix": True},
            "base": "https://example.com/",
            "ex:leg": {"@type": "@id"},
            "alias": "arm",
        }
    )
    assert terms.expand("arm") == "https://example.com/things/arm"
    assert terms.expand("alias") == "https://example.com/things/arm"
    assert terms.expand("ex:leg") == "https://example.com/things/leg"
    assert terms.compact("https://example.com/things/arm") == "arm"


def test_later_contexts_override_earlier_ones() -> None:
    terms = term_map(
        [
            {"a": "https://one.example/a", "b": "https://one.example/b"},
            {"a": "https://two.example/a", "b": None},
        ]
    )
    assert terms.expand("a") == "https://two.example/a"
    assert terms.expand("b") == DEFAULT + "b"
    assert term_map([{"a": "https://one.example/a"}, None]).expand("a") == DEFAULT + "a"
    with pytest.raises(DataModelError, match="defined by itself"):  # not by way of what it was before
        term_map([{"a": "https://one.example/"}, {"a": "a:x"}])


def test_a_vocabulary_of_ones_own() -> None:
    terms = term_map({"@vocab": "https://example.com/ns#", "arm": "manipulator"})
    assert terms.expand("leg") == "https://example.com/ns#leg"
    assert terms.expand("arm") == "https://example.com/ns#manipulator"
    assert terms.expand("status") == CORE + "status"
    assert terms.compact("https://example.com/ns#leg") == "leg"
    assert term_map({"@vocab": None}).expand("leg") == DEFAULT + "leg"


def test_an_unknown_url_is_named() -> None:
    with pytest.raises(ContextNotAvailable, match=r"https://example\.com/c\.jsonld") as missing:
        term_map([HANDOVER_URL, "https://example.com/c.jsonld"])
    assert missing.value.url == "https://example.com/c.jsonld"
    assert isinstance(missing.value, DataModelError)


def test_documents_may_come_from_elsewhere_and_lead_on() -> None:
    documents: Mapping[str, Any] = {
        "https://example.com/a/c.jsonld": {"@context": ["../b.jsonld", HANDOVER_URL]},
        "https://example.com/b.jsonld": {"@context": {"arm": "https://example.com/arm"}},
    }
    terms = TermMap("https://example.com/a/c.jsonld", lambda url: documents.get(url) or resolve(url))
    assert terms.expand("arm") == "https://example.com/arm"
    assert terms.expand("Device") == FIWARE + "Device"


@pytest.mark.parametrize(
    ("context", "reported"),
    [
        (3, "a URL, an object or a list of both"),
        ({"arm": 3}, 'the term "arm" of an @context must be an IRI'),
        ({"arm": {"@id": ["x"]}}, 'the term "arm"'),
        ({"@vocab": 3}, "the @vocab of an @context is an IRI"),
        ({"Arm": {"@id": "urn:x:Arm", "@context": {"value": "urn:x:value"}}}, "a scoped context"),
        ("https://example.com/self.jsonld", "refers to itself"),
        ("https://example.com/list.jsonld", 'has no "@context"'),
        (["https://example.com/empty.jsonld"] * 200, "too many others"),
    ],
)
def test_what_is_no_context_is_refused_with_the_reason(context: Any, reported: str) -> None:
    documents: dict[str, Any] = {
        "https://example.com/self.jsonld": {"@context": "https://example.com/self.jsonld"},
        "https://example.com/list.jsonld": ["@context"],
        "https://example.com/empty.jsonld": {"@context": {}},
    }
    with pytest.raises(DataModelError, match=reported):
        TermMap(context, documents.get)


@pytest.mark.parametrize("make", [TermMap, term_map])
def test_a_bottomless_context_is_refused(make: Any) -> None:
    context: list[Any] = []
    for _ in range(20_000):
        context = [context]
    with pytest.raises(DataModelError, match="nested too deeply"):
        make(context)


def test_a_copy_of_the_core_context_is_no_fault() -> None:
    proof = {"@id": "https://uri.etsi.org/ngsi-ld/ngsildproof", "@context": [{"sealed": "urn:x:sealed"}]}
    assert term_map([{"ngsildproof": proof, "arm": "urn:x:arm"}]).expand("arm") == "urn:x:arm"


def test_equal_contexts_share_one_map() -> None:
    assert term_map(HANDOVER_URL) is term_map(HANDOVER_URL)
    assert term_map([{"a": "urn:x:a"}, HANDOVER_URL]) is term_map([{"a": "urn:x:a"}, HANDOVER_URL])
    assert term_map([{"a": "urn:x:b"}, HANDOVER_URL]) is not term_map([{"a": "urn:x:a"}, HANDOVER_URL])


def test_strange_names_do_not_fill_the_memory() -> None:
    terms = TermMap(HANDOVER_URL)
    for number in range(10_000):
        terms.expand(f"strange{number}")
        terms.compact(f"https://example.com/strange{number}")
    terms.expand("x" * 1000)
    assert len(terms._iris) < 6000
    assert len(terms._terms) < 6000
    assert "x" * 1000 not in terms._iris
    assert terms.expand("strange9999") == DEFAULT + "strange9999"


SOME_TERMS = st.sampled_from(["a", "b", "ex", "colour", "status", "ex:a", "Device"])
SOME_IRIS = st.sampled_from(
    ["https://example.com/", "https://example.com/a", "ex:b", "a", "urn:x:y", DEFAULT, DEFAULT + "a", "@id"]
)


@given(
    st.dictionaries(SOME_TERMS, SOME_IRIS | st.none() | SOME_IRIS.map(lambda iri: {"@id": iri})),
    st.text(max_size=8)
    | SOME_TERMS
    | SOME_IRIS
    | st.text(max_size=4).map(lambda suffix: DEFAULT + suffix)
    | st.text(max_size=4).map(lambda suffix: "https://example.com/" + suffix),
)
def test_a_compacted_name_expands_to_the_same_iri(context: dict[str, Any], name: str) -> None:
    try:
        terms = TermMap(context)
    except DataModelError as error:
        assume("defined by itself" not in str(error))
        raise
    iri = terms.expand(name)
    assert terms.expand(terms.compact(iri)) == iri


PREFIXES = {"ex": "https://example.com/", "ns": "https://example.com/ns#"}
PLAIN_IRIS = st.sampled_from(
    ["https://example.com/a", "ex:b", "ns:c", "urn:x:y", DEFAULT + "a", "a", "colour"]
)
PLAIN_TERMS = st.sampled_from(["a", "b", "colour", "Robot", "ex:a", "tag:it"])


@given(
    st.dictionaries(
        PLAIN_TERMS,
        PLAIN_IRIS | st.builds(lambda iri, kind: {"@id": iri, "@type": kind}, PLAIN_IRIS, st.just("@id")),
    ),
    st.sampled_from([{}, {"@vocab": "https://example.com/own#"}, {"@version": 1.1}]),
    PLAIN_TERMS | PLAIN_IRIS | st.sampled_from(["ns:x", "nobody:x", "unknown"]),
)
def test_names_expand_as_a_json_ld_processor_expands_them(
    terms: dict[str, Any], own: dict[str, Any], name: str
) -> None:
    context = {**own, **PREFIXES, **terms}
    document = {"@context": [{"@vocab": DEFAULT}, context], "@type": name}
    try:
        (expanded,) = jsonld.expand(document)
    except jsonld.JsonLdError:
        assume(False)
    assert TermMap(context).expand(name) == expanded["@type"][0]


@pytest.mark.parametrize(
    "context", [{"ex": "ex:b"}, {"ex": {"@id": "ex:b"}}, {"a": "b:x", "b": "a:y"}, {"a": "b", "b": "a"}]
)
def test_a_term_that_is_defined_by_itself_is_refused(context: dict[str, Any]) -> None:
    with pytest.raises(DataModelError, match="by itself; define it with a complete IRI"):
        TermMap(context)


@pytest.mark.parametrize("context", [{"a": "a"}, {"ex": "https://e.com/", "ex:a": {"@type": "@id"}}])
def test_a_term_may_stand_for_its_own_name(context: dict[str, Any]) -> None:
    name = next(reversed(context))
    assert TermMap(context).expand(name) in {DEFAULT + "a", "https://e.com/a"}
