"""Triggers: which changes concern which subscriptions, and what is notified of them."""

import asyncio
from dataclasses import replace
from typing import Any

import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.delivery.endpoint_queue import EndpointQueue, MemoryBudget, backoff_s
from handover_broker.delivery.notification import change_data
from handover_broker.delivery.subscription import Subscription, subscription
from handover_broker.delivery.subscription_documents import kept_document
from handover_broker.delivery.triggers import ALL, DEFAULT, Triggers, entity_change, read_kinds
from handover_broker.model.context import Context
from handover_broker.model.entity import NULL, Entity, Event
from handover_datamodels.contexts import HANDOVER_URL, TermMap

CONTEXT = Context(0, TermMap(HANDOVER_URL), HANDOVER_URL, b"", HANDOVER_URL)
AT, LATER = "2026-01-01T00:00:00.000000Z", "2026-01-02T00:00:00.000000Z"


def iri(name: str) -> str:
    return CONTEXT.terms.expand(name)


def instance(value: Any, dataset: str | None = None, kind: str = "Property", says: str = "value") -> Any:
    named = {} if dataset is None else {"datasetId": dataset}
    return {"type": kind, says: value, **named, "createdAt": AT, "modifiedAt": AT}


def entity(**attributes: Any) -> Entity:
    given = {
        iri(name): value if isinstance(value, list) else [instance(value)]
        for name, value in attributes.items()
    }
    return Entity("urn:ngsi-ld:Task:demo:1", (iri("Task"),), given, AT, AT)


def changed(before: Entity | None, after: Entity | None, *written: str) -> Event:
    return Event(before, after, frozenset(map(iri, written)))


CREATED = changed(None, entity(a=1, b=1), "a", "b")
DELETED = changed(entity(a=1, b=1), None)
UPDATED = changed(entity(a=1, b=1), entity(a=2, b=1), "a")
APPENDED = changed(entity(a=1), entity(a=1, b=1), "b")
ATTRIBUTE_GONE = changed(entity(a=1, b=1), entity(a=1))
RETYPED = changed(entity(a=1), entity(a=1))
SCOPED = changed(entity(a=1), replace(entity(a=1), scopes=("/hall",)))
RESCOPED = changed(replace(entity(a=1), scopes=("/hall",)), replace(entity(a=1), scopes=("/yard",)))
UNSCOPED = changed(replace(entity(a=1), scopes=("/hall",)), entity(a=1))
_KEPT = instance(1)
INSTANCE_GONE = changed(entity(a=[_KEPT, instance(2, "urn:x:d")]), entity(a=[_KEPT]), "a")
INSTANCE_ADDED = changed(entity(a=[_KEPT]), entity(a=[_KEPT, instance(2, "urn:x:d")]), "a")


@pytest.mark.parametrize(
    ("event", "kinds"),
    [
        (CREATED, {"entityCreated", "entityUpdated", "attributeCreated"}),
        (DELETED, {"entityDeleted", "entityUpdated", "attributeDeleted"}),
        (UPDATED, {"entityUpdated", "attributeUpdated"}),
        (APPENDED, {"entityUpdated", "attributeCreated"}),
        (ATTRIBUTE_GONE, {"entityUpdated", "attributeDeleted"}),
        (INSTANCE_GONE, {"entityUpdated", "attributeDeleted"}),
        (INSTANCE_ADDED, {"entityUpdated", "attributeUpdated"}),
        (RETYPED, set()),
        (SCOPED, {"entityUpdated", "attributeCreated"}),
        (RESCOPED, {"entityUpdated", "attributeUpdated"}),
        (UNSCOPED, {"entityUpdated", "attributeDeleted"}),
    ],
)
def test_each_kind_of_change_has_its_triggers(event: Event, kinds: set[str]) -> None:
    matched = {kind for kind in ALL if Triggers(read_kinds([kind])).match(entity_change(event))}
    assert matched == kinds


def test_without_triggers_attributes_that_are_made_or_changed_count() -> None:
    assert read_kinds(None) is DEFAULT
    assert read_kinds(["attributeUpdated", "attributeCreated"]) is DEFAULT
    matched = [
        Triggers().match(entity_change(event))
        for event in (CREATED, UPDATED, APPENDED, ATTRIBUTE_GONE, DELETED)
    ]
    assert matched == [True, True, True, False, False]


@pytest.mark.parametrize("kinds", [None, ["entityUpdated"], list(ALL)])
def test_only_watched_attributes_count(kinds: list[str] | None) -> None:
    watching = {name: Triggers(read_kinds(kinds), frozenset({iri(name)})) for name in ("a", "b", "c")}
    assert watching["a"].match(entity_change(UPDATED))
    assert not watching["b"].match(entity_change(UPDATED))
    assert watching["b"].match(entity_change(CREATED))
    assert not watching["c"].match(entity_change(CREATED))
    assert not watching["c"].match(entity_change(DELETED))


def test_scopes_are_watched_by_their_name() -> None:
    watching = subscribed(watchedAttributes=["scope"]).triggers
    assert watching.match(entity_change(SCOPED))
    assert not watching.match(entity_change(UPDATED))
    assert not subscribed(watchedAttributes=["a"]).triggers.match(entity_change(RESCOPED))


@pytest.mark.parametrize("form", ["normalized", "concise"])
@pytest.mark.parametrize("shows", [True, False])
def test_scopes_are_notified_and_their_deletion_is_null(form: str, shows: bool) -> None:
    members = {"notificationTrigger": ["entityUpdated"]}
    wanted = {"format": form, "showChanges": shows}
    assert returned(RESCOPED, notification=wanted, **members)["scope"] == "/yard"
    assert returned(UNSCOPED, notification=wanted, **members)["scope"] == NULL
    assert "scope" not in returned(UNSCOPED, notification={**wanted, "pick": ["a"]}, **members)


@pytest.mark.parametrize("given", [[], "entityCreated", ["created"], [4], [["entityCreated"]], {}])
def test_other_triggers_are_refused(given: Any) -> None:
    with pytest.raises(Problem, match="notificationTrigger"):
        read_kinds(given)


def subscribed(**members: Any) -> Subscription:
    notification = {"endpoint": {"uri": "http://127.0.0.1/"}, **members.pop("notification", {})}
    given = {"id": "urn:x:s", "entities": [{"type": "Task"}], "notification": notification, **members}
    return subscription({**kept_document(given, CONTEXT), "context": HANDOVER_URL}, CONTEXT)


def returned(event: Event, **members: Any) -> Any:
    return orjson.loads(change_data(subscribed(**members), entity_change(event)))


def test_a_deleted_entity_is_notified_by_deleted_at() -> None:
    said = returned(DELETED, notificationTrigger=["entityDeleted"])
    assert list(said) == ["id", "type", "deletedAt"]


def test_watched_attributes_of_a_deleted_entity_are_listed() -> None:
    members = {"notificationTrigger": ["attributeDeleted"], "watchedAttributes": ["a"]}
    said = returned(DELETED, **members)
    assert {name: said[name] for name in said if name not in {"id", "type", "deletedAt"}} == {
        "a": {"type": "Property", "value": NULL}
    }
    with_times = returned(DELETED, notification={"sysAttrs": True}, **members)["a"]
    assert with_times["createdAt"] == AT
    assert set(with_times) == {"type", "value", "createdAt", "modifiedAt", "deletedAt"}


def test_existing_values_are_notified_with_show_changes() -> None:
    changes = {"notification": {"showChanges": True}}
    assert returned(UPDATED, **changes)["a"] == {"type": "Property", "value": 2, "previousValue": 1}
    assert returned(UPDATED, **changes)["b"] == {"type": "Property", "value": 1}
    assert returned(CREATED, **changes)["a"] == {"type": "Property", "value": 1}
    gone = returned(DELETED, notificationTrigger=["entityDeleted"], **changes)
    assert gone["a"] == {"type": "Property", "value": NULL, "previousValue": 1}


@pytest.mark.parametrize(
    ("form", "gone"),
    [
        ("normalized", {"type": "Property", "value": NULL}),
        ("concise", NULL),
        ("keyValues", NULL),
    ],
)
def test_a_deleted_attribute_is_null_in_every_form(form: str, gone: Any) -> None:
    said = returned(ATTRIBUTE_GONE, notificationTrigger=["attributeDeleted"], notification={"format": form})
    assert said["b"] == gone
    assert "a" in said


def test_a_deleted_instance_is_notified_beside_those_that_stay() -> None:
    said = returned(INSTANCE_GONE, notificationTrigger=["attributeDeleted"])
    assert said["a"] == [
        {"type": "Property", "value": 1},
        {"type": "Property", "value": NULL, "datasetId": "urn:x:d"},
    ]
    plain = returned(
        INSTANCE_GONE, notificationTrigger=["attributeDeleted"], notification={"format": "keyValues"}
    )
    assert plain["a"] == {"dataset": {"@none": 1, "urn:x:d": NULL}}


@pytest.mark.parametrize(
    ("kind", "says", "value", "previous", "null"),
    [
        ("Relationship", "object", "urn:x:1", "previousObject", NULL),
        ("LanguageProperty", "languageMap", {"en": "x"}, "previousLanguageMap", {"@none": NULL}),
        ("VocabProperty", "vocab", "urn:x:word", "previousVocab", NULL),
        ("JsonProperty", "json", {"x": None}, "previousJson", NULL),
        ("ListProperty", "valueList", [1, 2], "previousValueList", NULL),
        ("ListRelationship", "objectList", [{"object": "urn:x:1"}], "previousObjectList", NULL),
    ],
)
def test_every_kind_of_attribute_has_its_null_and_its_previous(
    kind: str, says: str, value: Any, previous: str, null: Any
) -> None:
    event = changed(entity(a=[instance(value, kind=kind, says=says)], b=1), entity(b=1))
    for form in ("normalized", "concise"):
        view = {"showChanges": True, "format": form}
        said = returned(event, notificationTrigger=["attributeDeleted"], notification=view)["a"]
        assert {name: said[name] for name in (says, previous)} == {says: null, previous: value}
    simple = returned(event, notificationTrigger=["attributeDeleted"], notification={"format": "keyValues"})
    assert simple["a"] == NULL


INSTANCES = {
    "Property": ("value", st.integers(-(2**63), 2**63 - 1) | st.text(max_size=3) | st.just({"x": [1]})),
    "Relationship": ("object", st.sampled_from(["urn:x:1", ["urn:x:1", "urn:x:2"]])),
    "LanguageProperty": ("languageMap", st.just({"en": "x", "fr": ["y"]})),
    "VocabProperty": ("vocab", st.sampled_from(["urn:x:w", ["urn:x:w"]])),
    "JsonProperty": ("json", st.none() | st.just({"x": 1})),
    "ListProperty": ("valueList", st.just([1, "x"])),
    "ListRelationship": ("objectList", st.just([{"object": "urn:x:1"}])),
    "GeoProperty": ("value", st.just({"type": "Point", "coordinates": [8, 40]})),
}


@st.composite
def attributes(draw: st.DrawFn) -> dict[str, Any]:
    """Attributes of an entity, some with several instances."""
    result: dict[str, Any] = {}
    for name in draw(st.sets(st.sampled_from("abc"))):
        datasets = draw(st.sets(st.sampled_from([None, "urn:x:d", "urn:x:e"]), min_size=1))
        kind = draw(st.sampled_from(list(INSTANCES)))
        says, values = INSTANCES[kind]
        result[name] = [instance(draw(values), dataset, kind, says) for dataset in datasets]
    return result


@st.composite
def events(draw: st.DrawFn) -> Event:
    """A change, creation or deletion of an entity."""
    before, after = draw(attributes()), draw(attributes())
    which = draw(st.sampled_from(["begins", "changes", "ends"]))
    return changed(
        None if which == "begins" else entity(**before),
        None if which == "ends" else entity(**after),
        *(() if which == "ends" else after),
    )


@given(events(), st.sets(st.sampled_from(ALL), min_size=1), st.sets(st.sampled_from(ALL), min_size=1))
def test_several_triggers_match_what_any_of_them_matches(
    event: Event, some: set[str], more: set[str]
) -> None:
    change = entity_change(event)
    matched = [Triggers(read_kinds(list(kinds))).match(change) for kinds in (some | more, some, more)]
    assert matched[0] is (matched[1] or matched[2])


VIEWS = st.fixed_dictionaries(
    {
        "format": st.sampled_from(["normalized", "concise", "keyValues"]),
        "sysAttrs": st.booleans(),
        "endpoint": st.sampled_from(["application/json", "application/geo+json"]).map(
            lambda accept: {"uri": "http://127.0.0.1/", "accept": accept}
        ),
    },
    optional={
        "showChanges": st.just(True),
        "pick": st.just(["id", "a"]),
        "omit": st.just(["b", "deletedAt"]),
        "join": st.sampled_from(["inline", "flat"]),
    },
).filter(lambda view: view["format"] != "keyValues" or "showChanges" not in view)
LIMITS = st.sampled_from([{}, {"lang": "fr"}, {"datasetId": "urn:x:d"}, {"watchedAttributes": ["a", "b"]}])


@settings(deadline=None)
@given(events(), st.sets(st.sampled_from(ALL), min_size=1), VIEWS, LIMITS)
def test_any_change_can_be_notified_in_any_form(
    event: Event, kinds: set[str], view: dict[str, Any], limits: dict[str, Any]
) -> None:
    said = returned(event, notificationTrigger=list(kinds), notification=view, **limits)
    assert said["id"] == "urn:ngsi-ld:Task:demo:1"
    assert ("createdAt" in str(said)) <= view["sysAttrs"]
    assert ("previous" in str(said)) <= ("showChanges" in view)


class Somebody:
    """A worker that waits to send."""

    pending_bytes = held = on_disk = throttled = 0

    def __init__(self) -> None:
        self.was_woken = asyncio.Event()

    def wake(self) -> None:
        self.was_woken.set()


async def test_while_a_line_fails_one_at_a_time_has_its_turn() -> None:
    line, crowd = EndpointQueue(MemoryBudget(), 1000), [Somebody() for _ in range(3)]
    assert [line.wait_s(one) for one in crowd] == [0.0, 0.0, 0.0]
    line.failed(crowd[0], 0.0, 0.0)
    assert line.failures == 1
    waits = [line.wait_s(one) for one in crowd]
    assert waits[0] is not None
    assert waits[1:] == [None, None]
    line.failed(crowd[0], float("inf"), 5.0)
    assert crowd[1].was_woken.is_set()
    wait_s = line.wait_s(crowd[1])
    assert wait_s is not None
    assert 4.0 < wait_s <= 6.0
    assert line.wait_s(crowd[0]) is None
    line.succeeded()
    assert all(one.was_woken.is_set() for one in (crowd[0], crowd[2]))
    assert [line.wait_s(one) for one in crowd] == [0.0, 0.0, 0.0]


def test_attempts_that_failed_together_count_once_and_rests_grow_to_a_bound() -> None:
    line, crowd = EndpointQueue(MemoryBudget(), 1000), [Somebody() for _ in range(50)]
    for one in crowd:
        line.failed(one, 0.0, 0.0)
    assert line.failures == 1
    assert backoff_s(1) < 0.2 < backoff_s(4) < 1.2
    assert backoff_s(1000) <= 18
