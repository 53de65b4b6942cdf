"""Topics over a rosbridge server."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from handover_ros.errors import BadMessage, GraphClosed, PublishBlocked
from handover_ros.graph.base_graph import require_fit
from handover_ros.graph.inbox import Inbox
from handover_ros.graph.port import Message, OnMessage
from handover_ros.graph.qos import Durability, Qos
from handover_ros.graph.rosbridge.connection import FRAGMENT_CHARACTERS, Connection, Operation
from handover_ros.graph.rosbridge.json_codec import JsonCodec
from handover_ros.graph.rosbridge.view import RosapiView
from handover_ros.graph.waiting import until


@dataclass(frozen=True, slots=True)
class TopicContext:
    """The shared state of the topics of one graph."""

    connection: Connection
    codec: JsonCodec
    view: RosapiView
    max_message_bytes: int


class RosbridgeSubscription(Inbox):
    """A subscription to a topic; see `port.Subscription`."""

    def __init__(
        self,
        context: TopicContext,
        topic: str,
        type_name: str,
        qos: Qos,
        *,
        on_message: OnMessage,
        closed: Callable[[Any], None],
    ) -> None:
        super().__init__(
            context.codec.store,
            topic,
            type_name,
            qos,
            on_message=on_message,
            max_message_bytes=context.max_message_bytes,
        )
        self._connection, self._codec, self._view = context.connection, context.codec, context.view
        self._closed = closed
        self._id = self._connection.new_id(f"subscribe:{topic}")
        self._connection.on("publish", self._on_publish)
        self._connection.on_opening(self._request)
        self._request()

    def _request(self) -> None:
        self._connection.send(
            op="subscribe",
            id=self._id,
            topic=self.topic,
            type=self._codec.type_name(self.type_name),
            throttle_rate=0,
            queue_length=self.qos.depth,
            fragment_size=FRAGMENT_CHARACTERS,
        )

    def _on_publish(self, operation: Operation) -> None:
        if operation.get("topic") != self.topic or not self._open:
            return
        data, why_not = b"", None
        try:
            data = self._codec.from_json(self.type_name, operation.get("msg"))
        except BadMessage as error:
            why_not = f"{self.topic}: {error}"
        self.put(data, sent_ns=0, ours=None, why_not=why_not)

    def publishers(self) -> int:
        """Return how many nodes publish the topic, by the last poll."""
        return self._view.publishers(self.topic) if self._open else 0

    async def matched(self, timeout_s: float) -> bool:
        """Wait until a node publishes the topic."""
        self._view.poll_soon()
        return await until(lambda: self.publishers() > 0, timeout_s)

    async def close(self) -> None:
        if self.shut():
            self._connection.off("publish", self._on_publish)
            self._connection.off_opening(self._request)
            if self._connection.is_open:
                self._connection.send(op="unsubscribe", id=self._id, topic=self.topic)
            self._closed(self)


class RosbridgePublisher:
    """A publisher on a topic; see `port.Publisher`."""

    def __init__(
        self,
        context: TopicContext,
        topic: str,
        type_name: str,
        qos: Qos,
        *,
        closed: Callable[[Any], None],
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.qos = qos
        self.published = 0
        self._connection, self._codec, self._view = context.connection, context.codec, context.view
        self._max_message_bytes = context.max_message_bytes
        self._closed = closed
        self._open = True
        self._last: Message | None = None
        self._id = self._connection.new_id(f"advertise:{topic}")
        self._connection.on_opening(self._advertise)
        self._advertise()

    def _advertise(self) -> None:
        latched = self.qos.durability is Durability.TRANSIENT_LOCAL
        self._connection.send(
            op="advertise",
            id=self._id,
            topic=self.topic,
            type=self._codec.type_name(self.type_name),
            latch=latched,
            queue_size=self.qos.depth,
        )
        if latched and self._last is not None:  # the server may have lost it
            self._connection.send(op="publish", topic=self.topic, msg=self._last)

    def publish(self, message: Message) -> None:
        if not self._open:
            raise GraphClosed(f"{self.topic} was closed; nothing can be published on it")
        written, size = self._codec.to_json(self.type_name, message)
        require_fit(self.topic, size, self._max_message_bytes)
        try:
            self._connection.send(op="publish", topic=self.topic, msg=written)
        except PublishBlocked as error:
            raise PublishBlocked(f"{self.topic}: {error}") from None
        self._last = written
        self.published += 1

    def subscribers(self) -> int:
        """Return how many nodes subscribe to the topic, by the last poll."""
        return self._view.subscribers(self.topic) if self._open else 0

    async def matched(self, timeout_s: float) -> bool:
        """Wait until a node subscribes to the topic."""
        self._view.poll_soon()
        return await until(lambda: self.subscribers() > 0, timeout_s)

    async def close(self) -> None:
        if self._open:
            self._open = False
            self._connection.off_opening(self._advertise)
            if self._connection.is_open:
                self._connection.send(op="unadvertise", id=self._id, topic=self.topic)
            self._closed(self)
