"""A client of the Foxglove protocol receives schemas and messages, and the layout is the shipped one."""

import asyncio
import json
import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import connect

pytest.importorskip("foxglove", reason="the extra [human-state] is not installed")

import foxglove as sdk

from handover_body.exchange.foxglove import (
    LAYOUT,
    MAX_WAITING,
    FoxgloveStream,
    layout,
    shipped_layout,
)
from handover_body.formats.json_messages import SCHEMAS, time_of, to_json
from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import Samples, SignalInfo, SignalKind
from tests.kit.waiting import scaled

SUBPROTOCOLS: Any = ["foxglove.sdk.v1"]
RATE = Feature(FeatureName.HEART_RATE, "h10", 92.5, 1_770_000_000.5, 0.9)
ECG = Samples(
    "h10", SignalInfo(SignalKind.ECG, "D82", 130.0), 1_770_000_000.0, np.array([[1.5], [float("nan")]])
)


def subscribe(**channel_of: int) -> str:
    asked = [{"id": int(name[1:]), "channelId": channel} for name, channel in channel_of.items()]
    return json.dumps({"op": "subscribe", "subscriptions": asked})


def texts_of(stream: FoxgloveStream) -> list[dict[str, Any]]:
    return [json.loads(one) for one in stream.take() if isinstance(one, str)]


def data_of(stream: FoxgloveStream) -> list[tuple[int, int, Any]]:
    return [
        (*struct.unpack_from("<IQ", one, 1), json.loads(one[13:]))
        for one in stream.take()
        if isinstance(one, bytes)
    ]


def test_a_client_subscribes_and_receives_values_and_single_samples() -> None:
    stream = FoxgloveStream()
    stream.publish(RATE, "p-1")
    stream.publish(ECG, "p-1")
    info, *advertised = texts_of(stream)
    assert (info["op"], info["capabilities"]) == ("serverInfo", [])
    known = {one["topic"]: one for message in advertised for one in message["channels"]}
    topics = ["/feature/heartRate/h10", "/signal/h10/ecg", "/wave/h10/ecg"]
    assert list(known) == topics
    assert json.loads(known[topics[0]]["schema"])["properties"]["quality"]["maximum"] == 1
    stream.publish(RATE, "p-1")
    assert stream.take() == [], "nobody has subscribed"
    stream.receive(subscribe(_7=known[topics[0]]["id"], _8=known[topics[2]]["id"]))
    stream.publish(RATE, "p-1")
    stream.publish(ECG, "p-1")
    (rate, *samples) = data_of(stream)
    assert rate[:2] == (7, 1_770_000_000_500_000_000)
    assert (rate[2]["value"], rate[2]["subject"]) == (92.5, "p-1")
    assert [(number, at_ns, value["values"]) for number, at_ns, value in samples] == [
        (8, 1_770_000_000_000_000_000, [1.5]),
        (8, 1_770_000_000_007_692_288, [None]),
    ]
    stream.receive('{"op": "unsubscribe", "subscriptionIds": [7, 99]}')
    stream.publish(RATE, "p-1")
    assert stream.take() == []


async def test_it_is_the_protocol_of_the_server_of_the_sdk() -> None:
    """Both are given the same item, and send the same but for ids."""
    stream, context = FoxgloveStream(), sdk.Context()
    server = sdk.start_server(name="Handover human state", port=0, context=context)
    schema = SCHEMAS["handover.Feature"] | {"title": "handover.Feature"}
    channel = sdk.Channel("/feature/heartRate/h10", schema=schema, message_encoding="json", context=context)
    stream.publish(RATE, "p-1")
    own_info, own_advertise = texts_of(stream)
    own_channel = own_advertise["channels"][0].pop("id")
    url = f"ws://127.0.0.1:{server.port}"
    try:
        async with (
            asyncio.timeout(scaled(120)),
            connect(url, subprotocols=SUBPROTOCOLS, proxy=None) as client,
        ):
            info, advertise = json.loads(await client.recv()), json.loads(await client.recv())
            assert info.keys() - own_info.keys() == set()
            assert {info["op"], info["name"]} == {own_info["op"], own_info["name"]}
            theirs = advertise["channels"][0].pop("id")
            assert json.loads(advertise["channels"][0].pop("schema")) == json.loads(
                own_advertise["channels"][0].pop("schema")
            )
            assert advertise == own_advertise
            await client.send(subscribe(_3=theirs))
            stream.receive(subscribe(_3=own_channel))
            stream.publish(RATE, "p-1")
            (own,) = data_of(stream)
            sending = asyncio.create_task(log_again_and_again(channel))
            message = await client.recv()
            sending.cancel()
            assert isinstance(message, bytes)
            assert message[0] == 1
            assert (*struct.unpack_from("<IQ", message, 1), json.loads(message[13:])) == own
    finally:
        server.stop()


async def log_again_and_again(channel: Any) -> None:
    """The subscription counts from some moment on, so the value is sent until it arrives."""
    while True:
        channel.log(to_json(RATE, "p-1"), log_time=round(time_of(RATE) * 1e9))
        await asyncio.sleep(0.05)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "17",
        '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": [{"id": "x", "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": 4294967296, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 2}]}',
        '{"op": "unsubscribe", "subscriptionIds": [null]}',
    ],
)
def test_what_cannot_be_read_is_answered_by_a_status(text: str) -> None:
    stream = FoxgloveStream()
    stream.publish(RATE, "p-1")
    stream.take()
    stream.receive(text)
    (status,) = texts_of(stream)
    assert (status["op"], status["level"]) == ("status", 2)
    stream.receive('{"op": "getParameters", "parameterNames": []}')
    stream.publish(RATE, "p-1")
    assert stream.take() == []


def test_what_a_slow_client_does_not_take_is_bounded_and_can_be_forgotten() -> None:
    stream = FoxgloveStream()
    stream.publish(RATE, "p-1")
    stream.receive(subscribe(_1=1))
    for number in range(MAX_WAITING + 10):
        stream.publish(replace(RATE, at_s=float(number)), "p-1")
    waiting = [value["at_s"] for _, _, value in data_of(stream)]
    assert waiting == [float(number) for number in range(10, MAX_WAITING + 10)]
    stream.publish(RATE, "p-1")
    stream.drop_waiting()
    assert stream.take() == []


def test_the_shipped_layout_is_current() -> None:
    assert json.loads(LAYOUT.read_text()) == json.loads(shipped_layout())


def test_a_topic_with_other_characters_is_quoted() -> None:
    text = layout([("h 10", SignalKind.ECG)], [], [], "imu")
    assert '\\"/wave/h 10/ecg\\".values[0]' in text
