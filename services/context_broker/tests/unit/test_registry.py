"""Matching of registrations, by table (clauses 4.3.6, 4.20 and 5.2.8 to 5.2.10)."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.contexts.context_resolver import CORE
from handover_broker.model.context import Context
from handover_broker.model.entity import Entity
from handover_broker.query.patterns import pattern
from handover_datamodels.contexts import TermMap
from handover_federation.registrations.registration import (
    EntityTarget,
    Mode,
    Registration,
    root_of,
    shown_document,
)
from handover_federation.registrations.registration_parser import kept_document, registration
from handover_federation.registrations.registry import Registry, claims

CONTEXT = Context(1, TermMap(None, lambda _: None), CORE, b"", CORE)
TASK, ROBOT = (CONTEXT.terms.expand(name) for name in ("Task", "Robot"))
SPEED, STATUS, PART_OF = (CONTEXT.terms.expand(name) for name in ("speed", "status", "isPartOf"))
ONE, TWO = "urn:ngsi-ld:Task:demo:1", "urn:ngsi-ld:Task:demo:2"


class NoDisk:
    """Ignores writes."""

    def submit(self, *_: Any) -> None: ...
    async def store(self, *_: Any) -> None: ...
    def store_later(self, *_: Any) -> None: ...


def registered(*information: dict[str, Any], **members: Any) -> Registration:
    number = members.pop("number", 1)
    document = {
        "type": "ContextSourceRegistration",
        "information": list(information),
        "endpoint": "http://127.0.0.1:9",
        **members,
    }
    kept = {**kept_document(document, CONTEXT), "id": f"urn:ngsi-ld:ContextSourceRegistration:{number}"}
    return registration(kept, CONTEXT)


def registry(*registrations: Registration) -> Registry:
    made = Registry("", NoDisk())
    for one in registrations:
        made.put(one)
    return made


TASKS = {"entities": [{"type": "Task"}]}
TASK_ONE = {"entities": [{"type": "Task", "id": ONE}]}
EVEN_TASKS = {"entities": [{"type": "Task", "idPattern": "[02468]$"}]}
SPEEDS = {"entities": [{"type": "Robot"}], "propertyNames": ["speed"]}
ANY_SPEED = {"propertyNames": ["speed"], "relationshipNames": ["isPartOf"]}


@pytest.mark.parametrize(
    ("piece", "target", "ids", "attributes"),
    [
        (TASKS, EntityTarget(types=frozenset({TASK})), None, None),
        (TASKS, EntityTarget(types=frozenset({TASK, ROBOT}), attributes=frozenset({SPEED})), None, {SPEED}),
        (TASKS, EntityTarget(ids=(ONE, TWO)), (ONE, TWO), None),
        (TASK_ONE, EntityTarget(ids=(ONE, TWO)), (ONE,), None),
        (TASK_ONE, EntityTarget(types=frozenset({TASK})), (ONE,), None),
        (TASK_ONE, EntityTarget(id_pattern=pattern("demo")), (ONE,), None),
        (EVEN_TASKS, EntityTarget(ids=(ONE, TWO), types=frozenset({TASK})), (TWO,), None),
        (EVEN_TASKS, EntityTarget(id_pattern=pattern("1$")), None, None),
        (SPEEDS, EntityTarget(attributes=frozenset({SPEED, STATUS})), None, {SPEED}),
        (SPEEDS, EntityTarget(), None, {SPEED}),
        (ANY_SPEED, EntityTarget(ids=(ONE,), types=frozenset({TASK})), (ONE,), {SPEED, PART_OF}),
        (ANY_SPEED, EntityTarget(), None, {SPEED, PART_OF}),
    ],
)
def test_a_match_is_the_intersection_of_registration_and_target(
    piece: dict[str, Any], target: EntityTarget, ids: tuple[str, ...] | None, attributes: set[str] | None
) -> None:
    (match,) = registry(registered(piece)).matching("queryEntity", target)
    assert match.ids == ids
    assert match.attributes == (None if attributes is None else frozenset(attributes))


@pytest.mark.parametrize(
    ("piece", "target"),
    [
        (TASKS, EntityTarget(types=frozenset({ROBOT}))),
        (TASK_ONE, EntityTarget(ids=(TWO,))),
        (TASK_ONE, EntityTarget(id_pattern=pattern("2$"))),
        (EVEN_TASKS, EntityTarget(ids=(ONE,))),
        (SPEEDS, EntityTarget(attributes=frozenset({STATUS}))),
        (ANY_SPEED, EntityTarget(types=frozenset({TASK}), attributes=frozenset({STATUS}))),
    ],
)
def test_a_registration_without_intersection_does_not_match(
    piece: dict[str, Any], target: EntityTarget
) -> None:
    assert registry(registered(piece)).matching("queryEntity", target) == []


@pytest.mark.parametrize(
    ("operations", "taken", "not_taken"),
    [
        (None, {"retrieveEntity", "queryBatch", "createSubscription"}, {"createEntity", "retrieveTemporal"}),
        (["updateOps"], {"updateEntity", "replaceAttrs"}, {"retrieveEntity", "createEntity"}),
        (["redirectionOps", "deleteBatch"], {"createEntity", "purgeEntity", "deleteBatch"}, {"queryBatch"}),
        (["retrieveOps"], {"retrieveEntity", "queryEntity"}, {"queryBatch", "updateEntity"}),
    ],
)
def test_groups_are_resolved_to_operations(
    operations: list[str] | None, taken: set[str], not_taken: set[str]
) -> None:
    one = registered(TASKS, **({} if operations is None else {"operations": operations}))
    assert all(one.takes(operation) for operation in taken)
    assert not any(one.takes(operation) for operation in not_taken)


def test_a_registration_with_an_interval_is_temporal_only() -> None:
    one = registered(TASKS, observationInterval={"startAt": "2024-01-01T00:00:00Z"})
    assert one.takes("queryTemporal")
    assert not one.takes("queryEntity")


def test_matches_are_ordered_by_mode() -> None:
    found = registry(
        registered(TASKS, number=1),
        registered(TASKS, number=2, mode="auxiliary"),
        registered(TASKS, number=3, mode="redirect"),
        registered({**TASK_ONE, "propertyNames": ["speed"]}, number=4, mode="exclusive"),
        registered(TASKS, number=5),
    ).matching("retrieveEntity", EntityTarget(ids=(ONE,)))
    assert [match.registration.id[-1] for match in found] == ["4", "3", "1", "5", "2"]


def test_attributes_are_matched_for_each_entity() -> None:
    (match,) = registry(
        registered(
            {**TASK_ONE, "propertyNames": ["speed"]},
            {"entities": [{"type": "Task", "id": TWO}], "propertyNames": ["status"]},
        )
    ).matching("queryEntity", EntityTarget(types=frozenset({TASK})))
    assert match.attributes_for(ONE) == frozenset({SPEED})
    assert match.attributes_for(TWO) == frozenset({STATUS})
    assert match.ids == (ONE, TWO)


def test_an_expired_registration_does_not_match() -> None:
    assert registry(registered(TASKS, expiresAt="2020-01-01T00:00:00Z")).matching("queryEntity") == []


def test_a_registry_is_empty_after_the_last_deletion() -> None:
    one = registered(TASKS)
    made = registry(one)
    seen: list[Any] = []
    made.watchers.append(lambda before, after: seen.append((before, after)))
    made.remove(one.id)
    assert made.is_empty
    assert made.matching("queryEntity") == []
    assert seen == [(one, None)]


ids = st.sampled_from([ONE, TWO, "urn:ngsi-ld:Task:demo:3"])
entity_infos = st.fixed_dictionaries(
    {"type": st.sampled_from(["Task", "Robot"])},
    optional={"id": ids, "idPattern": st.sampled_from(["1$", "[23]$"])},
)
pieces = st.fixed_dictionaries(
    {"entities": st.lists(entity_infos, min_size=1, max_size=3)},
    optional={"propertyNames": st.lists(st.sampled_from(["speed", "status"]), min_size=1, max_size=2)},
)
questions = st.builds(
    EntityTarget,
    ids=st.none() | st.lists(ids, min_size=1, max_size=2, unique=True).map(tuple),
    types=st.none() | st.sets(st.sampled_from([TASK, ROBOT]), min_size=1).map(frozenset),
    attributes=st.none() | st.sets(st.sampled_from([SPEED, STATUS]), min_size=1).map(frozenset),
)


@given(st.lists(st.lists(pieces, min_size=1, max_size=2), max_size=4), questions)
def test_the_index_agrees_with_a_linear_search(
    kept: list[list[dict[str, Any]]], target: EntityTarget
) -> None:
    all_of_them = [registered(*information, number=number) for number, information in enumerate(kept)]
    found = registry(*all_of_them).matching("queryEntity", target)
    assert [match.registration for match in found] == [one for one in all_of_them if one.parts(target)]


def test_an_exclusive_registration_conflicts_with_proxied_ones() -> None:
    held = {**TASK_ONE, "propertyNames": ["speed"]}
    made = registry(registered(held, mode="exclusive"))
    assert made.conflicting_with(registered(held, number=2, mode="exclusive")) is not None
    assert made.conflicting_with(registered(TASKS, number=2, mode="redirect")) is not None
    assert made.conflicting_with(registered(TASKS, number=2)) is None
    other = {**TASK_ONE, "propertyNames": ["status"]}
    assert made.conflicting_with(registered(other, number=2, mode="exclusive")) is None
    assert made.conflicting_with(registered(held, mode="exclusive")) is None, "itself, when it is changed"


def test_redirect_sources_may_overlap() -> None:
    made = registry(registered(TASKS, mode="redirect"))
    assert made.conflicting_with(registered(TASKS, number=2, mode="redirect")) is None


def test_a_claim_compares_types_and_attributes() -> None:
    entity = Entity(ONE, (TASK,), {SPEED: [{"type": "Property", "value": 1}]}, "", "")
    assert claims(registered(TASKS, mode="redirect"), entity)
    assert not claims(registered(SPEEDS, mode="redirect"), entity)
    assert not claims(registered({**TASKS, "propertyNames": ["status"]}, mode="redirect"), entity)


@pytest.mark.parametrize(
    "endpoint", ["http://a:1", "http://a:1/", "http://a:1/ngsi-ld/v1", "http://a:1/ngsi-ld/v1/"]
)
def test_endpoints_with_and_without_the_path_of_the_api_are_one(endpoint: str) -> None:
    assert registered(TASKS, endpoint=endpoint).url("entities") == "http://a:1/ngsi-ld/v1/entities"
    assert root_of(endpoint) == "http://a:1"


@pytest.mark.parametrize(
    ("members", "says"),
    [
        ({"information": None}, "information"),
        ({"information": [{"entities": []}]}, "entities"),
        ({"information": [{"entities": [{"id": ONE}]}]}, "type"),
        ({"information": [{"propertyNames": []}]}, "propertyNames"),
        ({"endpoint": None}, "endpoint"),
        ({"endpoint": "mqtt://a:1"}, "endpoint"),
        ({"mode": "shared"}, "mode"),
        ({"operations": ["fly"]}, "operations"),
        ({"operations": []}, "operations"),
        ({"mode": "auxiliary", "operations": ["updateEntity"]}, "auxiliary"),
        ({"mode": "exclusive"}, "exclusive"),
        ({"mode": "exclusive", "information": [{**EVEN_TASKS, "propertyNames": ["speed"]}]}, "exclusive"),
        ({"management": {"timeout": 0}}, "timeout"),
        ({"management": {"cacheDuration": "soon"}}, "cacheDuration"),
        ({"management": {"localOnly": "yes"}}, "localOnly"),
        ({"observationInterval": {"endAt": "2024-01-01T00:00:00Z"}}, "startAt"),
        ({"location": {"type": "Point", "coordinates": "here"}}, "location"),
        ({"contextSourceInfo": [{"key": "X Y", "value": "1"}]}, "contextSourceInfo"),
        ({"expiresAt": "tomorrow"}, "expiresAt"),
        ({"tenant": "a b"}, "tenant"),
    ],
)
def test_an_invalid_member_is_named_in_the_error(members: dict[str, Any], says: str) -> None:
    with pytest.raises(Problem, match=says) as caught:
        registered(**{"information": [TASKS], **members}) if "information" not in members else _raw(members)
    assert caught.value.status == 400


def _raw(members: dict[str, Any]) -> Registration:
    document = {"endpoint": "http://127.0.0.1:9", **members}
    return registration({**kept_document(document, CONTEXT), "id": "urn:x:1"}, CONTEXT)


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.text(max_size=6)
    | st.sampled_from(["urn:a:b", "PT1H", "2030-01-01T00:00:00Z", "http://a", "Task", "/A", "exclusive"]),
    lambda below: (
        st.lists(below, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                ["id", "type", "entities", "propertyNames", "key", "value", "startAt", "timeout"]
            ),
            below,
            max_size=3,
        )
    ),
    max_leaves=6,
)
members = st.sampled_from(
    ["information", "endpoint", "mode", "operations", "tenant", "scope", "location", "observationInterval",
     "management", "contextSourceInfo", "expiresAt", "refreshRate", "type", "own"]
)  # fmt: skip


@given(st.dictionaries(members, json_values, max_size=4))
def test_any_document_is_a_registration_or_a_problem(given_members: dict[str, Any]) -> None:
    document = {"information": [TASKS], "endpoint": "http://a", **given_members}
    try:
        kept = {name: value for name, value in kept_document(document, CONTEXT).items() if value is not None}
        one = registration({**kept, "id": "urn:x:1"}, CONTEXT)
    except Problem:
        return  # any other exception is a defect
    assert shown_document(one, CONTEXT, sys_attrs=True)["id"] == "urn:x:1"


def test_a_reader_gets_the_document_with_defaults() -> None:
    one = registered(SPEEDS, hall="second", management={"timeout": 250})
    shown = shown_document(one, CONTEXT, sys_attrs=False)
    assert shown["information"] == [SPEEDS]
    assert shown["hall"] == "second"
    assert (shown["mode"], shown["operations"]) == ("inclusive", ["federationOps"])
    assert one.management.timeout_s == 0.25
    assert one.mode is Mode.INCLUSIVE


def test_counts_report_the_last_attempt() -> None:
    one = registered(TASKS, management={"cooldown": 60_000})
    made = registry(one)
    assert "status" not in shown_document(one, CONTEXT, sys_attrs=False)
    made.record_attempt(one, succeeded=True)
    assert not made.is_cooling_down(one)
    made.record_attempt(one, succeeded=False)
    assert made.is_cooling_down(one)
    shown = shown_document(one, CONTEXT, sys_attrs=False)
    assert (shown["status"], shown["timesSent"], shown["timesFailed"]) == ("failed", 2, 1)
