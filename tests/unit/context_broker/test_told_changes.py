"""What sources tell of changes: as it is, was, and no longer is; whatever they say does no harm."""

from typing import Any

import pytest
from hypothesis import given

from handover.errors import Problem
from services.context_broker.delivery.notification import change_data
from services.context_broker.delivery.subscription import subscription
from services.context_broker.federation.distribution.source_notifications import change_of_notification
from services.context_broker.model.entity import Entity
from tests.unit.context_broker.test_fragments import ANYTHING
from tests.unit.context_broker.test_registry import CONTEXT, TASKS, registered

EXPAND = CONTEXT.terms.expand
NULL = "urn:ngsi-ld:null"
LISTENER = subscription(
    {
        "id": "urn:x:s",
        "entities": [{"type": EXPAND("Task")}],
        "notificationTrigger": ["attributeUpdated", "attributeDeleted", "entityDeleted"],
        "notification": {"endpoint": {"uri": "http://127.0.0.1:9"}, "showChanges": True},
    },
    CONTEXT,
)


def told(own: Entity | None = None, **attributes: Any) -> Any:
    document = {"id": "urn:x:1", "type": "Task", **attributes}
    return change_of_notification(document, registered(TASKS), own, CONTEXT.terms)


@pytest.mark.parametrize(
    ("said", "value", "was"),
    [
        ({"type": "Property", "value": 5, "previousValue": 1}, 5, 1),
        ({"value": 5, "previousValue": 1}, 5, 1),
        ({"type": "Relationship", "object": "urn:x:b", "previousObject": "urn:x:a"}, "urn:x:b", "urn:x:a"),
        ({"languageMap": {"en": "b"}, "previousLanguageMap": {"en": "a"}}, {"en": "b"}, {"en": "a"}),
    ],
)
def test_what_was_before_is_told_apart_from_what_is(said: dict[str, Any], value: Any, was: Any) -> None:
    change = told(a=said)
    name = EXPAND("a")
    (before,), (after,) = change.before.attributes[name], change.after.attributes[name]
    assert was in before.values()
    assert value in after.values()
    assert was not in after.values()
    assert change.updated == {name}


@pytest.mark.parametrize(
    "said",
    [
        NULL,
        {"type": "Property", "value": NULL, "deletedAt": "2026-01-01T00:00:00Z"},
        {"type": "Relationship", "object": NULL},
        {"type": "LanguageProperty", "languageMap": {"@none": NULL}},
        [{"value": 1}, {"value": NULL, "datasetId": "urn:x:d", "previousValue": 3}],
    ],
)
def test_what_is_gone_is_told_as_gone(said: Any) -> None:
    change = told(a=said, b=2)
    assert change.lost == {EXPAND("a")}
    assert NULL not in str(change.after.attributes)
    assert NULL.encode() in change_data(LISTENER, change)


def test_what_the_broker_has_itself_is_not_gone() -> None:
    own = Entity("urn:x:1", (EXPAND("Task"),), {EXPAND("a"): [{"type": "Property", "value": 1}]}, "", "")
    change = told(own, a=NULL)
    assert change.lost == set()
    assert change.after.attributes[EXPAND("a")] == own.attributes[EXPAND("a")]


def test_the_end_of_an_entity_is_told_with_what_it_has_lost() -> None:
    change = told(deletedAt="2026-01-01T00:00:00Z", a={"value": NULL, "previousValue": 3})
    assert change.after is None
    assert b'"previousValue":3' in change_data(LISTENER, change)
    assert told(deletedAt="2026-01-01T00:00:00Z").lost == set()


@given(ANYTHING, ANYTHING)
def test_whatever_a_source_tells_can_be_told_on_or_is_a_problem(said: Any, other: Any) -> None:
    try:
        change = told(a=said, b=other)
    except Problem:
        return
    assert change_data(LISTENER, change).startswith(b'{"id":"urn:x:1"')
