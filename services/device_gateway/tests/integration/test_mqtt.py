"""Devices join over a real Mosquitto, with the rights and limits of devices on TCP."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion
from sqlalchemy import Engine

from handover.database import connect
from handover.errors import Problem, UsageError
from handover.runtime.retry import MAX_DELAY_S
from handover_devices.adapters.base import ADAPTERS
from handover_devices.adapters.mqtt import MqttAdapter, MqttServer, make
from handover_devices.gateway import DeviceGateway
from handover_devices.settings import GatewaySettings
from handover_devices.storage import history
from tests.kit.certificates import Certificates
from tests.kit.device_gateways import SENSOR, background, running_gateway
from tests.kit.mosquitto import PASSWORD, Mosquitto
from tests.kit.ports import next_free_port
from tests.kit.waiting import until


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Certificates:
    return Certificates(tmp_path_factory.mktemp("certificates"))


@pytest.fixture(scope="module")
def mosquitto(tmp_path_factory: pytest.TempPathFactory, certificates: Certificates) -> Iterator[Mosquitto]:
    files = certificates.make("127.0.0.1")
    folder = tmp_path_factory.mktemp("mosquitto")
    made = Mosquitto(folder, next_free_port(), next_free_port(), (files.certificate, files.key))
    made.start()
    made.listen()
    yield made
    made.close()


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    made = connect(f"sqlite:///{tmp_path / 'devices.db'}")
    yield made
    made.dispose()


@pytest.fixture
def settings(mosquitto: Mosquitto, certificates: Certificates, tmp_path: Path) -> GatewaySettings:
    """The gateway connects with TLS, its name and its password; the topics differ in each test."""
    return GatewaySettings.load(
        device_mqtt_url=f"mqtts://cell@127.0.0.1:{mosquitto.safe_port}",
        device_mqtt_password=PASSWORD,
        device_mqtt_topic=f"plant/{tmp_path.name}",
        tls_authority=certificates.folder / "authority" / "authority.pem",
    )


class MqttDevice:
    """A device as an MQTT client; what it receives is in the list of the server."""

    def __init__(self, mosquitto: Mosquitto, settings: GatewaySettings, name: str, token: str) -> None:
        self._mosquitto = mosquitto
        self._topic = f"{settings.device_mqtt_topic}/{name}"
        self._token = token
        self._client = Client(CallbackAPIVersion.VERSION2)
        self._client.connect("127.0.0.1", mosquitto.port)
        self._client.loop_start()

    def say(self, *, retain: bool = False, **message: Any) -> None:
        """Publish a message with QoS 1."""
        payload = json.dumps({"token": self._token, **message})
        self._client.publish(f"{self._topic}/in", payload, qos=1, retain=retain).wait_for_publish(60)

    def received(self, kind: str) -> list[dict[str, Any]]:
        """Return what was published to the device."""
        return [one for one in self._mosquitto.of(f"{self._topic}/out") if one["type"] == kind]

    def stop(self) -> None:
        """Disconnect."""
        self._client.loop_stop()
        self._client.disconnect()


async def connected(adapter: MqttAdapter) -> None:
    await until(lambda: adapter.fault is None, why=lambda: str(adapter.fault))


def stored(engine: Engine, device: str = "hall-1") -> list[float]:
    series = history.series_of(engine, device)
    return [point.mean for _, point in history.every_value(engine, series, 0, 2**62)]


@pytest.mark.nightly
async def test_a_device_sends_and_is_commanded_with_its_token_only(
    mosquitto: Mosquitto, settings: GatewaySettings, engine: Engine
) -> None:
    async with running_gateway(engine, settings) as gateway:
        adapter = make(settings, gateway)
        assert adapter is not None
        token = (await gateway.add("hall-1", SENSOR)).token
        async with background(adapter.run):
            await connected(adapter)
            device = MqttDevice(mosquitto, settings, "hall-1", token)
            thief = MqttDevice(mosquitto, settings, "hall-1", "hnd_device_wrong")
            await _send_and_be_refused(device, thief, engine)
            await _be_commanded(device, gateway)
            device.say(type="hello", version=1, boot="b2")
            await until(lambda: [one for one in device.received("error") if one["code"] == "replaced"])
            thief.say(type="goodbye")
            device.say(type="goodbye", boot="b1")  # the will of a run that was replaced
            device.say(type="telemetry", seq=9, values={"temperature": 3})
            await until(lambda: {"type": "ack", "seq": 9} in device.received("ack"))
            assert gateway.devices["hall-1"].link is not None
            device.say(type="goodbye", boot="b2")
            await until(lambda: gateway.devices["hall-1"].link is None)
            with pytest.raises(Problem, match="never queued"):
                await gateway.dispatcher.order("hall-1", SENSOR, "turn", {}, timeout_s=60)
            device.stop()
            thief.stop()
        rows = history.messages(engine, "hall-1")
        assert token not in json.dumps(rows)
        presence = f"{settings.device_mqtt_topic}/gateway"
        await until(lambda: [one["online"] for one in mosquitto.of(presence)] == [True, False])


async def _send_and_be_refused(device: MqttDevice, thief: MqttDevice, engine: Engine) -> None:
    device.say(type="telemetry", seq=1, values={"temperature": 21.5})
    await until(lambda: device.received("ack") == [{"type": "ack", "seq": 1}])
    thief.say(type="telemetry", seq=2, values={"temperature": 50})
    device.say(type="telemetry", seq=3, values={"pressure": 1})
    device.say(
        type="telemetry", seq=4, values={"temperature": 1}, retain=True
    )  # accepted once, as it is sent
    device.say(type="telemetry", seq=5, t=5, values={"temperature": 1})
    await until(
        lambda: len(device.received("error")) == 3 and {"type": "ack", "seq": 4} in device.received("ack")
    )
    codes = [one["code"] for one in device.received("error")]
    assert codes == ["wrongToken", "unknownValue", "tooOld"]
    assert stored(engine) == [21.5, 1.0]


async def _be_commanded(device: MqttDevice, gateway: DeviceGateway) -> None:
    with pytest.raises(Problem, match="not connected"):
        await gateway.dispatcher.order("hall-1", SENSOR, "turn", {}, timeout_s=60)
    device.say(type="hello", version=1, boot="b1", measures=["temperature", "smoke"])
    await until(lambda: [one for one in device.received("ack") if one.get("unknown") == ["smoke"]])
    await gateway.dispatcher.order("hall-1", SENSOR, "turn", {"rad": 1}, timeout_s=60, identifier="t-1")
    (command,) = await until(lambda: device.received("command"))
    assert (command["id"], command["parameters"]) == ("t-1", {"rad": 1})
    device.say(type="ack", id="t-1", result={"rad": 1})

    async def is_done() -> bool:
        return (await gateway.dispatcher.find("hall-1", "t-1")).state == "done"

    await until(is_done)
    device.say(type="hello", version=1, boot="b1")  # repeated: the session continues
    await until(lambda: len([one for one in device.received("ack") if "time" in one]) == 2)
    assert not [one for one in device.received("error") if one["code"] == "replaced"]


async def test_a_message_that_was_not_stored_is_delivered_again(
    mosquitto: Mosquitto, settings: GatewaySettings, engine: Engine
) -> None:
    async with running_gateway(engine, settings) as gateway:
        token = (await gateway.add("hall-1", SENSOR)).token
    device = MqttDevice(mosquitto, settings, "hall-1", token)
    async with running_gateway(engine, settings, is_writing=False) as gateway:
        adapter = MqttAdapter(settings, gateway)
        async with background(adapter.run):
            await connected(adapter)
            device.say(type="telemetry", seq=2, values={"temperature": 2})
            await until(lambda: gateway.devices["hall-1"].latest)  # it has received it, and not stored it
    device.say(type="telemetry", seq=3, values={"temperature": 3})  # nobody listens now
    async with running_gateway(engine, settings) as gateway:
        adapter = MqttAdapter(settings, gateway)
        async with background(adapter.run):
            await until(lambda: stored(engine) == [2.0, 3.0], why=lambda: str(stored(engine)))
            mosquitto.stop()
            await until(lambda: adapter.fault is not None)
            mosquitto.start()
            await until(lambda: adapter.fault is None, within_s=30 + 10 * MAX_DELAY_S)
    device.stop()


async def test_a_flood_on_mqtt_is_refused_and_others_are_served(
    mosquitto: Mosquitto, settings: GatewaySettings, engine: Engine
) -> None:
    settings = settings.model_copy(update={"device_max_messages_per_s": 1.0, "device_idle_timeout_s": 0.5})
    async with running_gateway(engine, settings) as gateway:
        adapter = MqttAdapter(settings, gateway)
        tokens = [(await gateway.add(name, SENSOR)).token for name in ("hall-1", "hall-2")]
        async with background(adapter.run):
            await connected(adapter)
            flooding, other = (
                MqttDevice(mosquitto, settings, name, token)
                for name, token in zip(("hall-1", "hall-2"), tokens, strict=True)
            )
            flooding.say(type="hello", version=1, boot="b1")
            for seq in range(200):
                flooding.say(type="telemetry", seq=seq, values={"temperature": 1})
            other.say(type="telemetry", seq=1, values={"temperature": 2})
            await until(lambda: other.received("ack"))
            refused = await until(
                lambda: [one for one in flooding.received("error") if one["code"] == "tooFast"]
            )
            assert "seq" in refused[0]
            assert len(flooding.received("error")) <= 100  # and not each is answered
            await until(lambda: [one for one in flooding.received("error") if one["code"] == "idle"])
            assert gateway.devices["hall-1"].link is None
            flooding.stop()
            other.stop()


def test_the_address_of_the_server_is_checked() -> None:
    for url, fault in (
        ("http://hall:1", "no address"),
        ("mqtt://hall.example", "in clear"),
        ("mqtts://", "no address"),
        ("mqtts://hall:99999", "no address"),
    ):
        with pytest.raises(UsageError, match=fault):
            MqttServer.of(GatewaySettings.load(device_mqtt_url=url))
    server = MqttServer.of(GatewaySettings.load(device_mqtt_url="mqtts://a%40b:c%2Fd@hall"))
    assert server == MqttServer("hall", 8883, True, "a@b", "c/d")
    assert "mqtt" in ADAPTERS.names()
    assert ADAPTERS.load("mqtt") is make
    assert make(GatewaySettings.load(), None) is None  # type: ignore[arg-type]
