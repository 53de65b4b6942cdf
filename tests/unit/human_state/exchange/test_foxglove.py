"""A client of the Foxglove protocol receives schemas and messages, and the layout is the shipped one."""

import asyncio
import json
import struct
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import connect

pytest.importorskip("foxglove", reason="the extra [human-state] is not installed")

from services.human_state.exchange.foxglove import LAYOUT, FoxgloveServer, layout, shipped_layout
from services.human_state.formats.errors import ExchangeError
from services.human_state.model.features import Feature, FeatureName
from services.human_state.model.signals import Samples, SignalInfo, SignalKind
from tests.kit.waiting import scaled

SUBPROTOCOLS: Any = ["foxglove.sdk.v1"]
RATE = Feature(FeatureName.HEART_RATE, "h10", 92.5, 1_770_000_000.5, 0.9)
ECG = Samples(
    "h10", SignalInfo(SignalKind.ECG, "D82", 130.0), 1_770_000_000.0, np.array([[1.5], [float("nan")]])
)


async def channels(client: Any, number: int) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    while len(found) < number:
        message = json.loads(await client.recv())
        if message["op"] == "advertise":
            found |= {one["topic"]: one for one in message["channels"]}
    return found


async def publish_again_and_again(server: FoxgloveServer) -> None:
    while True:
        server.publish(RATE)
        server.publish(ECG)
        await asyncio.sleep(0.05)


async def test_a_client_subscribes_and_receives_values_and_single_samples() -> None:
    with FoxgloveServer("p-1") as server:
        server.publish(RATE)
        server.publish(ECG)
        async with (
            asyncio.timeout(scaled(120)),
            connect(f"ws://127.0.0.1:{server.port}", subprotocols=SUBPROTOCOLS) as client,
        ):
            known = await channels(client, 3)
            topics = ["/feature/heartRate/h10", "/wave/h10/ecg", "/signal/h10/ecg"]
            assert set(known) == set(topics)
            assert json.loads(known[topics[0]]["schema"])["properties"]["quality"]["maximum"] == 1
            asked = [{"id": number, "channelId": known[topic]["id"]} for number, topic in enumerate(topics)]
            await client.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
            got: dict[int, list[tuple[int, Any]]] = {}
            # The subscription counts from some moment on, so the values are sent until they arrive.
            sending = asyncio.create_task(publish_again_and_again(server))
            while len(got.get(0, [])) < 1 or len(got.get(1, [])) < 2:
                message = await client.recv()
                if isinstance(message, bytes) and message[0] == 1:
                    number, at_ns = struct.unpack_from("<IQ", message, 1)
                    got.setdefault(number, []).append((at_ns, json.loads(message[13:])))
            sending.cancel()
            assert got[0][0][0] == 1_770_000_000_500_000_000
            assert (got[0][0][1]["value"], got[0][0][1]["subject"]) == (92.5, "p-1")
            assert {(at_ns, value["values"][0]) for at_ns, value in got[1]} == {
                (1_770_000_000_000_000_000, 1.5),
                (1_770_000_000_007_692_288, None),
            }


def test_health_data_leaves_the_machine_with_tls_only() -> None:
    with pytest.raises(ExchangeError, match="certificate"):
        FoxgloveServer(host="0.0.0.0")


def test_a_port_that_is_taken_is_named() -> None:
    with FoxgloveServer() as server, pytest.raises(ExchangeError, match=str(server.port)):
        FoxgloveServer(port=server.port)


def test_the_shipped_layout_is_current() -> None:
    assert json.loads(LAYOUT.read_text()) == json.loads(shipped_layout())


def test_a_topic_with_other_characters_is_quoted() -> None:
    text = layout([("h 10", SignalKind.ECG)], [], [], "imu")
    assert '\\"/wave/h 10/ecg\\".values[0]' in text
