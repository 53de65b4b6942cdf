"""Topics by way of a rosbridge server."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ros_fiware_bridge.errors import BadMessage, GraphClosed, PublishBlocked
from ros_fiware_bridge.graph.inbox import Inbox
from ros_fiware_bridge.graph.member import require_fit
from ros_fiware_bridge.graph.port import Message, OnMessage
from ros_fiware_bridge.graph.qos import Durability, Qos
from ros_fiware_bridge.graph.rosbridge.forms import Forms
from ros_fiware_bridge.graph.rosbridge.link import FRAGMENT_CHARACTERS, Link, Op
from ros_fiware_bridge.graph.rosbridge.view import RosapiView
from ros_fiware_bridge.graph.waiting import until


@dataclass(frozen=True, slots=True)
class Desk:
    """What topics need: the link, the forms of messages, who is on the graph, how big is too big."""

    link: Link
    forms: Forms
    view: RosapiView
    most_bytes: int


class RosbridgeSubscription(Inbox):
    """A topic that is listened to; see `port.Subscription`."""

    def __init__(
        self,
        desk: Desk,
        topic: str,
        type_name: str,
        qos: Qos,
        *,
        on_message: OnMessage,
        closed: Callable[[Any], None],
    ) -> None:
        super().__init__(
            desk.forms.store, topic, type_name, qos, on_message=on_message, most_bytes=desk.most_bytes
        )
        self._link, self._forms, self._view = desk.link, desk.forms, desk.view
        self._closed = closed
        self._id = self._link.new_id(f"subscribe:{topic}")
        self._link.on("publish", self._came)
        self._link.on_opening(self._ask)
        self._ask()

    def _ask(self) -> None:
        self._link.send(
            op="subscribe",
            id=self._id,
            topic=self.topic,
            type=self._forms.type_name(self.type_name),
            throttle_rate=0,
            queue_length=self.qos.depth,
            fragment_size=FRAGMENT_CHARACTERS,
        )

    def _came(self, operation: Op) -> None:
        if operation.get("topic") != self.topic or not self._open:
            return
        data, why_not = b"", None
        try:
            data = self._forms.from_json(self.type_name, operation.get("msg"))
        except BadMessage as error:
            why_not = f"{self.topic}: {error}"
        self.put(data, sent_ns=0, ours=None, why_not=why_not)

    def publishers(self) -> int:
        """Return how many nodes publish the topic, as the server said last."""
        return self._view.publishers(self.topic) if self._open else 0

    async def matched(self, timeout_s: float) -> bool:
        """Wait until a node publishes the topic."""
        self._view.look_now()
        return await until(lambda: self.publishers() > 0, timeout_s)

    async def close(self) -> None:
        """Stop listening."""
        if self.shut():
            self._link.off("publish", self._came)
            self._link.off_opening(self._ask)
            if self._link.is_open:
                self._link.send(op="unsubscribe", id=self._id, topic=self.topic)
            self._closed(self)


class RosbridgePublisher:
    """A topic that is spoken on; see `port.Publisher`."""

    def __init__(
        self,
        desk: Desk,
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
        self._link, self._forms, self._view = desk.link, desk.forms, desk.view
        self._most_bytes = desk.most_bytes
        self._closed = closed
        self._open = True
        self._last: Message | None = None
        self._id = self._link.new_id(f"advertise:{topic}")
        self._link.on_opening(self._advertise)
        self._advertise()

    def _advertise(self) -> None:
        latched = self.qos.durability is Durability.TRANSIENT_LOCAL
        self._link.send(
            op="advertise",
            id=self._id,
            topic=self.topic,
            type=self._forms.type_name(self.type_name),
            latch=latched,
            queue_size=self.qos.depth,
        )
        if latched and self._last is not None:  # the server that kept it may be another one
            self._link.send(op="publish", topic=self.topic, msg=self._last)

    def publish(self, message: Message) -> None:
        """Send `message`."""
        if not self._open:
            raise GraphClosed(f"{self.topic} was closed; nothing can be published on it")
        written, size = self._forms.to_json(self.type_name, message)
        require_fit(self.topic, size, self._most_bytes)
        try:
            self._link.send(op="publish", topic=self.topic, msg=written)
        except PublishBlocked as error:
            raise PublishBlocked(f"{self.topic}: {error}") from None
        self._last = written
        self.published += 1

    def subscribers(self) -> int:
        """Return how many nodes listen to the topic, as the server said last."""
        return self._view.subscribers(self.topic) if self._open else 0

    async def matched(self, timeout_s: float) -> bool:
        """Wait until a node listens to the topic."""
        self._view.look_now()
        return await until(lambda: self.subscribers() > 0, timeout_s)

    async def close(self) -> None:
        """Stop speaking."""
        if self._open:
            self._open = False
            self._link.off_opening(self._advertise)
            if self._link.is_open:
                self._link.send(op="unadvertise", id=self._id, topic=self.topic)
            self._closed(self)
