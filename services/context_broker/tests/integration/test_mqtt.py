"""Notifications over MQTT, to a real Mosquitto (clause 7.2)."""

import asyncio
import gc
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.network.http_client import SendError
from handover.network.outbound_policy import OutboundPolicy
from handover_broker.delivery.mqtt_address import mqtt_address
from handover_broker.delivery.mqtt_sender import MqttSender
from services.context_broker.tests.integration import acts
from tests.kit.mosquitto import PASSWORD, Mosquitto

Eventually = Callable[..., Any]


@pytest.fixture(scope="module")
def mosquitto(
    tmp_path_factory: pytest.TempPathFactory, certificate: tuple[Path, Path]
) -> Iterator[Mosquitto]:
    with socket.socket() as one, socket.socket() as other:
        for probe in (one, other):
            probe.bind(("127.0.0.1", 0))
        ports = [int(probe.getsockname()[1]) for probe in (one, other)]
    made = Mosquitto(tmp_path_factory.mktemp("mosquitto"), ports[0], ports[1], certificate)
    made.start()
    made.listen()
    yield made
    made.close()


def subscribe(http: httpx.Client, kind: str, uri: str, **endpoint: Any) -> str:
    return f"/subscriptions/{acts.subscribe(http, kind, uri, notification={'endpoint': endpoint})}"


def create(http: httpx.Client, kind: str, name: str = "1", **attributes: Any) -> str:
    entity_id = f"urn:ngsi-ld:{kind}:demo:{name}"
    assert http.post("/entities", json={"id": entity_id, "type": kind, **attributes}).status_code == 201
    return entity_id


@pytest.mark.nightly
@pytest.mark.parametrize("version", ["mqtt3.1.1", "mqtt5.0"])
@pytest.mark.parametrize("qos", [0, 1, 2])
def test_a_notification_is_published_with_its_metadata(
    http: httpx.Client, mosquitto: Mosquitto, eventually: Eventually, version: str, qos: int
) -> None:
    kind = f"Mqtt{version[4]}{qos}"
    path = subscribe(
        http,
        kind,
        f"mqtt://somebody@127.0.0.1:{mosquitto.port}/cell/{kind}",
        receiverInfo=[{"key": "X-Cell", "value": "4"}],
        notifierInfo=[{"key": "MQTT-Version", "value": version}, {"key": "MQTT-QoS", "value": str(qos)}],
    )
    entity = create(http, kind, a=1)
    (message,) = eventually(lambda: mosquitto.of(f"cell/{kind}"))
    assert message["metadata"]["Content-Type"] == "application/json"
    assert "json-ld#context" in message["metadata"]["Link"]
    assert message["metadata"]["X-Cell"] == "4"
    assert message["body"]["type"] == "Notification"
    assert message["body"]["data"] == [{"id": entity, "type": kind, "a": {"type": "Property", "value": 1}}]
    assert [quality for topic, quality, _ in mosquitto.received if topic == f"cell/{kind}"] == [qos]
    # The broker counts a notification after it has been published.
    eventually(lambda: http.get(path).json()["notification"].get("timesSent") == 1)


def test_json_ld_has_its_context_in_the_body(
    http: httpx.Client, mosquitto: Mosquitto, eventually: Eventually
) -> None:
    uri = f"mqtt://127.0.0.1:{mosquitto.port}/cell/ld"
    subscribe(http, "MqttLd", uri, accept="application/ld+json")
    create(http, "MqttLd", a=1)
    (message,) = eventually(lambda: mosquitto.of("cell/ld"))
    assert message["metadata"] == {"Content-Type": "application/ld+json"}
    assert "@context" in message["body"]


def test_pending_messages_are_published_in_order_when_the_server_returns(
    http: httpx.Client, mosquitto: Mosquitto, eventually: Eventually
) -> None:
    quality = [{"key": "MQTT-QoS", "value": "1"}]
    path = subscribe(http, "MqttBack", f"mqtt://127.0.0.1:{mosquitto.port}/cell/back", notifierInfo=quality)
    entity = create(http, "MqttBack", n=0)
    eventually(lambda: mosquitto.of("cell/back"))
    mosquitto.stop()
    for number in range(1, 20):
        assert http.patch(f"/entities/{entity}/attrs", json={"n": number}).status_code == 204
    result = eventually(
        lambda: (found := http.get(path).json()["notification"]).get("timesFailed") and found,
        why="nothing failed",
    )
    assert result["status"] == "failed"
    assert http.patch(path, json={"isActive": False}).status_code == 204  # until somebody listens again
    mosquitto.start()
    assert mosquitto.is_listening.wait(120)
    assert http.patch(path, json={"isActive": True}).status_code == 204
    eventually(lambda: len({one["body"]["data"][0]["n"]["value"] for one in mosquitto.of("cell/back")}) == 20)
    values = [one["body"]["data"][0]["n"]["value"] for one in mosquitto.of("cell/back")]
    assert list(dict.fromkeys(values)) == list(range(20))


def test_an_unreachable_server_is_a_reported_failure(http: httpx.Client, eventually: Eventually) -> None:
    path = subscribe(http, "MqttNobody", "mqtt://127.0.0.1:9/topic")
    create(http, "MqttNobody", a=1)
    eventually(lambda: http.get(path).json()["notification"].get("status") == "failed")
    assert http.delete(path).status_code == 204


def test_over_tls_the_server_is_checked_and_we_say_who_we_are(
    own_broker: Any, mosquitto: Mosquitto, certificate: tuple[Path, Path], eventually: Eventually
) -> None:
    own_broker.extra = {**own_broker.extra, "HANDOVER_BROKER_NOTIFICATION_CA_FILE": str(certificate[0])}
    own_broker.start()
    server = f"127.0.0.1:{mosquitto.safe_port}/cell/safe"
    with own_broker.client() as http:
        good = subscribe(http, "MqttSafe", f"mqtts://cell:{PASSWORD}@{server}")
        bad = subscribe(http, "MqttUnsafe", f"mqtts://cell:wrong@{server}")
        create(http, "MqttSafe", a=1)
        create(http, "MqttUnsafe", a=1)
        eventually(lambda: http.get(good).json()["notification"].get("status") == "ok")
        eventually(lambda: http.get(bad).json()["notification"].get("status") == "failed")
        assert PASSWORD not in own_broker.log()
        assert "wrong@" not in own_broker.log()


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_over_tls_too_the_connection_goes_to_the_address_that_was_judged(
    mosquitto: Mosquitto, certificate: tuple[Path, Path]
) -> None:
    """Only the policy can resolve the name, by which the certificate (of another name) is checked."""

    async def publish() -> None:
        loop = asyncio.get_running_loop()
        genuine = loop.getaddrinfo

        async def resolving(host: Any, *args: Any, **kwargs: Any) -> Any:
            return await genuine("127.0.0.1" if host == "cell.invalid" else host, *args, **kwargs)

        loop.getaddrinfo = resolving  # type: ignore[method-assign]  # stands for the name server
        sender = MqttSender(OutboundPolicy(), certificate[:1])
        uri = f"mqtts://cell:{PASSWORD}@cell.invalid:{mosquitto.safe_port}/cell/named"
        try:
            await sender.publish(mqtt_address(uri, ()), b"{}", 20)
        finally:
            await sender.close()

    with pytest.raises(SendError, match=r"certificate is not valid for .*cell\.invalid"):
        asyncio.run(publish())
    gc.collect()  # the library leaves the socket of a failed handshake to it, which warns
