"""Topics over DDS: received messages are decoded on first access; published ones are sent at once."""

from collections.abc import Callable
from typing import Any

from handover_ros.errors import GraphClosed, GraphError, PublishBlocked
from handover_ros.graph.base_graph import require_fit
from handover_ros.graph.cyclone import dds_names
from handover_ros.graph.cyclone.node import OwnNode
from handover_ros.graph.cyclone.samples import TIMEOUT, Sample
from handover_ros.graph.inbox import Inbox, hash_differs
from handover_ros.graph.port import Message, OnMessage
from handover_ros.graph.qos import Qos
from handover_ros.graph.waiting import until

_MAX_KNOWN_WRITERS = 1000


class CycloneSubscription(Inbox):
    """A subscription to a topic; see `port.Subscription`."""

    def __init__(
        self,
        node: OwnNode,
        topic: str,
        type_name: str,
        qos: Qos,
        *,
        on_message: OnMessage,
        max_message_bytes: int,
        closed: Callable[[Any], None],
    ) -> None:
        super().__init__(
            node.store, topic, type_name, qos, on_message=on_message, max_message_bytes=max_message_bytes
        )
        self._node = node
        self._closed = closed
        # For each writer: the reason why it is ignored (None: it is not), and whether it is ours.
        self._writers: dict[int, tuple[str | None, bool]] = {}
        self._hash = node.store.hash(type_name)
        self._reader = node.reader(dds_names.of_topic(topic), type_name, qos, user={"typehash": self._hash})
        self._stop = node.listener.to_samples(self._reader, self._on_samples)

    def _on_samples(self, samples: list[Sample]) -> None:
        for sample in samples:
            if sample.data is None:
                self._writers.pop(sample.writer, None)
                continue
            why_not, ours = self._writers.get(sample.writer) or self._met(sample.writer)
            self.put(sample.data, sent_ns=sample.sent_ns, ours=ours, why_not=why_not)

    def _met(self, handle: int) -> tuple[str | None, bool]:
        discovery = self._node.discovery
        writer = discovery.writer(handle)
        if writer is None:
            discovery.look()
            writer = discovery.writer(handle)
        if writer is None:
            return None, False
        who = f"a publisher ({writer.vendor})"
        verdict = (
            hash_differs(self.topic, self.type_name, self._hash, writer.type_hash, who),
            writer.participant == discovery.own,
        )
        if len(self._writers) >= _MAX_KNOWN_WRITERS:
            self._writers.clear()
        self._writers[handle] = verdict
        return verdict

    def publishers(self) -> int:
        return len(self._reader.get_matched_publications()) if self._open else 0

    async def matched(self, timeout_s: float) -> bool:
        return await until(lambda: self.publishers() > 0, timeout_s)

    async def close(self) -> None:
        if self.shut():
            self._stop()
            self._node.drop(self._reader)
            self._closed(self)


class CyclonePublisher:
    """A publisher on a topic; see `port.Publisher`."""

    def __init__(
        self,
        node: OwnNode,
        topic: str,
        type_name: str,
        qos: Qos,
        *,
        max_message_bytes: int,
        closed: Callable[[Any], None],
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.qos = qos
        self.published = 0
        self._node = node
        self._max_message_bytes = max_message_bytes
        self._closed = closed
        self._open = True
        user = {"typehash": node.store.hash(type_name)}
        self._writer = node.writer(dds_names.of_topic(topic), type_name, qos, user=user)

    def publish(self, message: Message) -> None:
        self.publish_encoded(self._node.store.encode(self.type_name, message))

    def publish_encoded(self, data: bytes) -> None:
        """Send a message that `TypeStore.encode` has encoded."""
        if not self._open:
            raise GraphClosed(f"{self.topic} was closed; nothing can be published on it")
        send(self._node, self._writer, data, self._max_message_bytes, self.topic)
        self.published += 1

    def subscribers(self) -> int:
        return len(self._writer.get_matched_subscriptions()) if self._open else 0

    async def matched(self, timeout_s: float) -> bool:
        return await until(lambda: self.subscribers() > 0, timeout_s)

    async def close(self) -> None:
        if self._open:
            self._open = False
            self._node.drop(self._writer)
            self._closed(self)


def send(node: OwnNode, writer: Any, data: bytes, max_message_bytes: int, where: str) -> None:
    """Pass `data` to a writer.

    Raises:
        MessageTooBig, PublishBlocked, GraphError.
    """
    require_fit(where, len(data), max_message_bytes)
    fault = node.sender.write(writer, data)
    if fault == TIMEOUT:
        raise PublishBlocked(f"{where}: its reliable subscribers read too slowly; the message was not sent")
    if fault:
        raise GraphError(f"{where}: DDS did not accept the message (error {fault})")
