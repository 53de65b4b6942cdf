"""Entities read from several brokers: registration modes and failures."""

from typing import Any

import httpx
import pytest

from tests.kit.context_sources import ScriptedSource, put, register, values


def at(value: Any, second: int) -> dict[str, Any]:
    return {"type": "Property", "value": value, "observedAt": f"2026-01-01T00:00:{second:02}Z"}


READ = {
    # mode: what the reader gets of a (here only), b (both; newer there), c (both; newer here), d (there only)
    "inclusive": {"a": 1, "b": "there", "c": "here", "d": 4},
    "redirect": {"b": "there", "c": "there", "d": 4},
    "auxiliary": {"a": 1, "b": "here", "c": "here", "d": 4},
    "exclusive": {"a": 1, "c": "here", "b": "there", "d": 4},
}


HOW = ("retrieve", "query", "query by POST", "query by id")


@pytest.mark.parametrize("returned", [(mode, how) for mode in READ for how in HOW], ids="-".join)
def test_the_mode_selects_whose_attributes_count(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str, returned: tuple[str, str]
) -> None:
    mode, how = returned
    entity_id = f"urn:ngsi-ld:{kind}:1"
    names = ["b", "d"] if mode == "exclusive" else None
    info = {"type": kind, "id": entity_id} if mode == "exclusive" else {"type": kind}
    if mode in {
        "exclusive",
        "redirect",
    }:  # a proxied source's data is stored here only with local=true
        register(near, brokers[1].url, info, names, mode=mode)
    put(near, entity_id, kind, a=at(1, 0), b=at("here", 1), c=at("here", 9))
    put(far, entity_id, kind, b=at("there", 5), c=at("there", 5), d=at(4, 0))
    if mode in {"inclusive", "auxiliary"}:
        register(near, brokers[1].url, info, names, mode=mode)
    if how == "retrieve":
        assert values(near.get(f"/entities/{entity_id}")) == READ[mode]
        return
    if how == "query by POST":
        answer = near.post("/entityOperations/query", json={"type": "Query", "entities": [{"type": kind}]})
    else:
        answer = near.get("/entities", params={"type": kind} | ({"id": entity_id} if "id" in how else {}))
    assert answer.status_code == 200, answer.text
    (entity,) = answer.json()
    assert {name: said["value"] for name, said in entity.items() if isinstance(said, dict)} == READ[mode]


def test_a_local_query_contacts_no_source(near: httpx.Client, source: ScriptedSource, kind: str) -> None:
    register(near, source.url, {"type": kind})
    assert near.get(f"/entities/urn:ngsi-ld:{kind}:1?local=true").status_code == 404
    assert near.get(f"/entities?type={kind}&local=true").json() == []
    assert source.asked == []


def test_filters_and_pages_apply_to_merged_entities(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    register(near, brokers[1].api, {"type": kind}, ["there"])
    for number in range(12):
        entity_id = f"urn:ngsi-ld:{kind}:{number:02}"
        put(near, entity_id, kind, here=number)
        put(far, entity_id, kind, there=number % 2, hidden=1)
    put(far, f"urn:ngsi-ld:{kind}:99", kind, there=1)
    answer = near.get("/entities", params={"type": kind, "q": "there==1;here>4", "count": "true"})
    assert [one["id"][-2:] for one in answer.json()] == ["05", "07", "09", "11"]
    assert answer.headers["ngsild-results-count"] == "4"
    assert "hidden" not in answer.json()[0]
    found: list[str] = []
    url = f"/entities?type={kind}&limit=5"
    while url:
        answer = near.get(url.removeprefix("/ngsi-ld/v1"))
        found += [one["id"] for one in answer.json()]
        url = answer.links.get("next", {}).get("url", "")
    assert len(found) == len(set(found)) == 13


def test_filters_are_forwarded_for_unsplit_entities(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind})
    source.answers["GET", "/ngsi-ld/v1/entities"] = (
        200,
        [{"id": f"urn:ngsi-ld:{kind}:1", "type": kind, "n": 9}],
    )
    assert len(near.get("/entities", params={"type": kind, "q": "n>5"}).json()) == 1
    assert source.asked[-1][2]["q"] == "n>5"
    near.get("/entities", params={"type": kind, "q": "n>5", "splitEntities": "true"})
    assert "q" not in source.asked[-1][2]


def test_a_chain_of_brokers_and_a_loop(brokers: list[Any], kind: str) -> None:
    with brokers[0].client() as first, brokers[1].client() as second, brokers[2].client() as third:
        paths = [
            (first, register(first, brokers[1].url, {"type": kind})),
            (second, register(second, brokers[2].url, {"type": kind})),
            (third, register(third, brokers[0].url, {"type": kind})),
        ]
        entity_id = f"urn:ngsi-ld:{kind}:1"
        put(first, entity_id, kind, a=1)
        put(second, entity_id, kind, b=2)
        put(third, entity_id, kind, c=3)
        for one in (first, second, third):
            assert values(one.get(f"/entities/{entity_id}")) == {"a": 1, "b": 2, "c": 3}
            assert len(one.get("/entities", params={"type": kind}).json()) == 1
        for client, path in paths:
            client.delete(path)


def test_brokers_learn_the_alias_of_their_sources(brokers: list[Any], kind: str) -> None:
    with brokers[0].client() as first, brokers[1].client() as second:
        paths = [
            (first, register(first, brokers[1].url, {"type": kind})),
            (second, register(second, brokers[0].url, {"type": kind})),
        ]
        put(second, f"urn:ngsi-ld:{kind}:1", kind, a=1)
        for _ in range(3):
            assert values(first.get(f"/entities/urn:ngsi-ld:{kind}:1")) == {"a": 1}
        (here, there) = (client.get(path).json() for client, path in paths)
        assert (here["timesSent"], here["timesFailed"]) == (3, 0)
        assert there["timesSent"] == 1  # which was answered by 508: the others were not sent
        for client, path in paths:
            client.delete(path)


def test_a_broker_can_be_a_source_of_itself_for_another_tenant(
    near: httpx.Client, brokers: list[Any], kind: str
) -> None:
    there = {"NGSILD-Tenant": f"tenant-{kind}"}
    entity = {"id": f"urn:ngsi-ld:{kind}:1", "type": kind, "a": 1}
    assert near.post("/entities", json=entity, headers=there).status_code == 201
    assert near.get(f"/entities/{entity['id']}").status_code == 404
    register(near, brokers[0].url, {"type": kind}, tenant=there["NGSILD-Tenant"])
    assert values(near.get(f"/entities/{entity['id']}")) == {"a": 1}


def test_a_request_that_returns_is_a_loop(near: httpx.Client, source: ScriptedSource, kind: str) -> None:
    register(near, source.url, {"type": kind})
    near.get(f"/entities/urn:ngsi-ld:{kind}:1")
    via = source.asked[-1][3]["via"]
    answer = near.get(f"/entities/urn:ngsi-ld:{kind}:1", headers={"Via": f"1.1 other, {via} (proxy)"})
    assert answer.status_code == 508
    assert answer.json()["type"].endswith("LoopDetected")
    assert "Via" in answer.json()["detail"]


def test_a_source_in_the_via_header_is_not_queried(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, contextSourceAlias="peer")
    near.get(f"/entities?type={kind}", headers={"Via": "1.1 peer"})
    assert source.asked == []
    near.get(f"/entities?type={kind}", headers={"Via": "1.1 someone"})
    assert source.asked[-1][3]["via"].startswith("1.1 someone, 1.1 handover-")


@pytest.mark.parametrize(
    ("reply", "code"),
    [
        ((500, {}), "299"),
        ((403, {}), "299"),
        ((200, b"no json"), "111"),
        ((200, [1]), "111"),
        ((508, {}), "199"),
    ],
)
def test_a_failed_part_causes_a_warning(
    near: httpx.Client, source: ScriptedSource, kind: str, reply: tuple[int, Any], code: str
) -> None:
    register(near, source.url, {"type": kind})
    entity_id = put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    source.answers["GET", "/ngsi-ld/v1/entities"] = reply
    source.answers["GET", f"/ngsi-ld/v1/entities/{entity_id}"] = reply
    for answer in (near.get(f"/entities/{entity_id}"), near.get("/entities", params={"type": kind})):
        assert answer.status_code == 200, answer.text
        assert answer.headers["ngsild-warning"].startswith(code)


def test_an_unknown_entity_at_a_source_causes_no_warning(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind})
    answer = near.get(f"/entities/urn:ngsi-ld:{kind}:1")
    assert answer.status_code == 404
    assert "ngsild-warning" not in answer.headers


def test_a_hanging_source_costs_one_timeout(near: httpx.Client, source: ScriptedSource, kind: str) -> None:
    management = {"timeout": 150, "cooldown": 60_000}
    path = register(near, source.url, {"type": kind}, management=management)
    entity_id = put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    source.go_on.clear()
    for _ in range(5):
        answer = near.get(f"/entities/{entity_id}")
        assert answer.status_code == 200
        assert answer.headers["ngsild-warning"].startswith("199")
    assert len(source.asked) == 1
    returned = near.get(path).json()
    assert (returned["timesSent"], returned["timesFailed"], returned["status"]) == (1, 1, "failed")


@pytest.mark.parametrize(("reply", "status"), [((500, {}), 502), ((404, {}), 404), ((508, {}), 508)])
def test_the_failure_of_the_only_source_is_returned(
    near: httpx.Client, source: ScriptedSource, kind: str, reply: tuple[int, Any], status: int
) -> None:
    register(near, source.url, {"type": kind}, mode="redirect")
    source.answers["GET", f"/ngsi-ld/v1/entities/urn:ngsi-ld:{kind}:1"] = reply
    answer = near.get(f"/entities/urn:ngsi-ld:{kind}:1")
    assert answer.status_code == status
    assert answer.json()["detail"]


def test_the_timeout_of_the_only_source_is_returned(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, mode="redirect", management={"timeout": 100})
    source.go_on.clear()
    assert near.get(f"/entities/urn:ngsi-ld:{kind}:1").status_code == 504


def test_context_source_info_sets_headers(near: httpx.Client, source: ScriptedSource, kind: str) -> None:
    pairs = {
        "X-Cell": "4",
        "User": "urn:ngsi-ld:request",
        "Absent": "urn:ngsi-ld:request",
        "NGSILD-Tenant": "other",
        "Via": "1.1 evil",
        "Content-Length": "7",
        "accept": "application/ld+json",
    }
    info = [{"key": key, "value": value} for key, value in pairs.items()]
    register(near, source.url, {"type": kind}, contextSourceInfo=info, tenant="theirs")
    near.get(f"/entities/urn:ngsi-ld:{kind}:1", headers={"User": "abcd"})
    _, _, _, headers, _ = source.asked[-1]
    assert headers["x-cell"] == "4"
    assert headers["user"] == "abcd"
    assert "absent" not in headers
    assert headers["ngsild-tenant"] == "theirs"
    assert "evil" not in headers["via"]
    assert headers["accept"] == "application/ld+json"


def test_a_local_only_source_is_queried_with_local(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, management={"localOnly": True})
    near.get(f"/entities/urn:ngsi-ld:{kind}:1")
    assert source.asked[-1][2]["local"] == "true"


def test_a_context_source_filter_selects_sources(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, sourceType="sensor")
    near.get("/entities", params={"type": kind, "csf": 'sourceType=="archive"'})
    assert source.asked == []
    near.get("/entities", params={"type": kind, "csf": 'sourceType=="sensor"'})
    assert len(source.asked) == 1


def test_names_are_translated_to_the_context_of_the_source(
    near: httpx.Client, source: ScriptedSource, kind: str, subscriber: Any
) -> None:
    core = "https://uri.etsi.org/ngsi-ld/default-context/"
    subscriber.document = {"@context": {kind: core + kind, "tempo": core + "speed"}}
    url = subscriber.url.replace("/notify", f"/{kind}.jsonld")
    register(
        near,
        source.url,
        {"type": kind},
        ["speed"],
        contextSourceInfo=[{"key": "jsonldContext", "value": url}],
    )
    entity_id = f"urn:ngsi-ld:{kind}:1"
    source.answers["GET", f"/ngsi-ld/v1/entities/{entity_id}"] = (
        200,
        {"id": entity_id, "type": kind, "tempo": 5},
    )
    assert values(near.get(f"/entities/{entity_id}")) == {"speed": 5}
    assert source.asked[-1][2]["attrs"] == "tempo"
    assert url in source.asked[-1][3]["link"]


def test_a_response_is_cached_as_long_as_registered(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, management={"cacheDuration": "PT1H"})
    entity_id = f"urn:ngsi-ld:{kind}:1"
    source.answers["GET", f"/ngsi-ld/v1/entities/{entity_id}"] = 200, {"id": entity_id, "type": kind, "n": 5}
    near.get(f"/entities/{entity_id}")
    answer = near.get(f"/entities/{entity_id}")
    assert values(answer) == {"n": 5}
    assert answer.headers["ngsild-warning"].startswith("110")
    assert len(source.asked) == 1


def test_linked_entities_are_read_from_sources(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    register(near, brokers[1].url, {"type": f"{kind}Owner"})
    owner = put(far, f"urn:ngsi-ld:{kind}Owner:1", f"{kind}Owner", name="Ada")
    put(near, f"urn:ngsi-ld:{kind}:1", kind, owner={"type": "Relationship", "object": owner})
    answer = near.get("/entities", params={"type": kind, "join": "inline", "joinLevel": "1"})
    assert answer.json()[0]["owner"]["entity"]["name"]["value"] == "Ada"


def test_a_source_is_read_in_pages_that_it_accepts(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind})

    def page(query: dict[str, str]) -> tuple[int, Any]:
        limit, offset = int(query["limit"]), int(query.get("offset", 0))
        if limit > 100:
            return 403, {"title": "Too many results"}
        numbers = range(offset, min(offset + limit, 250))
        return 200, [{"id": f"urn:ngsi-ld:{kind}:{number}", "type": kind, "n": number} for number in numbers]

    source.answers["GET", "/ngsi-ld/v1/entities"] = page
    answer = near.get("/entities", params={"type": kind, "count": "true", "q": "n>=10"})
    assert answer.headers["ngsild-results-count"] == "240"
    assert "ngsild-warning" not in answer.headers
    assert [one[2].get("offset") for one in source.asked] == [None, None, "100", "200"]


def test_locations_scopes_and_representations_apply_to_merged_entities(
    near: httpx.Client, far: httpx.Client, kind: str
) -> None:
    def place(east: float) -> dict[str, Any]:
        return {"type": "GeoProperty", "value": {"type": "Point", "coordinates": [east, 60.0]}}

    register(near, str(far.base_url), {"type": kind})
    put(near, f"urn:ngsi-ld:{kind}:1", kind, n=3, location=place(24.0), scope="/hall")
    put(far, f"urn:ngsi-ld:{kind}:2", kind, n=1, location=place(24.001), scope="/hall/a")
    put(far, f"urn:ngsi-ld:{kind}:3", kind, n=2, location=place(25.0), scope="/yard")

    def ask(**parameters: str) -> list[Any]:
        answer = near.get("/entities", params={"type": kind, **parameters})
        assert answer.status_code == 200, answer.text
        return [one["id"][-1:] for one in answer.json()]

    by_place = {"georel": "near;maxDistance==1000", "geometry": "Point", "coordinates": "[24.0,60.0]"}
    assert sorted(ask(**by_place)) == ["1", "2"]
    assert (ask(scopeQ="/hall/a"), ask(scopeQ="/hall,/yard")) == (["2"], ["1", "3"])
    answer = near.get("/entities", params={"type": kind}, headers={"Accept": "application/geo+json"})
    assert answer.json()["type"] == "FeatureCollection"
    assert len(answer.json()["features"]) == 3
    simple = near.get("/entities", params={"type": kind, "options": "keyValues", "pick": "id,n"})
    assert sorted(one["n"] for one in simple.json()) == [1, 2, 3]


@pytest.mark.parametrize("mode", ["inclusive", "auxiliary"])
def test_results_of_sources_cannot_be_ordered(
    near: httpx.Client, far: httpx.Client, kind: str, mode: str
) -> None:
    for number, value in enumerate((3, 1, 2)):
        put(near, f"urn:ngsi-ld:{kind}:{number}", kind, n=value)
    path = register(near, str(far.base_url), {"type": kind}, mode=mode, operations=["retrieveOps"])
    document = {"type": "Query", "entities": [{"type": kind}], "ordering": {"orderBy": ["n"]}}
    asked = {"type": kind, "orderBy": "n"}
    for answer in (
        near.get("/entities", params=asked),
        near.get("/entities", params={**asked, "entityMap": "true"}),
        near.get("/entityMaps", params=asked),
        near.post("/entityMaps", json=document),
        near.post("/entityOperations/query", json=document),
    ):
        assert (answer.status_code, answer.json()["type"].rpartition("/")[2]) == (400, "BadRequestData")
        assert path.rpartition("/")[2] in answer.json()["detail"]
        assert "local=true" in answer.json()["detail"]
    for answer in (
        near.get("/entities", params={**asked, "local": "true"}),
        near.post("/entityOperations/query", params={"local": "true"}, json=document),
    ):
        assert [one["n"]["value"] for one in answer.json()] == [1, 2, 3], answer.text
    near.delete(path)
    assert [one["n"]["value"] for one in near.get("/entities", params=asked).json()] == [1, 2, 3]


def test_results_are_ordered_if_no_registration_matches(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    put(near, f"urn:ngsi-ld:{kind}:1", kind, n=2)
    put(near, f"urn:ngsi-ld:{kind}:2", kind, n=1)
    register(near, source.url, {"type": f"{kind}Other"})
    answer = near.get("/entities", params={"type": kind, "orderBy": "n"})
    assert [one["n"]["value"] for one in answer.json()] == [1, 2], answer.text
    assert source.asked == []


@pytest.mark.parametrize("path", ["/temporal/entities", "/temporal/entityMaps"])
def test_temporal_results_of_sources_cannot_be_ordered(
    near: httpx.Client, source: ScriptedSource, kind: str, path: str
) -> None:
    register(near, source.url, {"type": kind}, operations=["queryTemporal"])
    asked = {"type": kind, "timerel": "after", "timeAt": "2020-01-01T00:00:00Z", "orderBy": "id"}
    answer = near.get(path, params=asked)
    assert (answer.status_code, "local=true" in answer.json()["detail"]) == (400, True)
    assert source.asked == []
    assert near.get("/temporal/entities", params={**asked, "local": "true"}).status_code == 200
