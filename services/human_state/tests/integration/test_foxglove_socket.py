"""The live stream for Foxglove: for those who may read, with what persons allow, and nothing afterwards."""

import asyncio
import json
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from handover.security.permissions import Grant, Role
from handover_body.routes.foxglove_socket import MAX_CLIENTS
from services.human_state.tests.integration.conftest import Running, add_person, token_of
from tests.kit.ports import next_free_port
from tests.kit.waiting import scaled, until

SUBPROTOCOLS: Any = ["foxglove.sdk.v1"]
TOPIC = "/feature/heartRate/strap-aino"


def foxglove(port: int, token: str = "") -> connect:
    url = f"ws://127.0.0.1:{port}/foxglove{'?token=' * bool(token)}{token}"
    return connect(url, subprotocols=SUBPROTOCOLS, proxy=None)


async def channel_of(client: ClientConnection, topic: str) -> int:
    """Return the id of a topic, as the server advertises it."""
    while True:
        message = await client.recv()
        found = json.loads(message) if isinstance(message, str) else {}
        for one in found.get("channels", ()) if found.get("op") == "advertise" else ():
            if one["topic"] == topic:
                return int(one["id"])


async def values_of(client: ClientConnection, values: list[dict[str, Any]]) -> None:
    async for message in client:
        if isinstance(message, bytes):
            values.append(json.loads(message[13:]))  # noqa: PERF401 - seen while it grows


@pytest.mark.nightly
async def test_a_client_gets_the_heart_rate_until_the_consent_is_withdrawn(running: Running) -> None:
    port = next_free_port()
    async with running(port=port) as rest:
        made = await add_person(rest, "aino", "live")
        async with asyncio.timeout(scaled(120)), foxglove(port) as client:
            assert client.subprotocol == SUBPROTOCOLS[0]
            channel = await channel_of(client, TOPIC)
            asked = {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel}]}
            await client.send(json.dumps(asked))
            values: list[dict[str, Any]] = []
            reading = asyncio.create_task(values_of(client, values))
            await until(lambda: len(values) > 3)
            assert {each["subject"] for each in values} == {made["pseudonym"]}
            assert 30 < values[-1]["value"] < 220

            (await rest.delete("/people/aino/consent")).raise_for_status()
            known = len(values)
            other = await add_person(rest, "eero", "live")
            assert other["pseudonym"] != made["pseudonym"]
            async with foxglove(port) as second:
                await channel_of(second, "/feature/heartRate/strap-eero")
            assert len(values) - known <= 1, "one value may have been on its way"
            reading.cancel()


async def test_with_accounts_the_token_in_the_address_decides(running: Running) -> None:
    port = next_free_port()
    async with running(port=port, grants=(Grant(Role.ENGINEER), Grant(Role.RESEARCHER))) as rest:
        await add_person(rest, "aino", "live")
        async with asyncio.timeout(scaled(120)):
            for token in ("", "no-token", token_of(Grant(Role.ENGINEER))):
                with pytest.raises(InvalidStatus) as refused:
                    await foxglove(port, token)
                assert refused.value.response.status_code == 403
            async with foxglove(port, token_of(Grant(Role.RESEARCHER))) as client:
                await channel_of(client, TOPIC)


async def test_other_clients_and_too_many_get_the_reason(running: Running) -> None:
    port = next_free_port()
    async with asyncio.timeout(scaled(120)), running(port=port):
        async with connect(f"ws://127.0.0.1:{port}/foxglove", proxy=None) as other:
            with pytest.raises(ConnectionClosed, match=r"foxglove\.sdk\.v1"):
                await other.recv()
        clients = [await foxglove(port) for _ in range(MAX_CLIENTS)]
        for client in clients:
            await client.recv()
        async with foxglove(port) as one_too_many:
            with pytest.raises(ConnectionClosed, match="clients are connected"):
                await one_too_many.recv()
        for client in clients:
            await client.close()
