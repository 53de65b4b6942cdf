"""Invalid input has no effect on others: huge coordinates, deep JSON, HEAD of a query that creates a map."""

import asyncio
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover_broker.app import create_broker
from handover_broker.query.indexes.place_index import PlaceIndex
from handover_broker.settings import BrokerSettings

NEAR = {"georel": "near;maxDistance==2000", "geometry": "Point", "coordinates": "[8,40]"}
HUGE = {"type": "Point", "coordinates": [1e308, 1e308]}
HERE = {"type": "Point", "coordinates": [8, 40]}


def robot(kind: str, name: str, at: Any = None) -> dict[str, Any]:
    return {"id": f"urn:ngsi-ld:{kind}:{name}", "type": kind, "location": at or HERE}


@pytest.mark.nightly
def test_a_huge_coordinate_is_refused_wherever_a_geometry_is_accepted(http: httpx.Client, kind: str) -> None:
    fine, huge = robot(kind, "fine"), robot(kind, "huge", HUGE)
    assert http.post("/entities", json=fine).status_code == 201
    assert len(http.get("/entities", params={"type": kind, **NEAR}).json()) == 1  # so there is an index
    path = f"/entities/{fine['id']}"
    place = {"type": "GeoProperty", "value": HUGE}
    past = {**fine, "location": [{**place, "observedAt": "2026-01-01T00:00:00Z"}]}
    subscription = {
        "type": "Subscription",
        "entities": [{"type": kind}],
        "geoQ": {"georel": "near;maxDistance==1", "geometry": "Point", "coordinates": HUGE["coordinates"]},
        "notification": {"endpoint": {"uri": "http://127.0.0.1:9/"}},
    }
    registration = {
        "type": "ContextSourceRegistration",
        "information": [{"entities": [{"type": kind}]}],
        "endpoint": "http://127.0.0.1:9/",
        "location": HUGE,
    }
    query = {"type": "Query", "entities": [{"type": kind}], "geoQ": subscription["geoQ"]}
    answers = [
        http.post("/entities", json=huge),
        http.put(path, json=huge),
        http.patch(path, json={"location": HUGE}),
        http.patch(f"{path}/attrs", json={"location": HUGE}),
        http.post(f"{path}/attrs", json={"location": HUGE}),
        http.patch(f"{path}/attrs/location", json=place),
        http.put(f"{path}/attrs/location", json=place),
        http.post("/temporal/entities", json=past),
        http.post(f"/temporal/entities/{fine['id']}/attrs", json={"location": place}),
        http.post("/subscriptions", json=subscription),
        http.post("/csourceRegistrations", json=registration),
        http.post("/entityOperations/query", json=query),
        http.get("/entities", params={"type": kind, **NEAR, "coordinates": "[1e308,1e308]"}),
        http.get("/csourceRegistrations", params={"type": kind, **NEAR, "coordinates": "[181,0]"}),
        http.get("/entities", params={"type": kind, "orderBy": "location;dist-asc", "orderFrom": "[0,91]"}),
    ]
    for number, answer in enumerate(answers):
        assert (answer.status_code, number) == (400, number), answer.text
        assert answer.json()["type"].endswith("BadRequestData"), answer.text
    batch = http.post("/entityOperations/upsert", json=[huge, robot(kind, "beside")])
    assert batch.status_code == 207
    assert batch.json()["errors"][0]["error"]["status"] == 400
    found = http.get("/entities", params={"type": kind, **NEAR}).json()
    assert {one["id"] for one in found} == {fine["id"], f"urn:ngsi-ld:{kind}:beside"}


def test_an_index_that_fails_touches_no_write(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, kind: str
) -> None:
    """Indexes are rebuilt from the entities; storage and memory agree, and every write is answered."""
    refile, broken = PlaceIndex.refile, f"urn:ngsi-ld:{kind}:3"

    def breaks(self: PlaceIndex, before: Any, after: Any) -> None:
        if before is None and after is not None and after.id == broken and len(self):
            raise OverflowError("cannot convert float infinity to integer")
        refile(self, before, after)

    monkeypatch.setattr(PlaceIndex, "refile", breaks)

    async def steps() -> None:
        broker = create_broker(BrokerSettings(data_dir=tmp_path))
        await broker._serve()
        transport = httpx.ASGITransport(broker)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost/ngsi-ld/v1") as client:
            assert (await client.post("/entities", json=robot(kind, "0"))).status_code == 201
            assert len((await client.get("/entities", params={"type": kind, **NEAR})).json()) == 1
            created = await asyncio.gather(
                *(client.post("/entities", json=robot(kind, str(number))) for number in range(1, 8))
            )
            assert [one.status_code for one in created] == [201] * 7
            listed = (await client.get("/entities", params={"type": kind})).json()
            assert len(listed) == 8
            types = (await client.get(f"/types/{kind}")).json()
            assert types["entityCount"] == 8
        await broker._broker.stop()

    asyncio.run(steps())


@pytest.mark.parametrize("depth", [201, 240, 254, 255, 500, 1000, 1024, 1025, 100_000])
@pytest.mark.parametrize("level", [("[", "]"), ('{"a":', "}")])
def test_json_of_any_depth_is_refused(
    http: httpx.Client, depth: int, level: tuple[str, str], kind: str
) -> None:
    deep = level[0] * depth + "1" + level[1] * depth
    entity = robot(kind, "deep")
    assert http.post("/entities", json=entity).status_code in {201, 409}
    path = f"/entities/{entity['id']}"
    in_attribute = '{"deep":{"type":"Property","value":' + deep + "}}"
    whole = f'{{"id":"urn:ngsi-ld:{kind}:new","type":"{kind}","deep":{{"type":"Property","value":{deep}}}}}'
    asked = [
        ("POST", "/entities", whole),
        ("POST", "/entities", deep),
        ("PUT", path, whole),
        ("PATCH", path, in_attribute),
        ("POST", f"{path}/attrs", in_attribute),
        ("PATCH", f"{path}/attrs", in_attribute),
        ("PATCH", f"{path}/attrs/location", '{"type":"Property","value":' + deep + "}"),
        ("POST", "/temporal/entities", whole),
        ("POST", "/entityOperations/upsert", f"[{whole}]"),
        ("POST", "/entityOperations/delete", deep),
        ("POST", "/entityOperations/query", deep),
        ("POST", "/subscriptions", deep),
        ("POST", "/csourceRegistrations", deep),
        ("POST", "/csourceSubscriptions", deep),
        ("POST", "/jsonldContexts", '{"@context":' + deep + "}"),
        ("POST", "/snapshots", deep),
        ("POST", "/entityMaps", deep),
    ]
    headers = {"Content-Type": "application/json"}
    for method, where, body in asked:
        answer = http.request(method, where, content=body.encode(), headers=headers)
        assert answer.status_code == 400, (method, where, answer.text)
        assert "nested deeper than 200" in answer.json()["detail"], (method, where, answer.text)


def test_json_of_the_maximum_depth_is_stored_and_returned_in_every_form(
    http: httpx.Client, kind: str
) -> None:
    value: Any = 1
    for number in range(196):
        value = [value] if number % 2 else {"a": value}
    entity = {**robot(kind, "deep"), "deep": {"type": "Property", "value": value}}
    assert http.post("/entities", json=entity).status_code == 201
    assert http.patch(f"/entities/{entity['id']}", json={"deep": {"value": value}}).status_code == 204
    for accept in ("application/json", "application/ld+json", "application/geo+json"):
        for options in ({}, {"options": "keyValues"}, {"options": "sysAttrs"}):
            for path in ("/entities", f"/entities/{entity['id']}"):
                asked = {"type": kind, **options}
                answer = http.get(path, params=asked, headers={"Accept": accept})
                assert answer.status_code == 200, answer.text
    ever = {"timerel": "after", "timeAt": "1970-01-01T00:00:00Z", "timeproperty": "modifiedAt"}
    assert http.get(f"/temporal/entities/{entity['id']}", params=ever).status_code == 200


def test_head_answers_as_get_does_where_a_map_is_made(http: httpx.Client, kind: str) -> None:
    assert http.post("/entities", json=robot(kind, "listed")).status_code == 201
    for path in ("/entities", "/entityMaps", "/temporal/entityMaps"):
        asked = {"type": kind, "entityMap": "true"}
        if "temporal" in path:
            asked |= {"timerel": "after", "timeAt": "1970-01-01T00:00:00Z"}
        head, get = (http.request(method, path, params=asked) for method in ("HEAD", "GET"))
        assert (head.status_code, head.content) == (get.status_code, b""), path
        assert head.status_code < 300, get.text
