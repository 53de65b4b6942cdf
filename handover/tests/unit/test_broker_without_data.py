"""A broker of others that answers without its database that nothing is there: nothing counts as missing."""

import json
from typing import Any
from urllib.parse import unquote

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.broker import BrokerClient, BrokerUnavailable, NotFound
from handover.settings import Settings

LAMP = "urn:ngsi-ld:Device:demo:lamp-1"
OTHER = "urn:ngsi-ld:Device:demo:lamp-2"


class Others(httpx.AsyncBaseTransport):
    """A broker as Orion-LD 1.6, whose database goes away or comes back once, at some request."""

    def __init__(self, *, is_away: bool = False, changes_at: int = -1) -> None:
        self.entities: dict[str, dict[str, Any]] = {LAMP: {"id": LAMP, "type": "Device"}}
        self.is_away = is_away
        self._changes_in = changes_at
        self.writes = 0

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        if not request.url.path.startswith("/ngsi-ld/v1/"):
            return httpx.Response(404, json={})
        if self._changes_in == 0:
            self.is_away = not self.is_away
        self._changes_in -= 1
        return self._answer(request.method, request.url, await request.aread())

    def _answer(self, method: str, url: httpx.URL, body: bytes) -> httpx.Response:
        steps = [unquote(step) for step in url.raw_path.decode().partition("?")[0].split("/")][3:]
        there = {} if self.is_away else self.entities
        if method == "POST":
            document = json.loads(body)
            return self._create(document) if isinstance(document, dict) else _delete_each(there, document)
        if len(steps) == 1:
            found = [one for one in there.values() if one["type"] == url.params["type"]]
            headers = {"NGSILD-Results-Count": str(len(found))}
            return httpx.Response(200, json=found if int(url.params["limit"]) else [], headers=headers)
        if steps[1] not in there:
            return httpx.Response(404, json={})
        if method == "DELETE":
            del there[steps[1]]
        return httpx.Response(200, json=there.get(steps[1])) if method == "GET" else httpx.Response(204)

    def _create(self, entity: dict[str, Any]) -> httpx.Response:
        if self.is_away:
            return httpx.Response(500, json={"title": "database error"})
        if entity["id"] in self.entities:
            return httpx.Response(409, json={})
        self.writes += 1
        self.entities[entity["id"]] = entity
        return httpx.Response(201)


def _delete_each(there: dict[str, Any], ids: list[str]) -> httpx.Response:
    missing = [one for one in ids if there.pop(one, None) is None]
    errors = [{"entityId": one, "error": {"status": 404, "title": "no"}} for one in missing]
    return httpx.Response(207, json={"errors": errors}) if errors else httpx.Response(204)


def client_of(broker: Others) -> BrokerClient:
    return BrokerClient(Settings.load(_env_file=None), transport=broker)


async def read(client: BrokerClient, operation: str) -> bool:
    """Return whether the lamp is there, by one operation."""
    if operation == "query":
        return bool([one for one in await client.query(type="Device") if one["id"] == LAMP])
    if operation == "count":
        return bool(await client.count(type="Device"))
    value = {"state": {"type": "Property", "value": "on"}}
    calls = {
        "retrieve": lambda: client.retrieve(LAMP),
        "update": lambda: client.update(LAMP, value),
        "delete": lambda: client.delete(LAMP),
    }
    try:
        await calls[operation]()
    except NotFound:
        return False
    return True


OPERATIONS = ("query", "count", "retrieve", "update", "delete")


@given(st.sampled_from(OPERATIONS), st.booleans(), st.integers(-1, 6), st.booleans())
async def test_what_is_there_never_counts_as_missing(
    operation: str, is_away: bool, changes_at: int, was_asked: bool
) -> None:
    broker = Others()
    async with client_of(broker) as client:
        if was_asked:
            with pytest.raises(NotFound):
                await client.retrieve(OTHER)
        broker.is_away, broker._changes_in = is_away, changes_at
        try:
            is_there = await read(client, operation)
        except BrokerUnavailable:
            return
        assert is_there


@pytest.mark.parametrize("operation", OPERATIONS)
async def test_what_is_missing_is_missing(operation: str) -> None:
    broker = Others()
    broker.entities.clear()
    async with client_of(broker) as client:
        assert not await read(client, operation)
        assert not await read(client, operation)
    assert broker.writes == 1


async def test_a_failure_without_the_database_is_of_the_moment() -> None:
    broker = Others(is_away=True)
    async with client_of(broker) as client:
        with pytest.raises(BrokerUnavailable, match="is its database away") as raised:
            await client.create({"id": OTHER, "type": "Device"})
        assert type(raised.value) is BrokerUnavailable, "it is no fault of the request"
        broker.is_away = False
        await client.create({"id": OTHER, "type": "Device"})


async def test_a_broker_that_has_lost_its_data_is_believed() -> None:
    broker = Others()
    async with client_of(broker) as client:
        with pytest.raises(NotFound):
            await client.retrieve(OTHER)
        broker.entities.clear()
        with pytest.raises(NotFound):
            await client.retrieve(LAMP)


async def test_a_batch_of_deletions_is_not_done_without_the_database() -> None:
    broker = Others(is_away=True)
    async with client_of(broker) as client:
        with pytest.raises(BrokerUnavailable):
            await client.delete_batch([LAMP])
        broker.is_away = False
        await client.delete_batch([LAMP, OTHER])
    assert LAMP not in broker.entities
