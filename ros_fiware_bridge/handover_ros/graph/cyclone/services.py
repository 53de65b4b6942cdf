"""Services over DDS, like `rmw_cyclonedds_cpp`: a header before each request and reply.

The header contains the id of the client (8 bytes, chosen by the client) and the number of the request. Fast
DDS transmits the same in another place, so the two cannot call each other. A call to a Fast DDS server is
refused before anything is sent (such a server would keep every request that it cannot answer).

`rmw_cyclonedds_cpp` publishes on each endpoint the hash of the *message* that it transmits, `X_Request` or
`X_Response`; other programs publish the hash of the service `X`. The bridge publishes the former and accepts
both.
"""

import asyncio
import secrets
import struct
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

import structlog

from handover.distribution import install_command
from handover_ros.errors import (
    BadMessage,
    ClosedUnanswered,
    OutcomeUnknown,
    ServerLost,
    ServiceUnavailable,
    TypeHashDiffers,
    VendorNotShared,
)
from handover_ros.graph.cyclone import dds_names
from handover_ros.graph.cyclone.discovery import DiscoveredEndpoint, handles
from handover_ros.graph.cyclone.node import OwnNode
from handover_ros.graph.cyclone.samples import Sample
from handover_ros.graph.cyclone.topics import send
from handover_ros.graph.goals import too_busy, unanswered
from handover_ros.graph.port import Message, ServiceHandler
from handover_ros.graph.qos import MAX_REQUESTS_IN_FLIGHT, SERVICES
from handover_ros.graph.waiting import until
from handover_ros.types.type_store import TypeStore

log = structlog.get_logger(__name__)

VENDOR = "cyclonedds"
_HEADER = struct.Struct("<Qq")
_CDR = 4
_MAX_PENDING_REQUESTS = 256
_CLIENT_MATCH_TIMEOUT_S = 1.0
_SERVER_LOST_AFTER_S = 2.0


def _wrapped(writer_guid: int, sequence: int, data: bytes) -> bytes:
    return data[:_CDR] + _HEADER.pack(writer_guid, sequence) + data[_CDR:]


def _unwrapped(data: bytes) -> tuple[int, int, bytes]:
    guid, sequence = _HEADER.unpack_from(data, _CDR)
    return guid, sequence, data[:_CDR] + data[_CDR + _HEADER.size :]


def _id_of_pair() -> str:
    return ".".join(f"{byte:x}" for byte in secrets.token_bytes(16))


def vendor_refused(service: str, endpoint: DiscoveredEndpoint, node: str | None, doing: str) -> str:
    """Return the error text for a peer whose middleware has incompatible services."""
    return (
        f"{service}: {node or 'a node'} {doing} it with {endpoint.vendor}, whose services cannot be reached "
        "from Cyclone DDS; start it with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or install rclpy beside the "
        f"bridge ({install_command('ros', 'ros-rclpy')}, Python 3.11 on Linux) and leave "
        "HANDOVER_ROS_ADAPTER at auto"
    )


def hash_refused(
    store: TypeStore, service: str, base: str, server: DiscoveredEndpoint, node: str | None
) -> str | None:
    """Return the error text for a server with another definition of `base`; None if it has the same.

    The peer may publish the hash of the request message, of the service, or none.
    """
    name, theirs = dds_names.to_type(server.dds_type).removesuffix("_Request"), server.type_hash
    accepted = _accepted_hashes(store, base)
    if name == base and (theirs is None or theirs in accepted):
        return None
    ours = ", ".join(f"{of} {digest}" for digest, of in accepted.items())
    return (
        f"{service}: {node or 'a node'} serves {name} with the type hash {theirs}, our {base} has {ours}; "
        "give the rule that type, or name the robot's definition in type_paths"
    )


def _accepted_hashes(store: TypeStore, base: str) -> dict[str, str]:
    """Return the hashes that a request endpoint may publish, each with what it is the hash of."""
    return {store.hash(f"{base}_Request"): "request", store.hash(base): "service"}


def obstacle(
    store: TypeStore, service: str, base: str, server: DiscoveredEndpoint, node: str | None
) -> VendorNotShared | TypeHashDiffers | None:
    """Return why a server, given by its request reader, must not be called; None if it may be."""
    if server.vendor != VENDOR:
        return VendorNotShared(vendor_refused(service, server, node, "serves"))
    fault = hash_refused(store, service, base, server, node)
    return TypeHashDiffers(fault) if fault is not None else None


@dataclass(frozen=True, slots=True)
class Answer:
    """A response, and the participant of its server if that is known."""

    message: Message
    server: bytes | None


@dataclass(frozen=True, slots=True)
class _Asked:
    """A request without a response yet; only `server` may answer if it is given."""

    answer: asyncio.Future[tuple[bytes, bytes | None]]
    server: bytes | None


class CycloneClient:
    """Calls one service. `base` is the type without `_Request` and `_Response`."""

    def __init__(self, node: OwnNode, service: str, base: str, max_message_bytes: int) -> None:
        self.service = service
        self.base = base
        self._node = node
        self._max_message_bytes = max_message_bytes
        self._loop = asyncio.get_running_loop()
        self._guid = secrets.randbits(63) + 1
        self._sequence = 0
        self._asked: dict[int, _Asked] = {}
        self._free = asyncio.Semaphore(MAX_REQUESTS_IN_FLIGHT)
        self._pair: tuple[Any, Any] | None = None
        self._met: set[bytes] = set()
        self._stop: Callable[[], None] = lambda: None
        self._request_topic = dds_names.of_request(service)
        self._reply_topic = dds_names.of_reply(service)

    def _servers(self) -> list[DiscoveredEndpoint]:
        """Return the request readers of the servers that may be called.

        Raises:
            VendorNotShared, TypeHashDiffers: one of them must not be called.
        """
        snapshot = self._node.discovery.snapshot()
        servers = snapshot.at(self._request_topic, writes=False)
        for server in servers:
            fault = obstacle(self._node.store, self.service, self.base, server, snapshot.node_of(server))
            if isinstance(fault, VendorNotShared):
                self.close()
            if fault is not None:
                raise fault
            if server.guid not in self._met:
                self._met.add(server.guid)
                of = _accepted_hashes(self._node.store, self.base).get(server.type_hash or "", "none")
                log.info(
                    "service found", service=self.service, node=snapshot.node_of(server), type_hash_of=of
                )
        return servers

    def _matched(self) -> bool:
        servers = {server.participant for server in self._servers()}
        if not servers:
            return False
        writer, reader = self._open()
        snapshot = self._node.discovery.snapshot()
        answering = handles(reader.get_matched_publications())
        asked = handles(writer.get_matched_subscriptions())
        servers &= {
            endpoint.participant
            for endpoint in snapshot.at(self._reply_topic, writes=True)
            if endpoint.handle in answering
        }
        servers &= {
            endpoint.participant
            for endpoint in snapshot.at(self._request_topic, writes=False)
            if endpoint.handle in asked
        }
        return bool(servers)

    def _open(self) -> tuple[Any, Any]:
        if self._pair is None:
            pair_id, store = _id_of_pair(), self._node.store
            asks, answers = f"{self.base}_Request", f"{self.base}_Response"
            reader = self._node.reader(
                self._reply_topic,
                answers,
                SERVICES,
                user={"clientid": pair_id, "typehash": store.hash(answers)},
                header=True,
            )
            writer = self._node.writer(
                self._request_topic,
                asks,
                SERVICES,
                user={"clientid": pair_id, "typehash": store.hash(asks)},
                header=True,
            )
            self._stop = self._node.listener.to_samples(reader, self._on_samples)
            self._pair = writer, reader
        return self._pair

    def _on_samples(self, samples: list[Sample]) -> None:
        for sample in samples:
            if sample.data is None or len(sample.data) < _CDR + _HEADER.size:
                continue
            guid, sequence, body = _unwrapped(sample.data)
            if guid == self._guid:
                writer = self._node.discovery.known_writer(sample.writer)
                server = writer.participant if writer is not None else None
                try:
                    self._loop.call_soon_threadsafe(self._answered, sequence, body, server)
                except RuntimeError:  # the loop is closed
                    return

    def _answered(self, sequence: int, body: bytes, server: bytes | None) -> None:
        asked = self._asked.get(sequence)
        if asked is None or asked.answer.done():
            return
        if None in {asked.server, server} or asked.server == server:
            asked.answer.set_result((body, server))

    async def available(self, timeout_s: float) -> bool:
        """Wait until a server is available; False if none was found in time."""
        return await until(self._matched, timeout_s)

    async def call(self, request: Message, timeout_s: float | None, server: bytes | None = None) -> Message:
        """Send the request and return the response; see `ask`."""
        return (await self.ask(request, timeout_s, server)).message

    async def ask(self, request: Message, timeout_s: float | None, server: bytes | None = None) -> Answer:
        """Send the request and return the response; None waits as long as the asked server is there.

        Only the participant `server` counts if it is given.

        Raises:
            BadMessage, VendorNotShared, TypeHashDiffers, ServiceUnavailable: nothing was sent.
            CallTimeout, ServerLost, OutcomeUnknown, ClosedUnanswered: it was sent, and not answered.
        """
        data = self._node.store.encode(f"{self.base}_Request", request)
        start_s = self._loop.time()
        if not await self.available(5.0 if timeout_s is None else timeout_s):
            raise ServiceUnavailable(
                f"no node serves {self.service} ({self.base}); start its node, or check the name and the "
                "number of the domain (ROS_DOMAIN_ID)"
            )
        if timeout_s is None:  # the result of a goal, which may take any time
            return await self._ask(data, server)
        is_sent = False
        try:
            async with asyncio.timeout_at(start_s + timeout_s), self._free:
                is_sent = True
                return await self._ask(data, server)
        except TimeoutError:
            if is_sent:
                raise unanswered(self.service, timeout_s) from None
            raise too_busy(self.service) from None

    async def _ask(self, data: bytes, server: bytes | None) -> Answer:
        self._sequence += 1
        sequence = self._sequence
        answer: asyncio.Future[tuple[bytes, bytes | None]] = self._loop.create_future()
        self._asked[sequence] = _Asked(answer, server)
        try:
            writer, _ = self._open()
            send(
                self._node,
                writer,
                _wrapped(self._guid, sequence, data),
                self._max_message_bytes,
                self.service,
            )
            asked = self._participants() if server is None else {server}
            body, answered_by = await self._while_served(answer, asked)
        finally:
            self._asked.pop(sequence, None)
        try:
            return Answer(self._node.store.decode(f"{self.base}_Response", body), answered_by)
        except BadMessage as error:
            raise OutcomeUnknown(
                f"{self.service} answered, and its answer cannot be read: {error}"
            ) from error

    def _participants(self) -> set[bytes]:
        snapshot = self._node.discovery.snapshot()
        return {endpoint.participant for endpoint in snapshot.at(self._request_topic, writes=False)}

    async def _while_served(
        self, answer: asyncio.Future[tuple[bytes, bytes | None]], asked: set[bytes]
    ) -> tuple[bytes, bytes | None]:
        """Wait while one of the `asked` participants serves; a new server does not know the request."""
        while True:
            done, _ = await asyncio.wait([answer], timeout=_SERVER_LOST_AFTER_S)
            if done:
                return answer.result()
            if not await until(lambda: bool(asked & self._participants()), _SERVER_LOST_AFTER_S):
                raise ServerLost(f"the server of {self.service} went away before it answered")

    def close(self) -> None:
        """Close the client; pending calls end with `ClosedUnanswered`."""
        for asked in self._asked.values():
            if not asked.answer.done():
                asked.answer.set_exception(ClosedUnanswered(f"{self.service} was closed before it answered"))
        if self._pair is not None:
            self._stop()
            self._node.drop(*self._pair)
            self._pair = None


class CycloneServer:
    """Serves one service; see `port.Served`."""

    def __init__(
        self,
        node: OwnNode,
        service: str,
        base: str,
        handler: ServiceHandler,
        *,
        max_message_bytes: int,
        closed: Callable[[Any], None],
    ) -> None:
        self.name = service
        self.type_name = base
        self.calls = 0
        self.failed = 0
        self.last_error: str | None = None
        self._node = node
        self._handler = handler
        self._max_message_bytes = max_message_bytes
        self._closed = closed
        self._loop = asyncio.get_running_loop()
        self._working: set[asyncio.Task[None]] = set()
        self._is_open = True
        # One thread writes each: the listener thread the first, the loop the second.
        self._handed = 0
        self._taken = 0
        pair_id, asks, answers = _id_of_pair(), f"{base}_Request", f"{base}_Response"
        self._reply_topic = dds_names.of_reply(service)
        self._writer = node.writer(
            self._reply_topic,
            answers,
            SERVICES,
            user={"serviceid": pair_id, "typehash": node.store.hash(answers)},
            header=True,
        )
        self._reader = node.reader(
            dds_names.of_request(service),
            asks,
            SERVICES,
            user={"serviceid": pair_id, "typehash": node.store.hash(asks)},
            header=True,
        )
        self._stop = node.listener.to_samples(self._reader, self._on_samples)

    def _on_samples(self, samples: list[Sample]) -> None:
        for sample in samples:
            if sample.data is None or len(sample.data) < _CDR + _HEADER.size:
                continue
            client = self._node.discovery.known_writer(sample.writer)
            if self._handed - self._taken >= _MAX_PENDING_REQUESTS:
                self._fault(f"{self.name}: {_MAX_PENDING_REQUESTS} requests are pending; one was dropped")
                continue
            self._handed += 1
            try:
                self._loop.call_soon_threadsafe(self._asked, client, sample.data)
            except RuntimeError:  # the loop is closed
                return

    def _asked(self, client: DiscoveredEndpoint | None, data: bytes) -> None:
        self._taken += 1
        if not self._is_open:
            return
        self.calls += 1
        if client is not None and client.vendor != VENDOR:
            node = self._node.discovery.snapshot().node_of(client)
            self._fault(vendor_refused(self.name, client, node, "calls"))
        elif len(data) > self._max_message_bytes:
            self._fault(
                f"{self.name}: a request has {len(data)} bytes, {self._max_message_bytes} are allowed"
            )
        elif len(self._working) >= _MAX_PENDING_REQUESTS:
            self._fault(f"{self.name}: {_MAX_PENDING_REQUESTS} requests are being answered; one was dropped")
        else:
            self._spawn(self._answer(client, *_unwrapped(data)))

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = self._loop.create_task(work)
        self._working.add(task)
        task.add_done_callback(self._working.discard)

    async def _answer(self, client: DiscoveredEndpoint | None, guid: int, sequence: int, body: bytes) -> None:
        try:
            request = self._node.store.decode(f"{self.type_name}_Request", body)
            response = await self._handler(request)
            data = self._node.store.encode(f"{self.type_name}_Response", response)
            # Replies are volatile: a client whose reader is not matched yet would miss its reply.
            await until(lambda: self._is_matched_with(client), _CLIENT_MATCH_TIMEOUT_S)
            if self._is_open:
                send(
                    self._node,
                    self._writer,
                    _wrapped(guid, sequence, data),
                    self._max_message_bytes,
                    self.name,
                )
        except Exception as error:  # one request must not end the service
            self._fault(f"{type(error).__name__}: {error}")
            log.exception("answering a request failed", service=self.name)

    def _is_matched_with(self, client: DiscoveredEndpoint | None) -> bool:
        if not self._is_open:
            return True
        matched = handles(self._writer.get_matched_subscriptions())
        if client is None:
            return bool(matched)
        same = "clientid" if "clientid" in client.user_data else None
        return any(
            endpoint.handle in matched
            and endpoint.participant == client.participant
            and (same is None or endpoint.user_data.get(same) == client.user_data[same])
            for endpoint in self._node.discovery.snapshot().at(self._reply_topic, writes=False)
        )

    def _fault(self, error: str) -> None:
        self.failed += 1
        self.last_error = error

    async def close(self) -> None:
        """Stop serving."""
        if self._is_open:
            self._is_open = False
            self._stop()
            for task in list(self._working):
                task.cancel()
            await asyncio.gather(*self._working, return_exceptions=True)
            self._node.drop(self._reader, self._writer)
            self._closed(self)
