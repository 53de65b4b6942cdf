"""Entities written at several brokers: every operation in every mode, and failures."""

from collections.abc import Callable
from typing import Any
from uuid import uuid4

import httpx
import pytest

from tests.kit.context_sources import ScriptedSource, put, register, values

DEFAULT = "https://uri.etsi.org/ngsi-ld/default-context/"
EXCLUSIVE = {"b": 1, "c": 1}
BOTH = {"a": 1, "b": 1, "c": 1}
Act = Callable[[httpx.Client, str, str], httpx.Response]
Values = dict[str, int] | None


def create(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.post("/entities", json={"id": entity_id, "type": kind, "a": 2, "b": 2})


def replace(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.put(f"/entities/{entity_id}", json={"id": entity_id, "type": kind, "a": 2, "b": 2})


def merge(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.patch(f"/entities/{entity_id}", json={"a": 2, "b": 2})


def append(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.post(f"/entities/{entity_id}/attrs", json={"a": 2, "b": 2})


def update(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.patch(f"/entities/{entity_id}/attrs", json={"a": 2, "b": 2})


def update_one(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.patch(f"/entities/{entity_id}/attrs/b", json={"value": 2})


def replace_one(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.put(f"/entities/{entity_id}/attrs/b", json={"type": "Property", "value": 2})


def delete_one(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.delete(f"/entities/{entity_id}/attrs/b")


def delete(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.delete(f"/entities/{entity_id}")


def create_batch(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.post("/entityOperations/create", json=[{"id": entity_id, "type": kind, "a": 2, "b": 2}])


def upsert_batch(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.post("/entityOperations/upsert", json=[{"id": entity_id, "type": kind, "a": 2, "b": 2}])


def update_batch(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.post("/entityOperations/update", json=[{"id": entity_id, "type": kind, "a": 2, "b": 2}])


def merge_batch(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.post("/entityOperations/merge", json=[{"id": entity_id, "type": kind, "a": 2, "b": 2}])


def delete_batch(client: httpx.Client, entity_id: str, kind: str) -> httpx.Response:
    return client.post("/entityOperations/delete", json=[entity_id])


TABLE: list[tuple[Act, str, int, Values, Values]] = [
    # operation, mode, status, then the values here and there; before, a, b and c are 1
    # where the mode allows them: a here, b and c there (exclusive); there only (redirect); in both
    (create, "exclusive", 201, {"a": 2}, {"b": 2}),
    (create, "redirect", 201, None, {"a": 2, "b": 2}),
    (create, "inclusive", 201, {"a": 2, "b": 2}, {"a": 2, "b": 2}),
    (create, "auxiliary", 201, {"a": 2, "b": 2}, None),
    (replace, "exclusive", 204, {"a": 2}, {"b": 2}),
    (replace, "redirect", 204, None, {"a": 2, "b": 2}),
    (replace, "inclusive", 204, {"a": 2, "b": 2}, {"a": 2, "b": 2}),
    (replace, "auxiliary", 204, {"a": 2, "b": 2}, BOTH),
    (merge, "exclusive", 204, {"a": 2}, {"b": 2, "c": 1}),
    (merge, "redirect", 204, None, {"a": 2, "b": 2, "c": 1}),
    (merge, "inclusive", 204, {"a": 2, "b": 2, "c": 1}, {"a": 2, "b": 2, "c": 1}),
    (merge, "auxiliary", 204, {"a": 2, "b": 2, "c": 1}, BOTH),
    (append, "exclusive", 204, {"a": 2}, {"b": 2, "c": 1}),
    (append, "redirect", 204, None, {"a": 2, "b": 2, "c": 1}),
    (append, "inclusive", 204, {"a": 2, "b": 2, "c": 1}, {"a": 2, "b": 2, "c": 1}),
    (append, "auxiliary", 204, {"a": 2, "b": 2, "c": 1}, BOTH),
    (update, "exclusive", 204, {"a": 2}, {"b": 2, "c": 1}),
    (update, "redirect", 204, None, {"a": 2, "b": 2, "c": 1}),
    (update, "inclusive", 204, {"a": 2, "b": 2, "c": 1}, {"a": 2, "b": 2, "c": 1}),
    (update, "auxiliary", 204, {"a": 2, "b": 2, "c": 1}, BOTH),
    *(
        (one, mode, 204, here, there)
        for one in (update_one, replace_one)
        for mode, here, there in (
            ("exclusive", {"a": 1}, {"b": 2, "c": 1}),
            ("redirect", None, {"a": 1, "b": 2, "c": 1}),
            ("inclusive", {"a": 1, "b": 2, "c": 1}, {"a": 1, "b": 2, "c": 1}),
            ("auxiliary", {"a": 1, "b": 2, "c": 1}, BOTH),
        )
    ),
    (delete_one, "exclusive", 204, {"a": 1}, {"c": 1}),
    (delete_one, "redirect", 204, None, {"a": 1, "c": 1}),
    (delete_one, "inclusive", 204, {"a": 1, "c": 1}, {"a": 1, "c": 1}),
    (delete_one, "auxiliary", 204, {"a": 1, "c": 1}, BOTH),
    (delete, "exclusive", 204, None, None),
    (delete, "redirect", 204, None, None),
    (delete, "inclusive", 204, None, None),
    (delete, "auxiliary", 204, None, BOTH),
]


BATCHES: list[tuple[Act, str, int, Values, Values]] = [
    *(
        (many, mode, 201 if many is create_batch else status, here, there)
        for many, single in (
            (create_batch, create),
            (upsert_batch, replace),
            (update_batch, append),
            (merge_batch, merge),
            (delete_batch, delete),
        )
        for one, mode, status, here, there in TABLE
        if one is single
    )
]
ALL_TAKE = ["redirectionOps", "createBatch", "upsertBatch", "updateBatch", "mergeBatch", "deleteBatch"]


@pytest.mark.nightly
@pytest.mark.parametrize("takes", [ALL_TAKE, ["redirectionOps"]], ids=["at once", "one by one"])
@pytest.mark.parametrize("case", BATCHES, ids=lambda case: f"{case[0].__name__}-{case[1]}")
def test_a_batch_is_routed_entity_by_entity(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], case: tuple[Any, ...], takes: list[str]
) -> None:
    act, mode, status, here, there = case
    kind = f"Kind{uuid4().hex}"
    entity_id = f"urn:ngsi-ld:{kind}:1"
    arrange(near, far, entity_id, kind, mode, is_new="create" in act.__name__)
    info = {"type": kind, "id": entity_id} if mode == "exclusive" else {"type": kind}
    names = ["b", "c"] if mode == "exclusive" else None
    operations = ["retrieveOps"] if mode == "auxiliary" else takes
    register(near, brokers[1].url, info, names, mode=mode, operations=operations)
    answer = act(near, entity_id, kind)
    assert answer.status_code == status, answer.text
    assert held(near, entity_id) == here
    assert held(far, entity_id) == there


def test_a_batch_is_forwarded_as_a_batch_with_its_failures(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, mode="redirect", operations=["createBatch"])
    ids = [f"urn:ngsi-ld:{kind}:{number}" for number in range(3)]
    source.answers["POST", "/ngsi-ld/v1/entityOperations/create"] = (
        207,
        {
            "success": ids[:2],
            "errors": [{"entityId": ids[2], "error": {"title": "Already exists", "status": 409}}],
        },
    )
    entities = [{"id": one, "type": kind, "a": 1} for one in ids]
    answer = near.post("/entityOperations/create", json=[*entities, {"id": "urn:x:own", "type": "Bad Type"}])
    assert answer.status_code == 207
    assert answer.json()["success"] == ids[:2]
    assert [one["entityId"] for one in answer.json()["errors"]] == [ids[2], "urn:x:own"]
    assert len(source.asked) == 1
    assert source.asked[0][4] == entities


@pytest.mark.nightly
@pytest.mark.parametrize("case", TABLE, ids=lambda case: f"{case[0].__name__}-{case[1]}")
def test_a_write_is_routed_to_the_sources_of_its_attributes(
    near: httpx.Client,
    far: httpx.Client,
    brokers: list[Any],
    kind: str,
    case: tuple[Act, str, int, Values, Values],
) -> None:
    act, mode, status, here, there = case
    entity_id = f"urn:ngsi-ld:{kind}:1"
    arrange(near, far, entity_id, kind, mode, is_new="create" in act.__name__)
    info = {"type": kind, "id": entity_id} if mode == "exclusive" else {"type": kind}
    register(near, brokers[1].url, info, ["b", "c"] if mode == "exclusive" else None, mode=mode)
    answer = act(near, entity_id, kind)
    assert answer.status_code == status, answer.text
    assert held(near, entity_id) == here
    assert held(far, entity_id) == there


def arrange(
    near: httpx.Client, far: httpx.Client, entity_id: str, kind: str, mode: str, *, is_new: bool
) -> None:
    if is_new:
        return
    if mode == "exclusive":
        put(near, entity_id, kind, a=1)
        put(far, entity_id, kind, **EXCLUSIVE)
        return
    put(far, entity_id, kind, **BOTH)
    if mode != "redirect":
        put(near, entity_id, kind, **BOTH)


def held(client: httpx.Client, entity_id: str) -> Values:
    """Return the values of one broker only, None if it does not have the entity."""
    answer = client.get(f"/entities/{entity_id}?local=true")
    return None if answer.status_code == 404 else values(answer)


def test_an_operation_that_an_exclusive_source_does_not_take_is_a_conflict(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, mode="redirect", operations=["retrieveOps"])
    answer = create(near, f"urn:ngsi-ld:{kind}:1", kind)
    assert answer.status_code == 409
    assert answer.json()["type"].endswith("/Conflict")
    assert source.asked == []
    assert held(near, f"urn:ngsi-ld:{kind}:1") is None


def test_an_inclusive_source_without_the_operation_is_skipped(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, operations=["retrieveOps"])
    assert create(near, f"urn:ngsi-ld:{kind}:1", kind).status_code == 201
    assert source.asked == []


@pytest.mark.parametrize(("reply", "status"), [(500, 502), (403, 502), (404, 404), (409, 409), (508, 508)])
def test_the_failure_of_the_only_routed_source_is_returned(
    near: httpx.Client, source: ScriptedSource, kind: str, reply: int, status: int
) -> None:
    register(near, source.url, {"type": kind}, mode="redirect")
    source.answers["DELETE", f"/ngsi-ld/v1/entities/urn:ngsi-ld:{kind}:1"] = reply, {}
    assert delete(near, f"urn:ngsi-ld:{kind}:1", kind).status_code == status


def test_the_timeout_of_the_only_routed_source_is_returned(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, mode="redirect", management={"timeout": 100})
    source.go_on.clear()
    assert merge(near, f"urn:ngsi-ld:{kind}:1", kind).status_code == 504


@pytest.mark.parametrize(("cooldown", "status"), [(None, 204), (60_000, 207)])
def test_a_timeout_starts_a_cooldown_only_if_registered(
    near: httpx.Client, source: ScriptedSource, kind: str, cooldown: int | None, status: int
) -> None:
    management = {"timeout": 300} if cooldown is None else {"timeout": 300, "cooldown": cooldown}
    register(near, source.url, {"type": kind}, management=management)
    entity_id = put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    path = f"/ngsi-ld/v1/entities/{entity_id}/attrs"
    source.answers["PATCH", path] = 204, None
    source.go_on.clear()
    assert near.get(f"/entities/{entity_id}").headers["ngsild-warning"].startswith("199")
    source.go_on.set()
    answer = near.patch(f"/entities/{entity_id}/attrs", json={"a": 2})
    assert answer.status_code == status, answer.text
    assert any(one[:2] == ("PATCH", path) for one in source.asked) is (cooldown is None)


def test_one_request_waits_once_for_a_hanging_source(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    management = {"timeout": 300}
    register(near, source.url, {"type": kind}, operations=["deleteEntity"], management=management)
    ids = [put(near, f"urn:ngsi-ld:{kind}:{number}", kind) for number in range(100)]
    source.go_on.clear()
    answer = near.post("/entityOperations/delete", json=ids)
    assert answer.status_code == 207
    assert {one["entityId"] for one in answer.json()["errors"]} == set(ids)
    assert len(source.asked) < len(ids)


def test_a_failed_part_is_reported(near: httpx.Client, source: ScriptedSource, kind: str) -> None:
    entity_id = put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    path = register(near, source.url, {"type": kind, "id": entity_id}, ["b"], mode="exclusive")
    source.answers["PATCH", f"/ngsi-ld/v1/entities/{entity_id}/attrs"] = 500, {}
    source.answers["PATCH", f"/ngsi-ld/v1/entities/{entity_id}"] = 500, {}
    answer = update(near, entity_id, kind)
    assert answer.status_code == 207
    assert answer.json()["updated"] == [DEFAULT + "a"]
    (left,) = answer.json()["notUpdated"]
    assert left["attributeName"] == DEFAULT + "b"
    assert path.endswith(left["registrationId"])
    answer = merge(near, entity_id, kind)
    assert answer.status_code == 207
    assert answer.json()["success"] == [entity_id]
    assert answer.json()["errors"][0]["error"]["status"] == 500
    assert held(near, entity_id) == {"a": 2}


UPDATED = {"updated": ["a", "b"], "notUpdated": []}
IN_PART = {"updated": ["b"], "notUpdated": [{"attributeName": "a", "reason": "it has no a"}]}
FAILED_IN_PART = {
    "updated": [DEFAULT + "b"],
    "notUpdated": [{"attributeName": DEFAULT + "a", "reason": "away", "registrationId": "urn:far"}],
}


@pytest.mark.parametrize(
    ("act", "said", "left"),
    [
        (update, UPDATED, None),
        (update, IN_PART, None),
        (update, FAILED_IN_PART, ["a"]),
        (append, IN_PART, None),
        (append, {"updated": []}, ["a", "b"]),
        (append, {"unknown": 1}, ["a", "b"]),
    ],
)
def test_what_a_source_changed_in_part_is_changed(  # noqa: PLR0917 - fixtures and a table
    near: httpx.Client,
    source: ScriptedSource,
    kind: str,
    act: Act,
    said: dict[str, Any],
    left: list[str] | None,
) -> None:
    """Of inclusive sources: what one lacks and another part has changed is changed."""
    entity_id = put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1, b=1)
    register(near, source.url, {"type": kind})
    for method in ("POST", "PATCH"):
        source.answers[method, f"/ngsi-ld/v1/entities/{entity_id}/attrs"] = 207, said
    answer = act(near, entity_id, kind)
    if left is None:
        assert answer.status_code == 204, answer.text
        return
    assert answer.status_code == 207, answer.text
    assert answer.json()["updated"] == [DEFAULT + "a", DEFAULT + "b"]
    assert [one["attributeName"] for one in answer.json()["notUpdated"]] == [DEFAULT + name for name in left]


def test_what_the_only_source_changed_in_part_is_reported_by_attribute(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    entity_id = f"urn:ngsi-ld:{kind}:1"
    path = register(near, source.url, {"type": kind}, mode="redirect")
    there = f"/ngsi-ld/v1/entities/{entity_id}/attrs"
    source.answers["PATCH", there] = 207, IN_PART
    result = update(near, entity_id, kind)
    assert result.status_code == 207, result.text
    assert result.json()["updated"] == [DEFAULT + "b"]
    (left,) = result.json()["notUpdated"]
    assert left["attributeName"] == DEFAULT + "a"
    assert "it has no a" in left["reason"]
    assert path.endswith(left["registrationId"])
    source.answers["PATCH", there] = 207, {"updated": [], "notUpdated": IN_PART["notUpdated"]}
    nothing = near.patch(f"/entities/{entity_id}/attrs", json={"a": 2})
    assert (nothing.status_code, nothing.json()["updated"]) == (207, [])


def test_two_sources_that_each_have_a_part_change_the_whole(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    entity_id = f"urn:ngsi-ld:{kind}:1"
    other = ScriptedSource()
    try:
        for one, done, lacked in ((source, "a", "b"), (other, "b", "a")):
            register(near, one.url, {"type": kind})
            said = {"updated": [done], "notUpdated": [{"attributeName": lacked, "reason": "not here"}]}
            one.answers["PATCH", f"/ngsi-ld/v1/entities/{entity_id}/attrs"] = 207, said
        assert update(near, entity_id, kind).status_code == 204
    finally:
        other.stop()


@pytest.mark.parametrize("act", [create, merge, replace, upsert_batch, update_batch, merge_batch])
def test_an_entity_that_a_source_wrote_in_part_is_listed_as_success_and_error(
    near: httpx.Client, source: ScriptedSource, kind: str, act: Act
) -> None:
    entity_id = f"urn:ngsi-ld:{kind}:1"
    register(near, source.url, {"type": kind}, mode="redirect")
    error = {"title": "Gateway timeout", "status": 504, "detail": "its own source is away"}
    result = {"success": [entity_id], "errors": [{"entityId": entity_id, "error": error}]}
    for method in ("POST", "PATCH", "PUT"):
        source.answers[method, "/ngsi-ld/v1/entities"] = 207, result
        source.answers[method, f"/ngsi-ld/v1/entities/{entity_id}"] = 207, result
    source.answers["POST", f"/ngsi-ld/v1/entities/{entity_id}/attrs"] = 207, result
    for name in ("upsert", "update", "merge"):
        source.answers["POST", f"/ngsi-ld/v1/entityOperations/{name}"] = 207, result
    answer = act(near, entity_id, kind)
    assert answer.status_code == 207, answer.text
    assert answer.json()["success"] == [entity_id]
    assert [one["error"]["detail"] for one in answer.json()["errors"]] == ["its own source is away"]


def test_a_source_that_purged_in_part_says_what_it_purged(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    done, left = (f"urn:ngsi-ld:{kind}:{number}" for number in (1, 2))
    register(near, source.url, {"type": kind}, operations=["purgeEntity"])
    errors = [{"entityId": left, "error": {"title": "Forbidden", "status": 403}}]
    source.answers["DELETE", "/ngsi-ld/v1/entities"] = 207, {"success": [done], "errors": errors}
    answer = near.delete("/entities", params={"type": kind})
    assert answer.status_code == 207, answer.text
    assert answer.json()["success"] == [done]
    assert [(one["entityId"], one["error"]["status"]) for one in answer.json()["errors"]] == [(left, 403)]


def test_a_write_that_the_broker_rejects_is_not_forwarded(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    entity_id = put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    register(near, source.url, {"type": kind})
    assert near.patch(f"/entities/{entity_id}", json={"a": {"type": "Nonsense"}}).status_code == 400
    assert source.asked == []


@pytest.mark.parametrize(("there", "status"), [(False, 207), (True, 409)], ids=["new there", "there too"])
def test_an_existing_entity_is_still_created_at_inclusive_sources(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str, *, there: bool, status: int
) -> None:
    entity_id = put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    if there:
        put(far, entity_id, kind, b=1)
    register(near, brokers[1].url, {"type": kind})
    answer = create(near, entity_id, kind)
    assert answer.status_code == status, answer.text
    said = answer.json()
    if there:
        assert said["type"].endswith("/AlreadyExists")
        assert [one["status"] for one in said["errors"]] == [409], "the source has it too"
    else:
        assert said["success"] == [entity_id]
        (error,) = said["errors"]
        assert error["error"]["type"].endswith("/AlreadyExists")
        assert "registrationId" not in error, "the failed part is the broker's own"
    assert held(near, entity_id) == {"a": 1}
    assert held(far, entity_id) == ({"b": 1} if there else {"a": 2, "b": 2})


def test_an_existing_entity_in_a_batch_is_still_created_at_inclusive_sources(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    entity_id = put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    register(near, brokers[1].url, {"type": kind}, operations=["redirectionOps", "createBatch"])
    new = f"urn:ngsi-ld:{kind}:2"
    entities = [{"id": one, "type": kind, "a": 2} for one in (entity_id, new)]
    answer = near.post("/entityOperations/create", json=entities)
    assert answer.status_code == 207, answer.text
    assert answer.json()["success"] == [entity_id, new]
    (error,) = answer.json()["errors"]
    assert (error["entityId"], error["error"]["status"]) == (entity_id, 409)
    assert held(near, entity_id) == {"a": 1}
    assert held(far, entity_id) == {"a": 2}


def test_a_failed_source_does_not_hide_a_conflict(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    entity_id = put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    register(near, source.url, {"type": kind})
    source.answers["POST", "/ngsi-ld/v1/entities"] = 500, {}
    answer = create(near, entity_id, kind)
    assert answer.status_code == 409, answer.text
    assert answer.json()["type"].endswith("/AlreadyExists")
    assert [one["status"] for one in answer.json()["errors"]] == [500]


@pytest.mark.parametrize("act", [update_one, replace_one, delete_one])
def test_a_failed_local_part_is_reported_with_a_successful_source(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str, act: Act
) -> None:
    entity_id = put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    put(far, entity_id, kind, b=1)
    register(near, brokers[1].url, {"type": kind})
    answer = act(near, entity_id, kind)
    assert answer.status_code == 207, answer.text
    assert answer.json()["updated"] == [DEFAULT + "b"]
    (left,) = answer.json()["notUpdated"]
    assert left["attributeName"] == DEFAULT + "b"
    assert "has no attribute" in left["reason"]
    assert "registrationId" not in left, "the failed part is the broker's own"
    assert held(far, entity_id) == ({} if act is delete_one else {"b": 2})
    near.delete(f"/entities/{entity_id}?local=true")
    assert act(near, entity_id, kind).status_code == (404 if act is delete_one else 204), "nothing is here"


@pytest.mark.parametrize("act", [update_one, replace_one, delete_one])
def test_an_attribute_that_no_source_has_is_not_found(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str, act: Act
) -> None:
    entity_id = put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    put(far, entity_id, kind, a=1)
    register(near, brokers[1].url, {"type": kind})
    answer = act(near, entity_id, kind)
    assert (answer.status_code, answer.json()["type"].rpartition("/")[2]) == (404, "ResourceNotFound")


def test_a_local_write_is_not_forwarded(near: httpx.Client, source: ScriptedSource, kind: str) -> None:
    register(near, source.url, {"type": kind})
    put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    near.delete(f"/entities/urn:ngsi-ld:{kind}:1?local=true")
    assert source.asked == []


def test_a_write_that_returns_is_a_loop(near: httpx.Client, source: ScriptedSource, kind: str) -> None:
    entity_id = f"urn:ngsi-ld:{kind}:1"
    register(near, source.url, {"type": kind})
    source.answers["POST", "/ngsi-ld/v1/entities"] = 201, {}
    assert create(near, entity_id, kind).status_code == 201
    via = source.asked[-1][3]["via"]
    assert near.delete(f"/entities/{entity_id}", headers={"Via": via}).status_code == 508
    assert held(near, entity_id) == {"a": 2, "b": 2}


def test_a_source_receives_its_names_and_version(
    near: httpx.Client, source: ScriptedSource, kind: str, subscriber: Any
) -> None:
    core = "https://uri.etsi.org/ngsi-ld/default-context/"
    subscriber.document = {"@context": {kind: core + kind, "tempo": core + "speed", "wort": core + "words"}}
    url = subscriber.url.replace("/notify", f"/{kind}.jsonld")
    info = [{"key": "jsonldContext", "value": url}, {"key": "ngsildConformance", "value": "1.6"}]
    register(near, source.url, {"type": kind}, mode="redirect", contextSourceInfo=info)
    source.answers["POST", "/ngsi-ld/v1/entities"] = 201, {}
    entity = {
        "id": f"urn:ngsi-ld:{kind}:1",
        "type": kind,
        "speed": {"type": "Property", "value": 5},
        "words": {"type": "JsonProperty", "json": {"speed": 1}},
    }
    assert near.post("/entities", json=entity).status_code == 201
    _, _, _, headers, body = source.asked[-1]
    assert headers["content-type"] == "application/json"
    assert url in headers["link"]
    assert body["tempo"] == {"type": "Property", "value": 5}
    assert body["wort"] == {"type": "Property", "value": {"speed": 1}}


@pytest.mark.parametrize("wanted", [None, "application/ld+json"])
def test_an_inline_context_is_forwarded(
    near: httpx.Client, source: ScriptedSource, kind: str, wanted: str | None
) -> None:
    info = [] if wanted is None else [{"key": "contentType", "value": wanted}]
    register(near, source.url, {"type": kind}, mode="redirect", contextSourceInfo=info)
    source.answers["POST", "/ngsi-ld/v1/entities"] = 201, {}
    core = "https://uri.etsi.org/ngsi-ld/default-context/"
    entity = {
        "id": f"urn:ngsi-ld:{kind}:1",
        "type": kind,
        "x": 1,
        "@context": {"x": "urn:x:", kind: core + kind},
    }
    answer = near.post("/entities", json=entity, headers={"Content-Type": "application/ld+json"})
    assert answer.status_code == 201, answer.text
    _, _, _, headers, body = source.asked[-1]
    assert headers["content-type"] == "application/ld+json"
    assert body["@context"] == entity["@context"]
    assert "link" not in headers


def test_json_ld_is_forwarded_unchanged(near: httpx.Client, source: ScriptedSource, kind: str) -> None:
    register(near, source.url, {"type": kind}, mode="redirect", operations=["redirectionOps", "createBatch"])
    source.answers["POST", "/ngsi-ld/v1/entities"] = 201, {}
    source.answers["POST", "/ngsi-ld/v1/entityOperations/create"] = 201, []
    url = "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context-v1.8.jsonld"
    entity = {"id": f"urn:ngsi-ld:{kind}:1", "type": kind, "x": 1, "@context": [url]}
    headers = {"Content-Type": "application/ld+json"}
    assert near.post("/entities", json=entity, headers=headers).status_code == 201
    assert source.asked[-1][4] == entity
    assert near.post("/entityOperations/create", json=[entity], headers=headers).status_code == 201
    assert source.asked[-1][4] == [entity]
    assert source.asked[-1][3]["content-type"] == "application/ld+json"


def test_a_write_reaches_the_end_of_a_chain(brokers: list[Any], kind: str) -> None:
    with brokers[0].client() as first, brokers[1].client() as second, brokers[2].client() as third:
        paths = [
            (first, register(first, brokers[1].api, {"type": kind}, mode="redirect")),
            (second, register(second, brokers[2].url, {"type": kind}, mode="redirect")),
        ]
        entity_id = f"urn:ngsi-ld:{kind}:1"
        assert create(first, entity_id, kind).status_code == 201
        assert [held(one, entity_id) for one in (first, second, third)] == [None, None, {"a": 2, "b": 2}]
        assert merge(first, entity_id, kind).status_code == 204
        assert delete(first, entity_id, kind).status_code == 204
        assert held(third, entity_id) is None
        for client, path in paths:
            client.delete(path)


@pytest.mark.parametrize("names", [None, ["b"]])
def test_a_purge_is_limited_to_the_registration(
    near: httpx.Client, far: httpx.Client, kind: str, names: list[str] | None
) -> None:
    for client in (near, far):
        put(client, f"urn:ngsi-ld:{kind}:1", kind, a=1, b=1)
        put(client, f"urn:ngsi-ld:{kind}:2", kind, a=2, b=1)
        put(client, f"urn:ngsi-ld:{kind}:other", f"{kind}Other", a=1, b=1)
    register(near, str(far.base_url), {"type": kind}, names)
    assert near.delete("/entities", params={"type": f"{kind},{kind}Other", "q": "a==1"}).status_code == 204
    assert held(near, f"urn:ngsi-ld:{kind}:1") is None
    assert held(near, f"urn:ngsi-ld:{kind}:2") == {"a": 2, "b": 1}
    assert held(near, f"urn:ngsi-ld:{kind}:other") is None
    assert held(far, f"urn:ngsi-ld:{kind}:1") == (None if names is None else {"a": 1})
    assert held(far, f"urn:ngsi-ld:{kind}:2") == {"a": 2, "b": 1}
    assert held(far, f"urn:ngsi-ld:{kind}:other") == {"a": 1, "b": 1}


def test_purge_filters_apply_to_merged_entities(near: httpx.Client, far: httpx.Client, kind: str) -> None:
    good, bad, there = (f"urn:ngsi-ld:{kind}:{name}" for name in ("good", "bad", "there"))
    for one in (good, bad):
        put(far, one, kind, heat=5)
    put(near, good, kind, hall=1)
    put(near, bad, kind, hall=2)
    put(far, there, kind, heat=50)
    register(near, str(far.base_url), {"type": kind}, ["heat"])
    assert near.delete("/entities", params={"type": kind, "q": "hall==1;heat<10"}).status_code == 204
    assert held(near, good) is None
    assert held(far, good) == {}
    assert held(near, bad) == {"hall": 2}
    assert held(far, bad) == {"heat": 5}
    assert held(far, there) == {"heat": 50}
    assert near.delete("/entities", params={"type": kind, "q": "heat>100"}).status_code == 204
    dropped = near.delete("/entities", params={"type": kind, "q": "hall==2;heat==5", "drop": "heat"})
    assert dropped.status_code == 204
    assert held(far, bad) == {}
    assert held(near, bad) == {"hall": 2}
    assert near.delete("/entities", params={"q": "modifiedAt>2020-01-01T00:00:00Z"}).status_code == 400


PAST = ["upsertTemporal", "appendAttrsTemporal", "deleteAttrsTemporal", "deleteTemporal", "retrieveTemporal"]


def past(client: httpx.Client, entity_id: str) -> dict[str, list[Any]] | None:
    answer = client.get(f"/temporal/entities/{entity_id}?local=true")
    if answer.status_code == 404:
        return None
    return {
        name: [one["value"] for one in (said if isinstance(said, list) else [said])]
        for name, said in answer.json().items()
        if isinstance(said, dict | list)
    }


@pytest.mark.parametrize("mode", ["inclusive", "redirect", "exclusive"])
def test_temporal_writes_go_to_the_temporal_sources(
    near: httpx.Client, far: httpx.Client, kind: str, mode: str
) -> None:
    def returned(value: int) -> list[dict[str, Any]]:
        return [{"type": "Property", "value": value, "observedAt": f"2026-01-01T00:00:0{value}Z"}]

    entity_id = f"urn:ngsi-ld:{kind}:1"
    info = {"type": kind, "id": entity_id} if mode == "exclusive" else {"type": kind}
    names = ["b"] if mode == "exclusive" else None
    register(near, str(far.base_url), info, names, mode=mode, operations=PAST)
    document = {"id": entity_id, "type": kind, "a": returned(1), "b": returned(1)}
    assert near.post("/temporal/entities", json=document).status_code == 201
    here, there = {
        "inclusive": ({"a": [1], "b": [1]}, {"a": [1], "b": [1]}),
        "redirect": (None, {"a": [1], "b": [1]}),
        "exclusive": ({"a": [1]}, {"b": [1]}),
    }[mode]
    assert (past(near, entity_id), past(far, entity_id)) == (here, there)
    assert near.post(f"/temporal/entities/{entity_id}/attrs", json={"b": returned(2)}).status_code == 204
    assert (past(far, entity_id) or {})["b"] == [1, 2]
    assert near.delete(f"/temporal/entities/{entity_id}/attrs/b").status_code == 204
    assert "b" not in (past(far, entity_id) or {})
    assert near.delete(f"/temporal/entities/{entity_id}").status_code == 204
    assert (past(near, entity_id), past(far, entity_id)) == (None, None)
