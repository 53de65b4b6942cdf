"""Clients of services over DDS: a request waits for its response while its server is there."""

import asyncio
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import structlog

from handover_ros.errors import (
    BadMessage,
    ClosedUnanswered,
    OutcomeUnknown,
    ServerLost,
    ServiceUnavailable,
    VendorNotShared,
)
from handover_ros.graph.cyclone import dds_names
from handover_ros.graph.cyclone.discovery import DiscoveredEndpoint, handles
from handover_ros.graph.cyclone.node import OwnNode
from handover_ros.graph.cyclone.samples import Sample
from handover_ros.graph.cyclone.services import (
    CDR_BYTES,
    HEADER,
    accepted_hashes,
    id_of_pair,
    obstacle,
    unwrapped,
    wrapped,
)
from handover_ros.graph.cyclone.topics import send
from handover_ros.graph.goals import too_busy, unanswered
from handover_ros.graph.port import Message
from handover_ros.graph.qos import MAX_REQUESTS_IN_FLIGHT, SERVICES
from handover_ros.graph.waiting import until

log = structlog.get_logger(__name__)

_SERVER_LOST_AFTER_S = 2.0


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
                of = accepted_hashes(self._node.store, self.base).get(server.type_hash or "", "none")
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
            pair_id, store = id_of_pair(), self._node.store
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
            if sample.data is None or len(sample.data) < CDR_BYTES + HEADER.size:
                continue
            guid, sequence, body = unwrapped(sample.data)
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
                wrapped(self._guid, sequence, data),
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
