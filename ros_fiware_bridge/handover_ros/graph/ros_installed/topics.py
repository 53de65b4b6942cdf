"""Topics over an installed ROS, as CDR."""

import time
from collections.abc import Callable
from typing import Any

from handover_ros.errors import GraphClosed
from handover_ros.graph.base_graph import require_fit
from handover_ros.graph.inbox import Inbox, hash_differs
from handover_ros.graph.port import Message, OnMessage
from handover_ros.graph.qos import Qos
from handover_ros.graph.ros_installed.own_node import OwnRosNode, hash_of, interface, profile
from handover_ros.graph.waiting import until

_MIN_READER_DEPTH = 256
_RECHECK_INTERVAL_S = 1.0


class RosSubscription(Inbox):
    """A subscription to a topic; see `port.Subscription`."""

    def __init__(
        self,
        node: OwnRosNode,
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
        self._hash = node.store.hash(type_name)
        self._checked_s = 0.0
        self._why_not: str | None = None
        self._subscription = node.node.create_subscription(
            interface(type_name, node.store),
            topic,
            self._came,
            profile(qos, max(qos.depth, _MIN_READER_DEPTH)),
            callback_group=None,  # the default group runs one callback at a time and keeps the order
            raw=True,
        )

    def _came(self, data: bytes, info: Any) -> None:
        if self._open:
            # rclpy does not report which publisher sent it; one with another definition blocks the topic.
            now_s = time.monotonic()
            if now_s - self._checked_s > _RECHECK_INTERVAL_S:
                self._checked_s, self._why_not = now_s, self._differs()
            sent_ns = info["source_timestamp"] or 0
            self.put(bytes(data), sent_ns=sent_ns, ours=None, why_not=self._why_not)

    def _differs(self) -> str | None:
        for publisher in self._node.node.get_publishers_info_by_topic(self.topic):
            who = f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
            why_not = hash_differs(self.topic, self.type_name, self._hash, hash_of(publisher), who)
            if why_not is not None:
                return why_not
        return None

    def publishers(self) -> int:
        """Return how many publishers are on the topic."""
        return int(self._node.node.count_publishers(self.topic)) if self._open else 0

    async def matched(self, timeout_s: float) -> bool:
        """Wait until a publisher is on the topic."""
        return await until(lambda: self.publishers() > 0, timeout_s)

    async def close(self) -> None:
        if self.shut():
            self._node.node.destroy_subscription(self._subscription)
            self._closed(self)


class RosPublisher:
    """A publisher on a topic; see `port.Publisher`."""

    def __init__(
        self,
        node: OwnRosNode,
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
        self._publisher = node.node.create_publisher(interface(type_name, node.store), topic, profile(qos))

    def publish(self, message: Message) -> None:
        if not self._open:
            raise GraphClosed(f"{self.topic} was closed; nothing can be published on it")
        data = self._node.store.encode(self.type_name, message)
        require_fit(self.topic, len(data), self._max_message_bytes)
        self._publisher.publish(data)
        self.published += 1

    def subscribers(self) -> int:
        return int(self._publisher.get_subscription_count()) if self._open else 0

    async def matched(self, timeout_s: float) -> bool:
        return await until(lambda: self.subscribers() > 0, timeout_s)

    async def close(self) -> None:
        if self._open:
            self._open = False
            self._node.node.destroy_publisher(self._publisher)
            self._closed(self)
