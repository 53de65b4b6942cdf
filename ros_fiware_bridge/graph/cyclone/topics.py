"""Topics over DDS: what comes in is decoded only when it is looked at; what goes out goes at once."""

import asyncio
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import structlog

from ros_fiware_bridge.errors import BadMessage, GraphClosed, GraphError, MessageTooBig, PublishBlocked
from ros_fiware_bridge.graph.cyclone import dds_names
from ros_fiware_bridge.graph.cyclone.node import OwnNode
from ros_fiware_bridge.graph.cyclone.samples import TIMEOUT, Sample
from ros_fiware_bridge.graph.port import Message, OnMessage
from ros_fiware_bridge.graph.qos import History, Qos
from ros_fiware_bridge.graph.waiting import until
from ros_fiware_bridge.types.type_store import TypeStore

log = structlog.get_logger(__name__)

_MOST_WAITING = 1000
_MOST_WRITERS_REMEMBERED = 1000


class CycloneReceived:
    """A message as it came; see `port.Received`."""

    __slots__ = ("_data", "_message", "_store", "ours", "received_at_s", "sent_at_s", "topic", "type_name")

    def __init__(
        self,
        store: TypeStore,
        topic: str,
        type_name: str,
        data: bytes,
        *,
        received_at_s: float,
        sent_at_s: float | None,
        ours: bool,
    ) -> None:
        self._store = store
        self._data = data
        self._message: Message | None = None
        self.topic = topic
        self.type_name = type_name
        self.received_at_s = received_at_s
        self.sent_at_s = sent_at_s
        self.ours: bool | None = ours

    @property
    def size_bytes(self) -> int:
        """How long it is on the wire, with its 4 bytes of header."""
        return len(self._data)

    @property
    def message(self) -> Message:
        """The whole message."""
        if self._message is None:
            self._message = self._store.decode(self.type_name, self._data)
        return self._message

    def value(self, path: str) -> Any:
        """Return one field."""
        return self._store.field(self.type_name, path).of(self.message)


class CycloneSubscription:
    """A topic that is listened to; see `port.Subscription`."""

    def __init__(
        self,
        node: OwnNode,
        topic: str,
        type_name: str,
        qos: Qos,
        *,
        on_message: OnMessage,
        most_bytes: int,
        closed: Callable[[Any], None],
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.qos = qos
        self.received = 0
        self.dropped = 0
        self.refused = 0
        self.last_error: str | None = None
        self._node = node
        self._on_message = on_message
        self._most_bytes = most_bytes
        self._closed = closed
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[CycloneReceived] = deque()
        self._most_waiting = _MOST_WAITING if qos.history is History.KEEP_ALL else qos.depth
        self._called = False
        self._open = True
        # For each writer: why it is not listened to (None: it is), and whether it is ours.
        self._writers: dict[int, tuple[str | None, bool]] = {}
        self._hash = node.store.hash(type_name)
        self._reader = node.reader(dds_names.of_topic(topic), type_name, qos, user={"typehash": self._hash})
        self._stop = node.listening.to_samples(self._reader, self._on_samples)

    def _on_samples(self, samples: list[Sample]) -> None:
        now_s = time.time()
        for sample in samples:
            data = sample.data
            if data is None:
                self._writers.pop(sample.writer, None)
                continue
            self.received += 1
            why_not, ours = self._writers.get(sample.writer) or self._met(sample.writer)
            if why_not is None and len(data) > self._most_bytes:
                why_not = (
                    f"{self.topic}: a message of {len(data)} bytes came, {self._most_bytes} are allowed; "
                    "raise the limit if such messages are meant"
                )
            if why_not is not None:
                self.refused += 1
                self.last_error = why_not
                continue
            if len(self._waiting) >= self._most_waiting:
                self._waiting.popleft()
                self.dropped += 1
            sent_at_s = sample.sent_ns / 1e9 if sample.sent_ns > 0 else None
            self._waiting.append(
                CycloneReceived(
                    self._node.store,
                    self.topic,
                    self.type_name,
                    data,
                    received_at_s=now_s,
                    sent_at_s=sent_at_s,
                    ours=ours,
                )
            )
        if self._waiting and not self._called:
            self._called = True
            try:
                self._loop.call_soon_threadsafe(self._deliver)
            except RuntimeError:  # the loop is closed: nobody is there to be told
                self._open = False

    def _met(self, handle: int) -> tuple[str | None, bool]:
        discovery = self._node.discovery
        writer = discovery.writer(handle)
        if writer is None:
            discovery.look()
            writer = discovery.writer(handle)
        if writer is None:
            return None, False
        verdict = (
            hash_differs(self.topic, self.type_name, self._hash, writer.type_hash, writer.vendor),
            writer.participant == discovery.own,
        )
        if len(self._writers) >= _MOST_WRITERS_REMEMBERED:
            self._writers.clear()
        self._writers[handle] = verdict
        return verdict

    def _deliver(self) -> None:
        self._called = False
        for _ in range(len(self._waiting)):
            if not self._open:
                return
            try:
                received = self._waiting.popleft()
            except IndexError:  # overtaken and dropped meanwhile
                return
            try:
                self._on_message(received)
            except BadMessage as error:
                self.refused += 1
                self.last_error = str(error)
            except Exception as error:  # the subscription goes on, whatever its user does
                self.last_error = f"{type(error).__name__}: {error}"
                log.exception("a message of the ROS graph was not dealt with", topic=self.topic)

    def publishers(self) -> int:
        """Return how many publishers are matched."""
        return len(self._reader.get_matched_publications()) if self._open else 0

    async def matched(self, timeout_s: float) -> bool:
        """Wait until a publisher is matched."""
        return await until(lambda: self.publishers() > 0, timeout_s)

    async def close(self) -> None:
        """Stop listening."""
        if self._open:
            self._open = False
            self._stop()
            self._node.drop(self._reader)
            self._waiting.clear()
            self._closed(self)


class CyclonePublisher:
    """A topic that is spoken on; see `port.Publisher`."""

    def __init__(
        self,
        node: OwnNode,
        topic: str,
        type_name: str,
        qos: Qos,
        *,
        most_bytes: int,
        closed: Callable[[Any], None],
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.qos = qos
        self.published = 0
        self._node = node
        self._most_bytes = most_bytes
        self._closed = closed
        self._open = True
        user = {"typehash": node.store.hash(type_name)}
        self._writer = node.writer(dds_names.of_topic(topic), type_name, qos, user=user)

    def publish(self, message: Message) -> None:
        """Send `message`."""
        if not self._open:
            raise GraphClosed(f"{self.topic} was closed; nothing can be published on it")
        data = self._node.store.encode(self.type_name, message)
        send(self._node, self._writer, data, self._most_bytes, self.topic)
        self.published += 1

    def subscribers(self) -> int:
        """Return how many subscribers are matched."""
        return len(self._writer.get_matched_subscriptions()) if self._open else 0

    async def matched(self, timeout_s: float) -> bool:
        """Wait until a subscriber is matched."""
        return await until(lambda: self.subscribers() > 0, timeout_s)

    async def close(self) -> None:
        """Stop speaking."""
        if self._open:
            self._open = False
            self._node.drop(self._writer)
            self._closed(self)


def send(node: OwnNode, writer: Any, data: bytes, most_bytes: int, where: str) -> None:
    """Hand `data` to a writer.

    Raises:
        MessageTooBig, PublishBlocked, GraphError.
    """
    if len(data) > most_bytes:
        raise MessageTooBig(
            f"{where}: a message of {len(data)} bytes is too big, {most_bytes} are allowed; raise the limit "
            "if it is meant"
        )
    fault = node.sender.write(writer, data)
    if fault == TIMEOUT:
        raise PublishBlocked(f"{where}: its reliable subscribers take too slowly; the message was not sent")
    if fault:
        raise GraphError(f"{where}: DDS did not take the message (fault {fault})")


def hash_differs(topic: str, type_name: str, ours: str, theirs: str | None, vendor: str) -> str | None:
    """Say that a peer means another type by the same name; None if it means the same, or does not tell."""
    if theirs is None or theirs == ours:
        return None
    return (
        f"{topic}: a publisher ({vendor}) has another definition of {type_name} (its hash is {theirs}, ours "
        f"is {ours}); name the files of the robot's definition in type_paths"
    )
