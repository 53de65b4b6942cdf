"""Servers of services over DDS: each request is a task, and a response waits for its reader."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import structlog

from handover_ros.graph.cyclone import dds_names
from handover_ros.graph.cyclone.discovery import DiscoveredEndpoint, handles
from handover_ros.graph.cyclone.node import OwnNode
from handover_ros.graph.cyclone.samples import Sample
from handover_ros.graph.cyclone.services import (
    CDR_BYTES,
    HEADER,
    VENDOR,
    id_of_pair,
    unwrapped,
    vendor_refused,
    wrapped,
)
from handover_ros.graph.cyclone.topics import send
from handover_ros.graph.port import ServiceHandler
from handover_ros.graph.qos import SERVICES
from handover_ros.graph.waiting import until

log = structlog.get_logger(__name__)

_MAX_PENDING_REQUESTS = 256
_CLIENT_MATCH_TIMEOUT_S = 1.0


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
        pair_id, asks, answers = id_of_pair(), f"{base}_Request", f"{base}_Response"
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
            if sample.data is None or len(sample.data) < CDR_BYTES + HEADER.size:
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
            self._spawn(self._answer(client, *unwrapped(data)))

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
                    wrapped(guid, sequence, data),
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
        if self._is_open:
            self._is_open = False
            self._stop()
            for task in list(self._working):
                task.cancel()
            await asyncio.gather(*self._working, return_exceptions=True)
            self._node.drop(self._reader, self._writer)
            self._closed(self)
