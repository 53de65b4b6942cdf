"""The strict broker before our real broker: each rule is there, and a profile without it has the ability."""

import asyncio
import json
import os
import signal
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient, BrokerUnavailable
from handover.settings import Settings
from services.context_broker.tests.integration.conftest import BrokerProcess, Subscriber
from tests.kit.asgi_server import served
from tests.kit.other_broker.abilities import NOT_PROBED, PROBES, abilities, has_ability, value
from tests.kit.other_broker.profiles import ORION_LD, PLAIN, RULES, Profile
from tests.kit.other_broker.strict_broker import DATABASE_AWAY, StrictBroker
from tests.kit.ports import next_free_port
from tests.kit.waiting import until

pytestmark = pytest.mark.slow

ID = "urn:ngsi-ld:Thing:demo:1"
AttributeNames = list[str]


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BrokerProcess]:
    made = BrokerProcess(tmp_path_factory.mktemp("broker")).start()
    yield made
    made.stop()


@pytest.fixture
def subscriber() -> Iterator[Subscriber]:
    made = Subscriber()
    yield made
    made.stop()


class Front:
    """A strict broker, and a client of it in a tenant of its own."""

    def __init__(self, app: StrictBroker, url: str, tenant: str) -> None:
        self.app, self.url, self.tenant = app, url, tenant
        self.http = httpx.AsyncClient(
            base_url=f"{url}/ngsi-ld/v1", headers={"NGSILD-Tenant": tenant}, timeout=120, trust_env=False
        )

    async def upsert(self, *entities: dict[str, Any]) -> httpx.Response:
        return await self.http.post("/entityOperations/upsert", params={"options": "update"}, json=entities)


@asynccontextmanager
async def front(
    broker: BrokerProcess,
    folder: Path,
    profile: Profile = ORION_LD,
    *,
    port: int = 0,
    tenant: str = "",
) -> AsyncIterator[Front]:
    port = port or next_free_port()
    url = f"http://127.0.0.1:{port}"
    app = StrictBroker(profile, broker.url, folder, url, tenant=tenant)
    async with served(app, port):
        made = Front(app, url, folder.name.replace("-", "_"))
        async with made.http:
            try:
                yield made
            finally:
                app.close()


@pytest.fixture
async def strict(broker: BrokerProcess, tmp_path: Path) -> AsyncIterator[Front]:
    async with front(broker, tmp_path) as made:
        yield made


def probed(made: Front, name: str) -> Callable[[], bool]:
    def ask() -> bool:
        headers = {"NGSILD-Tenant": made.tenant}
        base = f"{made.url}/ngsi-ld/v1/"
        with httpx.Client(base_url=base, headers=headers, timeout=120, trust_env=False) as http:
            return has_ability(http, name)

    return ask


@pytest.mark.nightly
@pytest.mark.parametrize("name", PROBES)
async def test_each_rule_takes_its_ability_away(broker: BrokerProcess, tmp_path: Path, name: str) -> None:
    async with front(broker, tmp_path) as made:
        assert not await asyncio.to_thread(probed(made, name))
    async with front(broker, tmp_path, ORION_LD.without(name)) as made:
        assert await asyncio.to_thread(probed(made, name))


async def test_a_plain_profile_takes_nothing_away(broker: BrokerProcess, tmp_path: Path) -> None:
    async with front(broker, tmp_path, PLAIN) as made:
        found = await asyncio.to_thread(partial(abilities, made.url, tenant=made.tenant))
    assert found == dict.fromkeys(PROBES, True) | dict.fromkeys(NOT_PROBED)
    assert found.keys() == RULES.keys()


async def test_what_is_known_of_a_version_counts_where_no_probe_is_sent(strict: Front) -> None:
    found = await asyncio.to_thread(partial(abilities, strict.url, tenant=strict.tenant))
    assert found == dict.fromkeys(RULES, False)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("sent", "read"),
    [
        (2147483648, -2147483648),
        (1764408000000, -823558656),
        (2147483647, 2147483647),
        (-2147483649, 2147483647),
        (1764408000000.0, 1764408000000.0),
        (True, True),
        ({"at": [2147483648, 1]}, {"at": [-2147483648, 1]}),
        ([5], 5),
        ({"steps": [{"id": "a"}]}, {"steps": {"id": "a"}}),
        ([], []),
        ([1, 2], [1, 2]),
    ],
)
@pytest.mark.parametrize("way", ["create", "upsert", "update", "attribute"])
async def test_values_are_damaged_on_each_way(strict: Front, sent: Any, read: Any, way: str) -> None:
    entity = {"id": ID, "type": "Thing", "n": value(sent)}
    if way == "create":
        (await strict.http.post("/entities", json=entity)).raise_for_status()
    elif way == "upsert":
        (await strict.upsert(entity)).raise_for_status()
    else:
        (await strict.upsert({**entity, "n": value(0)})).raise_for_status()
        path, body = f"/entities/{ID}/attrs", {"n": value(sent)}
        if way == "attribute":
            path, body = f"{path}/n", value(sent)
        (await strict.http.patch(path, json=body)).raise_for_status()
    stored = (await strict.http.get(f"/entities/{ID}")).json()["n"]["value"]
    assert (stored, type(stored)) == (read, type(read))


async def test_a_damaged_value_is_what_queries_and_subscribers_get(
    strict: Front, subscriber: Subscriber
) -> None:
    subscription = {
        "type": "Subscription",
        "entities": [{"type": "Thing"}],
        "notification": {"endpoint": {"uri": subscriber.url, "accept": "application/json"}},
    }
    (await strict.http.post("/subscriptions", json=subscription)).raise_for_status()
    await strict.upsert({"id": ID, "type": "Thing", "n": value(2147483648)})
    await until(subscriber.entities)
    assert subscriber.entities()[0]["n"]["value"] == -2147483648
    found = await strict.http.get("/entities", params={"type": "Thing", "q": "n<0", "count": "true"})
    assert found.headers["NGSILD-Results-Count"] == "1"
    assert found.headers["NGSILD-Tenant"] == strict.tenant


async def test_instances_in_a_batch_spoil_an_entity_for_ever(broker: BrokerProcess, tmp_path: Path) -> None:
    twice = [value(1), {**value(2), "datasetId": "urn:ngsi-ld:dataset:b"}]
    entity = {"id": ID, "type": "Thing", "n": twice}
    async with front(broker, tmp_path) as made:
        other = {"id": f"{ID}0", "type": "Other", "n": value(1)}
        answer = await made.upsert(entity, other)
        assert answer.status_code == 207
        ((error),) = answer.json()["errors"]
        assert (error["entityId"], error["error"]["status"]) == (ID, 501)
        assert answer.json()["success"] == [f"{ID}0"]
        assert (await made.http.get(f"/entities/{ID}0")).is_success
        (await made.http.post("/entities", json=entity)).raise_for_status()
        assert len((await made.http.get(f"/entities/{ID}")).json()["n"]) == 2
        assert (await made.upsert(entity)).status_code == 500
        for _ in range(2):
            assert (await made.http.get(f"/entities/{ID}")).status_code == 500
            assert (await made.http.get("/entities", params={"type": "Thing"})).status_code == 500
            assert (await made.http.get("/entities", params={"type": "Other"})).is_success
    async with front(broker, tmp_path) as made:  # after a restart
        assert (await made.http.get(f"/entities/{ID}")).status_code == 500
        assert (await made.http.delete(f"/entities/{ID}")).is_success
    async with front(broker, tmp_path, ORION_LD.without("batch-instances")) as made:
        assert (await made.upsert(entity)).is_success
        assert len((await made.http.get(f"/entities/{ID}")).json()["n"]) == 2


async def test_refused_entities_of_a_batch_are_named_beside_the_others(strict: Front) -> None:
    entities = [{"id": f"{ID}-{name}", "type": "Thing", name: value("x")} for name in ("start", "m", "end")]
    answer = await strict.upsert(*entities)
    assert answer.status_code == 207
    assert [(one["entityId"], one["error"]["status"]) for one in answer.json()["errors"]] == [
        (f"{ID}-start", 400),
        (f"{ID}-end", 400),
    ]
    assert answer.json()["success"] == [f"{ID}-m"]
    alone = await strict.upsert(entities[0])
    assert (alone.status_code, alone.json()["success"]) == (207, [])
    single = await strict.http.post("/entities", json=entities[0])
    assert (single.status_code, single.json()["type"]) == (
        400,
        "https://uri.etsi.org/ngsi-ld/errors/BadRequestData",
    )


@pytest.mark.parametrize("new", [["m"], ["m", "o"]])
@pytest.mark.parametrize("present", [[], ["n"]])
async def test_new_attributes_of_a_patch_are_reported_in_another_form(
    strict: Front, present: AttributeNames, new: AttributeNames
) -> None:
    await strict.upsert({"id": ID, "type": "Thing", "n": value(1)})
    change = {name: value(2) for name in (*present, *new)}
    answer = await strict.http.patch(f"/entities/{ID}/attrs", json=change)
    assert answer.status_code == 207
    (undone,) = answer.json()["notUpdated"]
    assert undone.keys() == {"statusCode", "title", "attributes"}
    assert undone["attributes"] == new
    assert answer.json()["updated"] == present
    stored = (await strict.http.get(f"/entities/{ID}")).json()
    assert stored["n"]["value"] == (2 if present else 1)
    assert stored.keys() == {"id", "type", "n"}
    missing = await strict.http.patch("/entities/urn:ngsi-ld:Thing:demo:none/attrs", json=change)
    assert missing.status_code == 404


async def test_without_its_database_it_answers_as_if_nothing_were_there(strict: Front) -> None:
    await strict.upsert({"id": ID, "type": "Thing", "n": value(1)})
    switch = strict.app.folder / DATABASE_AWAY
    switch.touch()
    listed = await strict.http.get("/entities", params={"type": "Thing", "count": "true"})
    assert (listed.status_code, listed.json(), listed.headers["NGSILD-Results-Count"]) == (200, [], "0")
    assert (await strict.http.get(f"/entities/{ID}")).status_code == 404
    assert (await strict.http.patch(f"/entities/{ID}/attrs", json={"n": value(2)})).status_code == 404
    assert (await strict.upsert({"id": ID, "type": "Thing", "n": value(2)})).status_code == 500
    switch.unlink()
    listed = await strict.http.get("/entities", params={"type": "Thing", "count": "true"})
    assert (len(listed.json()), listed.headers["NGSILD-Results-Count"]) == (1, "1")


async def test_the_second_of_two_creations_at_once_is_an_error(broker: BrokerProcess, strict: Front) -> None:
    entity = {"id": ID, "type": "Thing", "n": value(1)}
    assert broker.process is not None
    os.kill(broker.process.pid, signal.SIGSTOP)
    try:
        first = asyncio.create_task(strict.http.post("/entities", json=entity))
        await until(lambda: ID in strict.app.creating)
        assert (await strict.http.post("/entities", json=entity)).status_code == 500
    finally:
        os.kill(broker.process.pid, signal.SIGCONT)
    assert (await first).status_code == 201
    assert (await strict.http.post("/entities", json=entity)).status_code == 409


CONTEXT = "https://example.org/"


def link(url: str) -> dict[str, str]:
    return {"Link": f'<{url}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'}


async def test_a_context_lasts_for_ever_unless_it_is_reloaded(
    broker: BrokerProcess, tmp_path: Path, subscriber: Subscriber
) -> None:
    port = next_free_port()

    async def name_of(made: Front) -> str:
        """Return the IRI to which the broker expands the term `n`."""
        await made.http.delete(f"/entities/{ID}")
        entity = {"id": ID, "type": "Thing", "n": value(1)}
        (await made.http.post("/entities", json=entity, headers=link(subscriber.url))).raise_for_status()
        compact = await made.http.get(f"/entities/{ID}", headers=link(subscriber.url))
        assert compact.json()["n"]["value"] == 1
        assert subscriber.url in compact.headers["Link"]
        (iri,) = (await made.http.get(f"/entities/{ID}")).json().keys() - {"id", "type"}
        return str(iri)

    subscriber.document = {"@context": {"n": f"{CONTEXT}first"}}
    async with front(broker, tmp_path, port=port) as made:
        assert await name_of(made) == f"{CONTEXT}first"
        subscriber.document = {"@context": {"n": f"{CONTEXT}second"}}
        assert await name_of(made) == f"{CONTEXT}first"
    async with front(broker, tmp_path, port=port) as made:
        assert await name_of(made) == f"{CONTEXT}first"
        assert (
            await made.http.delete(f"/jsonldContexts/{subscriber.url}", params={"reload": "true"})
        ).status_code == 204
        assert await name_of(made) == f"{CONTEXT}second"


@pytest.mark.parametrize("wrong", [{"@version": 1.1}, {"n": None}, {"@protected": True}])
async def test_a_context_with_other_values_than_texts_and_objects_is_refused(
    strict: Front, subscriber: Subscriber, wrong: dict[str, Any]
) -> None:
    subscriber.document = {"@context": [{"m": f"{CONTEXT}m"}, wrong]}
    for answer in (
        await strict.http.get("/entities", params={"type": "Thing"}, headers=link(subscriber.url)),
        await strict.http.post(
            "/entities",
            content=json.dumps({"id": ID, "type": "Thing", "@context": [subscriber.url]}),
            headers={"Content-Type": "application/ld+json"},
        ),
    ):
        assert (answer.status_code, answer.json()["title"]) == (400, "Invalid key-value in @context")
    subscriber.document = {"@context": {"m": {"@id": f"{CONTEXT}m", "@type": "DateTime"}}}
    entity = {"id": ID, "type": "Thing", "m": value("2026-01-01T12:00:00Z")}
    assert (await strict.http.post("/entities", json=entity, headers=link(subscriber.url))).is_success


async def test_a_context_that_cannot_be_loaded_is_an_error(strict: Front) -> None:
    nowhere = link("http://127.0.0.1:9/context.jsonld")
    assert (await strict.http.get("/entities", params={"type": "Thing"}, headers=nowhere)).status_code == 503


async def test_its_version_is_that_of_its_profile(strict: Front) -> None:
    answer = await strict.http.get(f"{strict.url}/ngsi-ld/ex/v1/version")
    assert answer.json()["orionld version"] == "1.6.0"


async def test_tenants_of_the_client_are_inside_the_tenant_of_the_cell(
    broker: BrokerProcess, tmp_path: Path
) -> None:
    entity = {"id": ID, "type": "Thing", "n": value(1)}
    (tmp_path / "a").mkdir()
    async with (
        front(broker, tmp_path, PLAIN, tenant=f"own_{tmp_path.name[-1]}a") as first,
        front(broker, tmp_path / "a", PLAIN, tenant=f"own_{tmp_path.name[-1]}b") as second,
    ):
        created = await first.http.post("/entities", json=entity)
        assert created.headers["NGSILD-Tenant"] == first.tenant
        assert created.headers["Location"] == f"/ngsi-ld/v1/entities/{ID}"
        for made in (first, second):
            for tenant in (made.tenant, "line-2"):
                found = await made.http.get(f"/entities/{ID}", headers={"NGSILD-Tenant": tenant})
                assert found.is_success == (made is first and tenant == first.tenant)


async def test_a_broker_that_is_away_is_unavailable(broker: BrokerProcess, tmp_path: Path) -> None:
    away = BrokerProcess(tmp_path)
    async with front(away, tmp_path) as made, BrokerClient(Settings.load(broker_url=made.url)) as client:
        with pytest.raises(BrokerUnavailable):
            await client.probe()
