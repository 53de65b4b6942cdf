"""Any JSON input is accepted, or refused with a problem."""

from collections.abc import Callable
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.delivery.subscription import subscription
from handover_broker.delivery.subscription_documents import (
    kept_document,
    shown_document,
    updated_document,
)
from handover_broker.model.changes import appended, created, merged
from handover_broker.model.completion import completed, normalized
from handover_broker.model.context import Context
from handover_broker.model.entity_parser import read_change, read_entity
from handover_broker.model.representation.rendering import Form, View, render
from handover_datamodels.contexts import HANDOVER_URL, TermMap

CONTEXT = Context(0, TermMap(HANDOVER_URL), HANDOVER_URL, b"", HANDOVER_URL)
TERMS = CONTEXT.terms
AT = "2026-01-01T00:00:00.000000Z"


def documents(*members: str, values: tuple[Any, ...] = ()) -> st.SearchStrategy[Any]:
    """JSON with many members and values of NGSI-LD."""
    plain = (
        st.none()
        | st.booleans()
        | st.integers(-(2**63), 2**64 - 1)
        | st.text(max_size=5)
        | st.sampled_from(values)
    )
    names = st.sampled_from(members) | st.text(max_size=3)
    return st.recursive(
        plain,
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(names, inner, max_size=4),
        max_leaves=10,
    )


ATTRIBUTES = documents(
    "type", "@type", "value", "object", "vocab", "languageMap", "objectList", "datasetId", "coordinates",
    values=("Property", "Relationship", "GeoProperty", "Point", "VocabProperty", "ListRelationship",
            "urn:ngsi-ld:null", "urn:x:1"),
)  # fmt: skip
WISHES = documents(
    "id", "type", "entities", "idPattern", "watchedAttributes", "q", "notification", "endpoint", "uri",
    "accept", "format", "receiverInfo", "key", "throttling", "expiresAt", "notificationTrigger", "pick",
    "omit", "timeInterval", "geoQ", "scopeQ", "csf", "lang", "datasetId", "localOnly", "join", "joinLevel",
    "value", "showChanges", "sysAttrs", "notifierInfo", "timeout", "cooldown", "jsonldContext",
    values=("Subscription", "urn:x:1", "http://127.0.0.1:9/", "mqtt://127.0.0.1/x", "normalized", "flat",
            "application/json", "entityUpdated", "urn:ngsi-ld:request", "MQTT-QoS", "/a/#"),
)  # fmt: skip


def refusal(act: Callable[[], object]) -> int | None:
    """Return the status of a refusal; None if the input was accepted."""
    try:
        act()
    except Problem as problem:
        return problem.status if problem.detail else 0
    return None


@given(ATTRIBUTES)
def test_any_entity(attribute: Any) -> None:
    def keep_and_show() -> None:
        entity = created(read_entity({"id": "urn:x:1", "type": "Task", "a": attribute}, TERMS), AT, 1)
        for form in Form:
            assert render(entity, TERMS, View(form, sys_attrs=True))

    assert refusal(keep_and_show) in {None, 400, 422}
    assert refusal(lambda: read_entity(attribute, TERMS)) in {None, 400, 422}


@given(ATTRIBUTES, ATTRIBUTES)
def test_any_change(first: Any, second: Any) -> None:
    def change() -> None:
        before = created(read_change({"id": "urn:x:1", "type": "Task", "a": first}, TERMS), AT, 1)
        for document in ({"a": second}, completed({"a": second}, before, TERMS, "fi")):
            wanted = read_change(document, TERMS)
            for after in (appended(before, wanted, AT).entity, merged(before, wanted, AT, AT).entity):
                for form in Form:
                    assert render(after, TERMS, View(form, sys_attrs=True, languages=("fi",)))

    assert refusal(change) in {None, 400}

    def merge_simplified() -> None:
        before = created(read_change({"id": "urn:x:1", "type": "Task", "a": first}, TERMS), AT, 1)
        wanted = read_change(normalized({"a": second}, before, TERMS), TERMS)
        after = merged(before, wanted, AT).entity
        for form in Form:
            assert render(after, TERMS, View(form, sys_attrs=True))

    assert refusal(merge_simplified) in {None, 400}


@given(WISHES, WISHES)
def test_any_subscription(first: Any, second: Any) -> None:
    base = {
        "id": "urn:x:1",
        "entities": [{"type": "Task"}],
        "notification": {"endpoint": {"uri": "http://127.0.0.1:9/"}},
        "context": HANDOVER_URL,
    }

    def keep_and_show(given_document: Any) -> None:
        document = updated_document(base, kept_document(given_document, CONTEXT))
        made = subscription({**document, "context": HANDOVER_URL}, CONTEXT)
        assert shown_document(made, CONTEXT, 0.0, sys_attrs=True)

    for given_document in (
        first,
        {"notification": first},
        {"notification": {"endpoint": first}},
        {"entities": [first], "q": second},
        {"notification": {"endpoint": {"uri": "http://a/", "accept": first, "receiverInfo": second}}},
    ):
        assert refusal(lambda sent=given_document: keep_and_show(sent)) in {None, 400, 422}
