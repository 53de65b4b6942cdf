"""Entity maps and snapshots where entities are spread over several brokers."""

from typing import Any

import httpx

from tests.context_sources import ScriptedSource, put, register

from .conftest import wait_for

MAP = "NGSILD-EntityMap"


def test_a_map_tells_who_has_what_and_only_they_are_asked(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    ids = [f"urn:ngsi-ld:{kind}:{number}" for number in range(4)]
    for one in ids[:3]:
        put(near, one, kind, here=1)
    registration = register(near, source.url, {"type": kind}, ["there"]).rpartition("/")[2]
    path = ("GET", "/ngsi-ld/v1/entities")
    source.answers[path] = 200, [{"id": one, "type": kind, "there": 2} for one in ids[2:]]
    answer = near.get("/entityMaps", params={"type": kind})
    assert answer.status_code == 201, answer.text
    assert answer.json()["entityMap"] == {
        ids[0]: ["@none"],
        ids[1]: ["@none"],
        ids[2]: ["@none", registration],
        ids[3]: [registration],
    }
    pages: list[Any] = []
    for offset in ("0", "2"):
        source.asked.clear()
        page = near.get(
            "/entities",
            params={"type": kind, "limit": "2", "offset": offset},
            headers={MAP: answer.headers[MAP]},
        )
        pages += page.json()
        asked = source.asked[-1][2]["id"].split(",")
        assert len(asked) == 2
    assert sorted(one["id"] for one in pages) == ids
    assert {one["id"] for one in pages if "there" in one} == set(ids[2:])


def test_a_query_that_wants_a_map_asks_sources_too(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    put(far, f"urn:ngsi-ld:{kind}:2", kind, a=2)
    register(near, brokers[1].url, {"type": kind})
    answer = near.get("/entities", params={"type": kind, "entityMap": "true"})
    assert answer.status_code == 201
    assert sorted(one["a"]["value"] for one in answer.json()) == [1, 2]
    put(far, f"urn:ngsi-ld:{kind}:3", kind, a=3)
    again = near.get("/entities", params={"type": kind}, headers={MAP: answer.headers[MAP]})
    assert sorted(one["a"]["value"] for one in again.json()) == [1, 2]


def test_a_snapshot_holds_what_sources_have_too(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    put(far, f"urn:ngsi-ld:{kind}:2", kind, a=2)
    put(far, f"urn:ngsi-ld:{kind}:3", kind, a=0)
    register(near, brokers[1].url, {"type": kind})
    query = {"type": "Query", "entities": [{"type": kind}], "q": "a>0"}
    made = near.post("/snapshots", json={"snapshotQueries": [query]})
    at = made.headers["location"].removeprefix("/ngsi-ld/v1")
    status = wait_for(lambda: (told := near.get(at).json()["snapshotStatus"]) != "preparing" and told)
    assert status == "success"
    far.delete(f"/entities/urn:ngsi-ld:{kind}:2")
    inside = {"NGSILD-Snapshot": near.get(at).json()["id"]}
    answer = near.get("/entities", params={"type": kind}, headers=inside)
    assert sorted(one["a"]["value"] for one in answer.json()) == [1, 2]
