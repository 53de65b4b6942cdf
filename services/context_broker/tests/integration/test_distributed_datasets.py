"""Sources that have some datasetIds of an attribute: routing of writes."""

from typing import Any

import httpx
import pytest

from tests.kit.context_sources import ScriptedSource, put, register

HERE, THERE = "urn:x:here", "urn:x:there"


@pytest.fixture
def both(near: httpx.Client, far: httpx.Client, brokers: list[Any]) -> tuple[httpx.Client, httpx.Client, str]:
    """Clients of two brokers, and the URL of the second."""
    return near, far, brokers[1].url


def instance(value: int, dataset: str | None = None) -> dict[str, Any]:
    return {"type": "Property", "value": value, **({} if dataset is None else {"datasetId": dataset})}


def instances(client: httpx.Client, entity_id: str, name: str) -> set[tuple[int, str | None]]:
    answer = client.get(f"/entities/{entity_id}", params={"local": "true"})
    assert answer.status_code == 200, answer.text
    said = answer.json().get(name, [])
    return {(one["value"], one.get("datasetId")) for one in (said if isinstance(said, list) else [said])}


@pytest.mark.nightly
@pytest.mark.parametrize("mode", ["inclusive", "redirect"])
@pytest.mark.parametrize("way", ["create", "create_batch", "simplified"])
def test_a_source_receives_only_the_instances_of_its_datasets(
    both: tuple[httpx.Client, httpx.Client, str], kind: str, mode: str, way: str
) -> None:
    near, far, url = both
    register(near, url, {"type": kind}, mode=mode, datasetId=[THERE, "@none"])
    one = f"urn:ngsi-ld:{kind}:1"
    document: dict[str, Any] = {
        "id": one,
        "type": kind,
        "a": [instance(1), instance(2, THERE), instance(3, HERE)],
        "b": instance(4, HERE),
        "c": instance(5),
    }
    if way == "simplified":
        document |= {"a": {"dataset": {"@none": 1, THERE: 2, HERE: 3}}, "b": {"dataset": {HERE: 4}}, "c": 5}
    path, body = (
        ("/entityOperations/create", [document]) if way == "create_batch" else ("/entities", document)
    )
    form = {"options": "keyValues"} if way == "simplified" else {}
    answer = near.post(path, json=body, params=form)
    assert answer.status_code == 201, answer.text
    assert instances(far, one, "a") == {(1, None), (2, THERE)}
    assert instances(far, one, "b") == set()
    assert instances(far, one, "c") == {(5, None)}
    stays = set() if mode == "redirect" else {(1, None), (2, THERE)}
    assert instances(near, one, "a") == {(3, HERE)} | stays
    assert instances(near, one, "b") == {(4, HERE)}
    whole = near.get(f"/entities/{one}").json()
    assert {(each["value"], each.get("datasetId")) for each in whole["a"]} == {
        (1, None),
        (2, THERE),
        (3, HERE),
    }


def test_changes_of_an_attribute_are_routed_by_dataset(
    both: tuple[httpx.Client, httpx.Client, str], kind: str
) -> None:
    near, far, url = both
    register(near, url, {"type": kind}, mode="redirect", datasetId=[THERE])
    one = f"urn:ngsi-ld:{kind}:1"
    made = near.post("/entities", json={"id": one, "type": kind, "a": [instance(1), instance(2, THERE)]})
    assert made.status_code == 201, made.text
    at = f"/entities/{one}/attrs"
    assert near.patch(f"{at}/a", json=instance(20, THERE)).status_code == 204
    assert near.patch(f"{at}/a", json=instance(10)).status_code == 204
    assert (instances(near, one, "a"), instances(far, one, "a")) == ({(10, None)}, {(20, THERE)})
    assert near.post(at, json={"a": [instance(11), instance(21, THERE)]}).status_code == 204
    assert (instances(near, one, "a"), instances(far, one, "a")) == ({(11, None)}, {(21, THERE)})
    assert near.delete(f"{at}/a", params={"datasetId": THERE}).status_code == 204
    assert (instances(near, one, "a"), instances(far, one, "a")) == ({(11, None)}, set())
    assert near.delete(f"{at}/a").status_code == 204
    assert instances(near, one, "a") == set()


def test_a_registration_of_other_datasets_causes_no_conflict(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    one = put(near, f"urn:ngsi-ld:{kind}:1", kind, a=instance(1, HERE))
    only = {"id": one, "type": kind}
    register(near, source.url, only, ["a"], mode="exclusive", datasetId=[THERE])
    refused = near.post(
        "/csourceRegistrations",
        json={
            "type": "ContextSourceRegistration",
            "mode": "exclusive",
            "operations": ["redirectionOps"],
            "information": [{"entities": [only], "propertyNames": ["a"]}],
            "endpoint": source.url,
            "datasetId": [HERE],
        },
    )
    assert refused.status_code == 409
