"""Devices on MQTT: the protocol of the gateway in two topics for each device.

    handover/NAME/in    from the device: hello, telemetry, state, event, ack, error, goodbye
    handover/NAME/out   to the device: ack, error, command
    handover/gateway    retained: {"online": true, "since": …}; devices send their hello again when it changes

A payload is one line of the protocol. An MQTT server does not say who has published, so each payload has the
`token` of the device, which is removed before anything is stored. A hello is needed for commands only.

Durability: the session at the server is persistent, with QoS 1, and a message is acknowledged (PUBACK) after
it is stored. What the server has accepted from a device therefore survives `kill -9` of the gateway.

Commands have QoS 0 and expire with their deadline: a server queues those of QoS 1 for a device that is away,
and would deliver a motion later. The dispatcher repeats what may be repeated.

Bounds: the server sends at most `MAX_UNACKNOWLEDGED` messages of QoS 1 ahead, and while the database is
behind none is read. One device cannot be read more slowly than the others, so what exceeds its rate is
refused with the code `tooFast`, and the device sends it again.
"""

import asyncio
import math
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import unquote, urlsplit

import orjson

from handover.errors import UsageError
from handover.network.outbound_policy import is_loopback
from handover.network.tls_trust import client_context
from handover.runtime.retry import Backoff
from handover.telemetry import get_logger
from handover_devices import metrics
from handover_devices.gateway import DeviceGateway, Session
from handover_devices.protocol.messages import MAX_LINE_BYTES, BadMessage, parse_hello
from handover_devices.protocol.rates import DeviceRates, TokenBucket
from handover_devices.refusals import HelloRefused, WrongToken
from handover_devices.registry.device import Device
from handover_devices.settings import GatewaySettings

if TYPE_CHECKING:
    from aiomqtt import Client, Message

log = get_logger(__name__)

MAX_UNACKNOWLEDGED: Final = 500
MAX_WAITING_QOS_0: Final = 2_000
"""Messages of QoS 0 that wait to be processed; more are dropped, as QoS 0 allows."""
MAX_OUTGOING: Final = 10_000
MAX_PACKET_BYTES: Final = MAX_LINE_BYTES + 4096
REFUSALS_PER_S: Final = 20.0
"""Answers a second to messages with a wrong token, of all names."""
CHECK_S: Final = 1.0
KEEP_ALIVE_S: Final = 15
MAX_RECONNECT_S: Final = 15.0
FULL_WAIT_S: Final = 0.05
GOODBYE_TIMEOUT_S: Final = 1.0
OFFLINE: Final = b'{"online":false}'


@dataclass(frozen=True, slots=True)
class MqttServer:
    """Where the MQTT server is, and as whom the gateway connects."""

    host: str
    port: int
    is_tls: bool
    username: str | None
    password: str | None

    @classmethod
    def of(cls, settings: GatewaySettings) -> "MqttServer":
        """Return the server of HANDOVER_DEVICE_MQTT_URL; raise `UsageError`."""
        url = settings.device_mqtt_url or ""
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError:
            host, port, parts = None, None, urlsplit("")
        if parts.scheme not in {"mqtt", "mqtts"} or not host or parts.path not in {"", "/"}:
            raise UsageError(
                "HANDOVER_DEVICE_MQTT_URL is no address of an MQTT server; write mqtts://user@host:8883, or "
                "mqtt://127.0.0.1:1883 for one on this machine"
            )
        is_tls = parts.scheme == "mqtts"
        if not (is_tls or settings.device_plain or is_loopback(host)):
            raise UsageError(
                f"the tokens of devices would be sent in clear to {host}; use mqtts:// in "
                "HANDOVER_DEVICE_MQTT_URL, or set HANDOVER_DEVICE_PLAIN=true in a network that is trusted"
            )
        secret = settings.device_mqtt_password
        password = secret.get_secret_value() if secret is not None else parts.password
        return cls(
            host,
            port or (8883 if is_tls else 1883),
            is_tls,
            unquote(parts.username) if parts.username else None,
            unquote(password) if password and secret is None else password,
        )


def make(settings: GatewaySettings, gateway: DeviceGateway) -> "MqttAdapter | None":
    """Return the adapter if HANDOVER_DEVICE_MQTT_URL is set."""
    return MqttAdapter(settings, gateway) if settings.device_mqtt_url else None


class MqttLink:
    """The connection of a device over the MQTT server."""

    def __init__(self, adapter: "MqttAdapter", name: str, now_s: float) -> None:
        self.boot = ""
        self.active_s = now_s
        self.session: Session | None = None
        self._adapter = adapter
        self._name = name

    def send(self, message: Mapping[str, Any]) -> None:
        """Publish a message; a command expires with its deadline."""
        self._adapter.put(self._name, message, expires_s=message.get("remaining"))

    def send_latest(self, message: Mapping[str, Any]) -> bool:  # noqa: ARG002
        """Return False: what is published may wait in the server."""
        return False

    def end(self, code: str, reason: str, *, retry: bool) -> None:
        """Publish why the session has ended."""
        self._adapter.forget(self._name, self)
        error = {"type": "error", "code": code, "reason": reason, "retry": retry, "boot": self.boot}
        self._adapter.put(self._name, error)


class MqttAdapter:
    """Serves devices over one connection to an MQTT server; run `run` as a task."""

    def __init__(
        self,
        settings: GatewaySettings,
        gateway: DeviceGateway,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.fault: str | None = "not connected yet"
        self.links: dict[str, MqttLink] = {}
        self._server = MqttServer.of(settings)
        self._settings = settings
        self._gateway = gateway
        self._clock = clock
        self._prefix = settings.device_mqtt_topic
        self._rates: dict[str, DeviceRates] = {}
        self._refusals = TokenBucket.full(REFUSALS_PER_S, REFUSALS_PER_S, clock())
        self._outgoing: asyncio.Queue[tuple[str, bytes, int | None]] = asyncio.Queue(MAX_OUTGOING)

    async def run(self) -> None:
        """Serve until cancelled; connect again with backoff."""
        from aiomqtt import MqttError  # noqa: PLC0415 - takes time to load

        backoff = Backoff(max_s=MAX_RECONNECT_S)
        while True:
            try:
                await self._serve(backoff)
            except* (MqttError, OSError, TimeoutError) as errors:
                self.fault = str(errors.exceptions[0]) or type(errors.exceptions[0]).__name__
                log.warning("MQTT server unavailable", host=self._server.host, error=self.fault)
            finally:
                metrics.ADAPTER_CONNECTED.labels("mqtt").set(0)
                self._end_sessions()
            await backoff.wait()

    def put(self, name: str, message: Mapping[str, Any], *, expires_s: float | None = None) -> None:
        """Publish a message to a device soon; drop it if too many wait."""
        expires = None if expires_s is None else max(math.ceil(expires_s), 1)
        try:
            self._outgoing.put_nowait((f"{self._prefix}/{name}/out", orjson.dumps(message), expires))
        except asyncio.QueueFull:
            metrics.MESSAGES_REFUSED.labels("outgoingFull").inc()

    def forget(self, name: str, link: MqttLink) -> None:
        """Forget a session that has ended, unless a newer one has replaced it."""
        if self.links.get(name) is link:
            del self.links[name]

    async def _serve(self, backoff: Backoff) -> None:
        async with self._new_client() as client, self._presence(client), asyncio.TaskGroup() as group:
            self.fault = None
            backoff.reset()
            metrics.ADAPTER_CONNECTED.labels("mqtt").set(1)
            log.info("MQTT server connected", host=self._server.host, port=self._server.port)
            group.create_task(self._publish(client))
            group.create_task(self._check_idle())
            async for message in client.messages:
                while self._gateway.writer.is_full:  # noqa: ASYNC110 - rare, and there is no event for it
                    await asyncio.sleep(FULL_WAIT_S)
                self._process(client, message)

    @asynccontextmanager
    async def _presence(self, client: "Client") -> AsyncIterator[None]:
        """Subscribe, and publish that the gateway is online, and at the end that it is not."""
        from aiomqtt import MqttError  # noqa: PLC0415 - takes time to load

        await client.subscribe(f"{self._prefix}/+/in", qos=1)
        topic = f"{self._prefix}/gateway"
        online = orjson.dumps({"online": True, "since": time.time()})
        await client.publish(topic, online, qos=1, retain=True)
        try:
            yield
        finally:
            with suppress(MqttError):  # the server publishes the will if the connection is broken
                await client.publish(topic, OFFLINE, qos=1, retain=True, timeout=GOODBYE_TIMEOUT_S)

    def _new_client(self) -> "Client":
        from aiomqtt import Client, ProtocolVersion, Will  # noqa: PLC0415 - takes time to load
        from paho.mqtt.packettypes import PacketTypes  # noqa: PLC0415
        from paho.mqtt.properties import Properties  # noqa: PLC0415

        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.SessionExpiryInterval = int(self._settings.device_max_age_h * 3600)
        properties.ReceiveMaximum = MAX_UNACKNOWLEDGED
        properties.MaximumPacketSize = MAX_PACKET_BYTES
        server = self._server
        client = Client(
            server.host,
            server.port,
            username=server.username,
            password=server.password,
            identifier=f"{self._prefix.replace('/', '-')}-gateway-{self._settings.factory}",
            protocol=ProtocolVersion.V5,
            clean_start=False,
            properties=properties,
            keepalive=KEEP_ALIVE_S,
            will=Will(f"{self._prefix}/gateway", OFFLINE, qos=1, retain=True),
            queue_type=_IncomingQueue,
            tls_context=client_context(self._settings.tls_authority) if server.is_tls else None,
        )
        # aiomqtt acknowledges a message before it is processed; its client of paho can leave that to us.
        client._client.manual_ack_set(True)
        return client

    async def _publish(self, client: "Client") -> None:
        from paho.mqtt.packettypes import PacketTypes  # noqa: PLC0415 - takes time to load
        from paho.mqtt.properties import Properties  # noqa: PLC0415

        while True:
            topic, payload, expires_s = await self._outgoing.get()
            properties = None
            if expires_s is not None:
                properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
                properties.MessageExpiryInterval = expires_s
            await client.publish(topic, payload, qos=0, properties=properties)

    async def _check_idle(self) -> None:
        timeout_s = self._settings.device_idle_timeout_s
        while True:
            await asyncio.sleep(CHECK_S)
            now_s = self._clock()
            for link in [idle for idle in self.links.values() if now_s - idle.active_s > timeout_s]:
                reason = f"nothing was received for {timeout_s:g} s; send a message or the hello more often"
                if link.session is not None:
                    link.session.end()
                link.end("idle", reason, retry=True)

    def _process(self, client: "Client", message: "Message") -> None:
        """Process a message; acknowledge it when it is stored, or if nothing has to be stored."""

        def acknowledge(_: object = None) -> None:
            with suppress(OSError, ValueError):  # a connection that has ended sends it again
                client._client.ack(message.mid, message.qos)

        name = message.topic.value.removeprefix(f"{self._prefix}/").removesuffix("/in")
        stored = None
        if not message.retain:  # a retained message is older than this subscription
            stored = self._receive(name, bytes(message.payload))
        if stored is None:
            acknowledge()
        else:
            stored.add_done_callback(acknowledge)

    def _receive(self, name: str, payload: bytes) -> "asyncio.Future[None] | None":
        """Process a payload of the device `name`; return when it is durable, None if nothing is stored."""
        now_s = self._clock()
        try:
            message = _object(payload)
            token = message.pop("token", "")
            device = self._gateway.with_token(name, token if isinstance(token, str) else "")
        except (BadMessage, WrongToken) as refused:
            metrics.MESSAGES_REFUSED.labels(refused.code).inc()
            if self._refusals.take(1, now_s):
                self.put(name, _error(refused.code, str(refused), None))
            return None
        link = self.links.get(name)
        if link is not None:
            link.active_s = now_s
        kind = message.get("type")
        if kind == "hello":
            self._process_hello(device, {**message, "token": token}, now_s)
            return None
        if kind == "goodbye":
            if link is not None and message.get("boot", link.boot) == link.boot:
                self.forget(name, link)
                if link.session is not None:
                    link.session.end()
            return None
        return self._receive_message(device, message, now_s)

    def _receive_message(
        self, device: Device, message: Mapping[str, Any], now_s: float
    ) -> "asyncio.Future[None] | None":
        rates = self._rates.get(device.name)
        if rates is None:
            rates = self._rates[device.name] = DeviceRates.of(self._settings.device_max_messages_per_s, now_s)
        if not rates.messages.take(1, now_s):
            metrics.MESSAGES_REFUSED.labels("tooFast").inc()
            if rates.faults.take(1, now_s):
                rate = self._settings.device_max_messages_per_s
                reason = f"a device sends at most {rate:g} messages a second; send this one again later"
                self.put(device.name, _error("tooFast", reason, message.get("seq")))
            return None

        def respond(answers: Sequence[Mapping[str, Any]]) -> None:
            for answer in answers:
                if answer["type"] == "error":
                    if rates.faults.take(1, self._clock()):
                        self.put(device.name, answer)
                elif "seq" in answer:  # without a number the device cannot use the answer
                    self.put(device.name, answer)

        return self._gateway.receive(device, [orjson.dumps(message)], respond)

    def _process_hello(self, device: Device, message: Mapping[str, Any], now_s: float) -> None:
        """Begin a session; the hello of the run that is connected already continues its session."""
        try:
            hello = parse_hello(orjson.dumps({**message, "device": device.name}))
            present = self.links.get(device.name)
            if present is None or not hello.boot or present.boot != hello.boot:
                link = MqttLink(self, device.name, now_s)
                link.session = self._gateway.connect(hello, link)
                self.links[device.name] = link
        except BadMessage as bad:
            self.put(device.name, _error(bad.code, str(bad), None))
        except HelloRefused as refused:
            self.put(device.name, {**_error(refused.code, str(refused), None), "retry": refused.retry})
        else:
            self.put(device.name, self._gateway.greeting(hello, device))

    def _end_sessions(self) -> None:
        for link in tuple(self.links.values()):
            if link.session is not None:
                link.session.end()
        self.links.clear()
        while not self._outgoing.empty():  # for devices that have no session any more
            self._outgoing.get_nowait()


class _IncomingQueue(asyncio.Queue["Message"]):
    """Messages that wait to be processed: those of QoS 1 are bounded by the server, those of QoS 0 here."""

    def put_nowait(self, item: "Message") -> None:
        if item.qos == 0 and self.qsize() >= MAX_WAITING_QOS_0:
            metrics.MESSAGES_REFUSED.labels("dropped").inc()
            return
        super().put_nowait(item)


def _object(payload: bytes) -> dict[str, Any]:
    if len(payload) > MAX_LINE_BYTES:
        raise BadMessage("tooLong", f"a message has at most {MAX_LINE_BYTES} bytes; send less at once")
    try:
        message = orjson.loads(payload)
    except orjson.JSONDecodeError as error:
        raise BadMessage("notJson", f"the payload is no JSON: {str(error)[:200]}") from None
    if not isinstance(message, dict):
        raise BadMessage("notJson", "a payload must be a JSON object")
    return message


def _error(code: str, reason: str, seq: Any) -> dict[str, Any]:
    numbered = {"seq": seq} if isinstance(seq, int) else {}
    return {"type": "error", "code": code, "reason": reason, **numbered}
