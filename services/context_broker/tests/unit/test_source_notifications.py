"""Notifications of sources: current, previous and deleted values, and invalid input."""

from typing import Any

import pytest
from hypothesis import given

from handover.errors import Problem
from handover_broker.delivery.notification import change_data
from handover_broker.delivery.subscription import subscription
from handover_broker.model.entity import Entity
from handover_federation.distribution.subscriptions.source_notifications import change_of_notification
from services.context_broker.tests.unit.test_fragments import ANYTHING
from services.context_broker.tests.unit.test_registry import CONTEXT, TASKS, registered

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


def read_change(own: Entity | None = None, **attributes: Any) -> Any:
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
def test_previous_values_are_separated_from_current_ones(said: dict[str, Any], value: Any, was: Any) -> None:
    change = read_change(a=said)
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
def test_deleted_attributes_are_reported(said: Any) -> None:
    change = read_change(a=said, b=2)
    assert change.lost == {EXPAND("a")}
    assert NULL not in str(change.after.attributes)
    assert NULL.encode() in change_data(LISTENER, change)


def test_own_instances_are_not_deleted_with_the_source() -> None:
    own = Entity("urn:x:1", (EXPAND("Task"),), {EXPAND("a"): [{"type": "Property", "value": 1}]}, "", "")
    change = read_change(own, a=NULL)
    assert change.lost == set()
    assert change.after.attributes[EXPAND("a")] == own.attributes[EXPAND("a")]


def test_a_deleted_entity_is_reported_with_its_deleted_attributes() -> None:
    change = read_change(deletedAt="2026-01-01T00:00:00Z", a={"value": NULL, "previousValue": 3})
    assert change.after is None
    assert b'"previousValue":3' in change_data(LISTENER, change)
    assert read_change(deletedAt="2026-01-01T00:00:00Z").lost == set()


@given(ANYTHING, ANYTHING)
def test_any_notification_is_a_change_or_a_problem(said: Any, other: Any) -> None:
    try:
        change = read_change(a=said, b=other)
    except Problem:
        return
    assert change_data(LISTENER, change).startswith(b'{"id":"urn:x:1"')
