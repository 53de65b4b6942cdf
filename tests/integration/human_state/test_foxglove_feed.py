"""The live stream for Foxglove has what persons allow, and nothing after they withdrew their consent."""

import asyncio
import json
from types import SimpleNamespace
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect

from handover.errors import UsageError
from services.human_state.monitoring.foxglove_feed import FoxgloveFeed
from tests.integration.human_state.conftest import Running, add_person
from tests.kit.ports import next_free_port
from tests.kit.waiting import scaled, until

pytest.importorskip("foxglove", reason="the extra [human-state] is not installed")

SUBPROTOCOLS: Any = ["foxglove.sdk.v1"]
TOPIC = "/feature/heartRate/strap-aino"


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
        if isinstance(message, bytes) and message[0] == 1:
            values.append(json.loads(message[13:]))  # noqa: PERF401 - seen while it grows


async def test_a_client_gets_the_heart_rate_until_the_consent_is_withdrawn(running: Running) -> None:
    port = next_free_port()
    async with running(health_foxglove_port=port) as rest:
        made = await add_person(rest, "aino", "live")
        async with (
            asyncio.timeout(scaled(120)),
            connect(f"ws://127.0.0.1:{port}", subprotocols=SUBPROTOCOLS, proxy=None) as client,
        ):
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
            await channel_of_next(port, "/feature/heartRate/strap-eero")
            assert len(values) - known <= 1, "one value may have been on its way"
            reading.cancel()


async def channel_of_next(port: int, topic: str) -> None:
    async with connect(f"ws://127.0.0.1:{port}", subprotocols=SUBPROTOCOLS, proxy=None) as client:
        await channel_of(client, topic)


def test_a_port_that_is_used_is_named() -> None:
    feed = FoxgloveFeed(None, 0)  # type: ignore[arg-type] - nobody is followed
    try:
        with pytest.raises(UsageError, match="HANDOVER_HEALTH_FOXGLOVE_PORT"):
            FoxgloveFeed(None, feed.port)  # type: ignore[arg-type]
    finally:
        feed.close()


async def test_a_closed_feed_taps_nobody_any_more() -> None:
    monitors: dict[str, Any] = {}
    feed = FoxgloveFeed(SimpleNamespace(monitors=monitors), 0)  # type: ignore[arg-type] - what it reads
    feed.close()
    monitors["aino"] = SimpleNamespace(taps=set(), person=SimpleNamespace(pseudonym="p-1"))
    await asyncio.wait_for(feed.run(), scaled(30))
    assert monitors["aino"].taps == set()
