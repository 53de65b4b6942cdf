"""The connection of a device, an edge or a replica: a hello, then messages, one JSON object a line.

Bounds, for one connection and for all:

- a connection without a hello in time is closed, and so is the oldest of too many that wait for one;
- a line has at most 64 KiB, and an incomplete one is the only thing that is kept of the input;
- a device that sends faster than its rate, or faster than the database writes, is read no further until it
  may send again: TCP makes it wait, and nothing is lost;
- a device that does not read its answers is read no further, and is disconnected after the idle time;
- a device that sends many invalid lines is disconnected.
"""

import asyncio
import hashlib
import socket
from collections.abc import Mapping, Sequence
from typing import Any, Final, Protocol, cast

from handover.runtime.background_tasks import BackgroundTasks
from handover.telemetry import get_logger
from handover_devices import metrics
from handover_devices.gateway import DeviceGateway, Session, encoded
from handover_devices.protocol.lines import LineBuffer
from handover_devices.protocol.messages import VERSION, BadMessage, Hello, encode, parse_hello
from handover_devices.protocol.rates import DeviceRates
from handover_devices.protocol.relaying import MAX_RELAYED_BYTES, ReplicaHello, parse_replica_hello
from handover_devices.refusals import HelloRefused
from handover_devices.registry.device import Link
from handover_devices.relaying import SILENCE_S, EdgeRelays, EdgeSession, RelaySession
from handover_devices.settings import GatewaySettings

log = get_logger(__name__)

HELLO_TIMEOUT_S: Final = 5.0
MAX_WAITING_FOR_HELLO: Final = 128
REFUSAL_LINGER_S: Final = 1.0
"""How long a refused connection stays open, so that the other side can read the reason."""
HIGH_WATER_BYTES: Final = 256 * 1024
MAX_REPLICA_MESSAGES_PER_S: Final = 100_000.0
KEEPALIVE: Final = {"TCP_KEEPIDLE": 10, "TCP_KEEPINTVL": 5, "TCP_KEEPCNT": 3}


class Replicas(Protocol):
    """The other replicas of this gateway, which relay to it while it leads."""

    def begin(self, hello: ReplicaHello, link: Link) -> RelaySession:
        """Begin the session of a replica; raise `HelloRefused`."""
        ...


class DeviceConnections:
    """All connections of a gateway, and what they need: one that sends its hello becomes a session."""

    def __init__(self, settings: GatewaySettings, gateway: DeviceGateway, relays: EdgeRelays | None) -> None:
        self.settings = settings
        self.gateway = gateway
        self.relays = relays
        self.replicas: Replicas | None = None
        self.waiting: dict[DeviceConnection, None] = {}
        self.open: set[DeviceConnection] = set()
        self.lookups = BackgroundTasks("look-ups of edges")

    def add(self, connection: "DeviceConnection") -> None:
        """Add a connection that has not sent its hello."""
        self.open.add(connection)
        self.waiting[connection] = None
        if len(self.open) > self.settings.device_max_connections:
            connection.refuse(
                "tooManyConnections",
                f"there are {self.settings.device_max_connections} connections already; try again later, or "
                "raise HANDOVER_DEVICE_MAX_CONNECTIONS",
                retry=True,
            )
        elif len(self.waiting) > MAX_WAITING_FOR_HELLO:
            oldest = next(iter(self.waiting))
            reason = f"more than {MAX_WAITING_FOR_HELLO} connections have sent no hello; send it at once"
            oldest.refuse("noHello", reason, retry=True)


class DeviceConnection(asyncio.Protocol):
    """One connection: a hello, then messages. It is the `Link` of its device."""

    def __init__(self, connections: DeviceConnections) -> None:
        self.boot = ""
        self._connections = connections
        self._settings = connections.settings
        self._loop = asyncio.get_running_loop()
        self._transport: asyncio.Transport | None = None
        self._lines = LineBuffer()
        self._session: Session | RelaySession | None = None
        self._early: list[bytes] | None = None
        """What an edge has sent while it is looked up what is stored of it; None at other times."""
        now_s = self._loop.time()
        self._rates = DeviceRates.of(connections.settings.device_max_messages_per_s, now_s)
        self._active_s = now_s
        self._until_s = 0.0
        """Nothing is read until this time: the device has sent faster than its rate."""
        self._cannot_write = False
        self._is_paused = False
        self._ended = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Expect the hello."""
        self._transport = cast("asyncio.Transport", transport)  # uvloop's is one in all but its class
        self._transport.set_write_buffer_limits(high=HIGH_WATER_BYTES)
        _keep_alive(self._transport)
        self._connections.add(self)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002
        """Note the end; the device connects again by itself."""
        self._ended = True
        self._connections.waiting.pop(self, None)
        self._connections.open.discard(self)
        if self._session is not None:
            self._session.end()

    def data_received(self, data: bytes) -> None:
        """Process the complete lines."""
        if self._ended:
            return
        lines = self._lines.feed(data)
        self._active_s = self._loop.time()
        if self._early is not None:
            self._early += lines
        elif self._session is None and lines and self._is_edge(lines[0]):
            self._early = lines
            self._connections.lookups.start(self._look_up)
        else:
            self._process(lines)
        if self._lines.has_overflowed:
            self.refuse(
                "tooLong",
                f"a line has at most {self._lines.max_line_bytes} bytes; end each with a newline and send "
                "less at once",
                retry=True,
            )

    def _is_edge(self, line: bytes) -> bool:
        """Return whether the hello is that of an edge that is let in, and another replica may know it."""
        gateway = self._connections.gateway
        if not gateway.is_shared or b'"relay"' not in line:
            return False
        certificate = self._certificate_sha256()
        try:
            hello = parse_hello(line, needs_token=not certificate)
            gateway.authenticated(hello, certificate)
        except (BadMessage, HelloRefused):
            return False
        return hello.relay is not None

    async def _look_up(self) -> None:
        """Read what is stored of an edge, which another replica may have received, and continue."""
        await self._connections.gateway.read_edge_marks()
        lines, self._early = self._early or [], None
        if not self._ended:
            self._process(lines)

    def _process(self, lines: Sequence[bytes]) -> None:
        if self._session is None and lines:
            self._process_hello(lines[0])
            lines = lines[1:]
        messages = [line for line in lines if line]  # an empty line only shows that the device is there
        if messages and self._session is not None and not self._ended:
            wait_s = self._rates.messages.spend(len(messages), self._active_s)
            self._until_s = self._active_s + wait_s
            is_edge = isinstance(self._session, RelaySession)
            self._session.receive(messages, self._acknowledge if is_edge else self._respond)
            self._pause_if_needed(wait_s)

    def pause_writing(self) -> None:
        """The device does not read its answers: read no more of it."""
        self._cannot_write = True
        self._pause_if_needed(0.0)

    def resume_writing(self) -> None:
        """The device reads again."""
        self._cannot_write = False
        self.read_on()

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(encode(message))

    def send_latest(self, message: Mapping[str, Any]) -> bool:
        """Send a message unless earlier ones still wait for the device to read them."""
        transport = self._transport
        if transport is None or transport.is_closing() or transport.get_write_buffer_size() > 0:
            return False
        self.send(message)
        return True

    def end(self, code: str, reason: str, *, retry: bool) -> None:
        """Send the reason, and whether to connect again, and close."""
        self.refuse(code, reason, retry=retry)

    def refuse(self, code: str, reason: str, *, retry: bool) -> None:
        """Send the reason and close our direction; wait so that the other side can read it."""
        if self._ended or self._transport is None:
            return
        metrics.CONNECTIONS_REFUSED.labels(code).inc()
        log.warning("connection ended", code=code, reason=reason, peer=self._peer())
        self.send({"type": "error", "code": code, "reason": reason, "retry": retry})
        self._ended = True
        self._connections.waiting.pop(self, None)
        if self._session is not None:
            self._session.end()
        if self._transport.can_write_eof():
            self._transport.write_eof()
        self._loop.call_later(REFUSAL_LINGER_S, self._transport.abort)

    def check(self, now_s: float) -> None:
        """End the connection if its hello is missing or it was idle for too long."""
        if self._session is None:
            if now_s - self._active_s > HELLO_TIMEOUT_S:
                self.refuse("noHello", f"no hello within {HELLO_TIMEOUT_S:g} s", retry=True)
        elif self._is_paused and not self._cannot_write:
            self._active_s = now_s  # it waits for us
        elif now_s - self._active_s > self._max_silence_s():
            self.refuse(
                "idle",
                f"nothing was received for {self._max_silence_s():g} s; send a message or an empty "
                "line more often",
                retry=True,
            )

    def _max_silence_s(self) -> float:
        return SILENCE_S if isinstance(self._session, RelaySession) else self._settings.device_idle_timeout_s

    def read_on(self) -> None:
        """Read again, if nothing speaks against it any more."""
        if not self._is_paused or self._ended or self._transport is None:
            return
        is_early = self._loop.time() < self._until_s
        if not (is_early or self._cannot_write or self._connections.gateway.writer.is_full):
            self._is_paused = False
            self._transport.resume_reading()

    def _pause_if_needed(self, wait_s: float) -> None:
        if self._ended or self._transport is None:
            return
        if wait_s > 0 or self._cannot_write or self._connections.gateway.writer.is_full:
            if not self._is_paused:
                self._is_paused = True
                self._transport.pause_reading()
            if wait_s > 0:
                self._loop.call_later(wait_s, self.read_on)

    def _process_hello(self, line: bytes) -> None:
        gateway = self._connections.gateway
        replica = parse_replica_hello(line)
        if replica is not None:
            self._begin_replica(replica)
            return
        try:
            certificate = self._certificate_sha256()
            hello = parse_hello(line, needs_token=not certificate)
            if hello.relay is not None and self._connections.relays is None:
                self._refuse_edge(hello)
                return
            session = gateway.connect(hello, self, certificate)
            self._session = session
            relay = None if hello.relay is None else self._begin_relay(session, hello)
        except BadMessage as bad:
            self.refuse(bad.code, str(bad), retry=False)
            return
        except HelloRefused as refused:
            self.refuse(refused.code, str(refused), retry=refused.retry)
            return
        self._connections.waiting.pop(self, None)
        greeting = gateway.greeting(hello, session.device)
        if relay is None:
            self.send(greeting)
            return
        received = gateway.edge_marks.stored(relay.name, relay.stream)
        self.send({**greeting, "received": received, "live": True})
        relay.begin()

    def _refuse_edge(self, hello: Hello) -> None:
        """Refuse an edge behind this one. Its token is not known here: the centre sends none of edges."""
        upstream = self._settings.edge_upstream
        reason = (
            f"this gateway is an edge, which relays devices but no other edge such as {hello.device}; set "
            f"HANDOVER_EDGE_UPSTREAM of {hello.device} to that of this one, {upstream}"
        )
        self.refuse("edgeOfEdge", reason, retry=False)

    def _begin_replica(self, hello: ReplicaHello) -> None:
        if self._connections.replicas is None:
            self.refuse("noReplicas", "an edge has no replicas", retry=False)
            return
        try:
            session = self._connections.replicas.begin(hello, self)
        except HelloRefused as refused:
            self.refuse(refused.code, str(refused), retry=refused.retry)
            return
        self._session = session
        self._lines.max_line_bytes = MAX_RELAYED_BYTES
        self._rates = DeviceRates.of(MAX_REPLICA_MESSAGES_PER_S, self._loop.time())
        self._connections.waiting.pop(self, None)
        self.send({"type": "ack", "version": VERSION, "received": 0, "live": True})
        session.begin()

    def _begin_relay(self, session: Session, hello: Hello) -> EdgeSession:
        relays = self._connections.relays
        assert relays is not None  # noqa: S101 - the caller has looked
        relay = relays.begin(session, self, hello)
        self._session = relay
        self._lines.max_line_bytes = MAX_RELAYED_BYTES
        rate = relays.messages_per_s(session.device, self._settings.device_max_messages_per_s)
        self._rates = DeviceRates.of(rate, self._loop.time())
        return relay

    def _acknowledge(self, answers: Sequence[Mapping[str, Any]]) -> None:
        """Answer an edge, which relays the mistakes of many devices."""
        if self._transport is not None and not self._transport.is_closing() and not self._ended:
            self._transport.write(encoded(answers))

    def _respond(self, answers: Sequence[Mapping[str, Any]]) -> None:
        if self._transport is None or self._transport.is_closing() or self._ended:
            return
        self._transport.write(encoded(answers))
        faults = sum(answer["type"] == "error" for answer in answers)
        if faults and self._rates.faults.spend(faults, self._loop.time()) > 0:
            self.refuse(
                "tooManyErrors",
                "too many invalid messages; correct the device, see the errors before",
                retry=True,
            )

    def _certificate_sha256(self) -> str:
        """Return the fingerprint of the certificate of the device, which TLS has verified; "" without one."""
        tls = self._transport.get_extra_info("ssl_object") if self._transport else None
        certificate = tls.getpeercert(binary_form=True) if tls is not None else None
        return hashlib.sha256(certificate).hexdigest() if certificate else ""

    def _peer(self) -> str:
        peer = self._transport.get_extra_info("peername") if self._transport else None
        return f"{peer[0]}:{peer[1]}" if isinstance(peer, tuple) else str(peer)


def _keep_alive(transport: asyncio.Transport) -> None:
    """Detect a peer that has vanished without closing the connection."""
    connection = transport.get_extra_info("socket")
    if connection is None:
        return
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in KEEPALIVE.items():
        if hasattr(socket, option):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
