"""ROS topics over UDP: each datagram is a JSON object with `topic` and `message`."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import orjson
from pydantic import Field

from handover.settings import Settings
from handover_ros.errors import (
    AdapterUnavailable,
    BadMessage,
    GraphClosed,
    GraphError,
    ServiceUnavailable,
)
from handover_ros.graph import names
from handover_ros.graph.base_graph import BaseGraph, require_fit
from handover_ros.graph.inbox import Inbox
from handover_ros.graph.join_settings import JoinSettings
from handover_ros.graph.port import (
    ActionClient,
    ActionHandler,
    ActionInfo,
    Endpoint,
    Message,
    NodeInfo,
    OnMessage,
    Served,
    ServiceHandler,
    ServiceInfo,
    TopicInfo,
)
from handover_ros.graph.qos import DEFAULT, Qos
from handover_ros.graph.rosbridge.json_codec import JsonCodec
from handover_ros.types.type_store import TypeStore

MAX_DATAGRAM_BYTES = 60_000
NO_SERVICES = "datagrams carry topics only; use the adapter of a ROS middleware for services and actions"


class DatagramSettings(Settings):
    """Where datagrams are received, and where they are sent."""

    datagram_port: int = Field(54910, ge=0, le=65535, description="UDP port of received topics")
    datagram_peer: str = Field(
        "127.0.0.1:54911", pattern=r"^.+:\d+$", description="where published topics are sent, host:port"
    )


class DatagramSubscription(Inbox):
    """A subscription to a topic."""

    def __init__(self, graph: "DatagramGraph", *place: Any, on_message: OnMessage) -> None:
        super().__init__(graph.store, *place, on_message=on_message, max_message_bytes=MAX_DATAGRAM_BYTES)
        self._graph = graph

    def receive(self, message: Any) -> None:
        try:
            self.put(self._graph.codec.from_json(self.type_name, message), sent_ns=0, ours=False)
        except BadMessage as error:
            self.put(b"", sent_ns=0, ours=False, why_not=f"{self.topic}: {error}")

    def publishers(self) -> int:
        return int(self.received > 0)  # a sender of datagrams is known by them only

    async def matched(self, timeout_s: float) -> bool:
        return self.publishers() > 0

    async def close(self) -> None:
        if self.shut():
            self._graph.forget(self)


@dataclass(eq=False)
class DatagramPublisher:
    """A publisher on a topic."""

    graph: "DatagramGraph"
    topic: str
    type_name: str
    qos: Qos
    published: int = 0
    is_open: bool = True

    def publish(self, message: Message) -> None:
        if not self.is_open:
            raise GraphClosed(f"{self.topic} was closed; nothing can be published on it")
        written, _ = self.graph.codec.to_json(self.type_name, message)
        datagram = orjson.dumps({"topic": self.topic, "message": written})
        require_fit(self.topic, len(datagram), MAX_DATAGRAM_BYTES)
        self.graph.send(datagram)
        self.published += 1

    def subscribers(self) -> int:
        return int(self.is_open)  # the peer is not asked what it reads

    async def matched(self, timeout_s: float) -> bool:
        return self.is_open

    async def close(self) -> None:
        self.is_open = False
        self.graph.forget(self)


@dataclass
class NeverCalled:
    """A service or an action that no datagram can call."""

    name: str
    type_name: str
    calls: int = 0
    failed: int = 0
    last_error: str | None = NO_SERVICES

    async def close(self) -> None:
        """Do nothing: there is nothing to close."""


class DatagramGraph(BaseGraph, asyncio.DatagramProtocol):
    """The graph of all topics that datagrams name; see `handover_ros.graph.port.RosGraph`."""

    def __init__(self, store: TypeStore, settings: JoinSettings, peer: tuple[str, int]) -> None:
        super().__init__(store, settings)
        self.codec = JsonCodec(store)
        self._peer = peer
        self._transport: asyncio.DatagramTransport | None = None
        self._refused = 0

    @classmethod
    async def join(cls, store: TypeStore, settings: JoinSettings) -> "DatagramGraph":
        """Listen for datagrams. Raises `BadName` or `AdapterUnavailable`."""
        names.node_name(settings.node)
        names.namespace(settings.namespace)
        own = DatagramSettings.load()
        host, _, port = own.datagram_peer.rpartition(":")
        graph = cls(store, settings, (host, int(port)))
        try:
            loop = asyncio.get_running_loop()
            await loop.create_datagram_endpoint(lambda: graph, local_addr=(own.host, own.datagram_port))
        except OSError as error:
            raise AdapterUnavailable(
                f"UDP port {own.datagram_port} of {own.host} cannot be used: {error}; "
                "set HANDOVER_DATAGRAM_PORT"
            ) from None
        return graph

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: Any) -> None:
        try:
            given = orjson.loads(data)
            topic, message = given["topic"], given["message"]
        except (orjson.JSONDecodeError, KeyError, TypeError):
            self._refused += 1
            return
        for subscription in self._endpoints(DatagramSubscription):
            if subscription.topic == topic:
                subscription.receive(message)

    def send(self, datagram: bytes) -> None:
        """Send a datagram to the peer."""
        if self._transport is not None:
            self._transport.sendto(datagram, self._peer)

    def forget(self, endpoint: Any) -> None:
        """Remove a closed endpoint."""
        self._unregister(endpoint)

    async def subscribe(
        self, topic: str, type_name: str, on_message: OnMessage, qos: Qos = DEFAULT
    ) -> DatagramSubscription:
        place = (self._full(topic), self._type(type_name, "msg", ""), qos)
        opened = DatagramSubscription(self, *place, on_message=on_message)
        self._register(opened)
        return opened

    async def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> DatagramPublisher:
        opened = DatagramPublisher(self, self._full(topic), self._type(type_name, "msg", ""), qos)
        self._register(opened)
        return opened

    async def call(self, service: str, type_name: str, request: Message, timeout_s: float = 5.0) -> Message:
        raise ServiceUnavailable(f"{self._full(service)}: {NO_SERVICES}")

    async def serve(self, service: str, type_name: str, handler: ServiceHandler) -> Served:
        return NeverCalled(self._full(service), self._type(type_name, "srv", "_Request", "_Response"))

    async def action_client(self, action: str, type_name: str) -> ActionClient:
        raise ServiceUnavailable(f"{self._full(action)}: {NO_SERVICES}")

    async def serve_action(
        self,
        action: str,
        type_name: str,
        handler: ActionHandler,
        *,
        accept: Callable[[Message], bool] | None = None,
    ) -> Served:
        full = self._type(type_name, "action", "_Goal", "_Result", "_Feedback")
        return NeverCalled(self._full(action), full)

    def topics(self) -> Sequence[TopicInfo]:
        """Return our own topics: those of peers have no type until they are subscribed to."""
        ours: dict[str, tuple[str, list[Endpoint], list[Endpoint]]] = {}
        for endpoint in self._endpoints((DatagramSubscription, DatagramPublisher)):
            end = Endpoint(self.node_name, endpoint.type_name, endpoint.qos, None, "datagram", ours=True)
            _, publishers, subscribers = ours.setdefault(endpoint.topic, (endpoint.type_name, [], []))
            (publishers if isinstance(endpoint, DatagramPublisher) else subscribers).append(end)
        return [
            TopicInfo(name, (type_name,), tuple(publishers), tuple(subscribers))
            for name, (type_name, publishers, subscribers) in sorted(ours.items())
        ]

    def services(self) -> Sequence[ServiceInfo]:
        return []

    def actions(self) -> Sequence[ActionInfo]:
        return []

    def nodes(self) -> Sequence[NodeInfo]:
        namespace, _, name = self.node_name.rpartition("/")
        return [NodeInfo(name, namespace or "/", "/", "datagram", ours=True)]

    def obstacles(self, service: str, type_name: str) -> Sequence[GraphError]:
        return [ServiceUnavailable(f"{service}: {NO_SERVICES}")]

    def problems(self) -> Sequence[GraphError]:
        if self._refused == 0:
            return []
        return [BadMessage(f"{self._refused} datagrams were not JSON objects with topic and message")]

    async def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        await self._close_all()
        if self._transport is not None:
            self._transport.close()

    def _endpoints(self, kind: Any) -> list[Any]:
        return [endpoint for endpoint in self._opened.values() if isinstance(endpoint, kind)]
