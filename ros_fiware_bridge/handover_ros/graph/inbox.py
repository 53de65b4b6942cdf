"""The inbox of a subscription: passes messages from the threads of an adapter to the event loop."""

import asyncio
import time
from collections import deque

import structlog

from handover_ros.errors import BadMessage
from handover_ros.graph.port import Message, OnMessage
from handover_ros.graph.qos import History, Qos
from handover_ros.types.excerpt import FieldNames
from handover_ros.types.type_store import TypeStore

log = structlog.get_logger(__name__)

_MAX_QUEUED = 1000


class RawReceived:
    """A received message, decoded on first access; see `port.Received`."""

    __slots__ = ("_data", "_message", "_store", "ours", "received_at_s", "sent_at_s", "topic", "type_name")

    def __init__(
        self, store: TypeStore, topic: str, type_name: str, data: bytes, *, sent_ns: int, ours: bool | None
    ) -> None:
        self._store = store
        self._data = data
        self._message: Message | None = None
        self.topic = topic
        self.type_name = type_name
        self.received_at_s = time.time()
        self.sent_at_s = sent_ns / 1e9 if sent_ns > 0 else None
        self.ours = ours

    @property
    def size_bytes(self) -> int:
        """The size on the wire, with 4 bytes of header."""
        return len(self._data)

    @property
    def message(self) -> Message:
        """The whole message."""
        if self._message is None:
            self._message = self._store.decode(self.type_name, self._data)
        return self._message

    def excerpt(self, fields: frozenset[FieldNames]) -> Message:
        """Return those fields of the message."""
        if self._message is not None or () in fields:
            return self.message
        return self._store.excerpt(self.type_name, self._data, fields)


class Inbox:
    """The base class of all subscriptions: a bounded queue to the loop; see `port.Subscription`."""

    def __init__(
        self,
        store: TypeStore,
        topic: str,
        type_name: str,
        qos: Qos,
        *,
        on_message: OnMessage,
        max_message_bytes: int,
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.qos = qos
        self.received = 0
        self.dropped = 0
        self.refused = 0
        self.last_error: str | None = None
        self._store = store
        self._on_message = on_message
        self._max_message_bytes = max_message_bytes
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[RawReceived] = deque()
        self._max_queued = _MAX_QUEUED if qos.history is History.KEEP_ALL else qos.depth
        self._called = False
        self._open = True

    def put(self, data: bytes, *, sent_ns: int, ours: bool | None, why_not: str | None = None) -> None:
        """Queue a message from a thread of the adapter, or refuse it for the reason `why_not`."""
        self.received += 1
        if why_not is None and len(data) > self._max_message_bytes:
            why_not = (
                f"{self.topic}: a message has {len(data)} bytes, {self._max_message_bytes} are allowed; "
                "raise the limit if such messages are expected"
            )
        if why_not is not None:
            self.refused += 1
            self.last_error = why_not
            return
        if len(self._waiting) >= self._max_queued:
            self._waiting.popleft()
            self.dropped += 1
        self._waiting.append(
            RawReceived(self._store, self.topic, self.type_name, data, sent_ns=sent_ns, ours=ours)
        )
        if not self._called:
            self._called = True
            try:
                self._loop.call_soon_threadsafe(self._deliver)
            except RuntimeError:  # the loop is closed
                self._open = False

    def _deliver(self) -> None:
        self._called = False
        for _ in range(len(self._waiting)):
            if not self._open:
                return
            try:
                received = self._waiting.popleft()
            except IndexError:  # dropped meanwhile
                return
            try:
                self._on_message(received)
            except BadMessage as error:
                self.refused += 1
                self.last_error = str(error)
            except Exception as error:  # an error of the callback must not end the subscription
                self.last_error = f"{type(error).__name__}: {error}"
                log.exception("processing a message failed", topic=self.topic)

    def shut(self) -> bool:
        """Stop delivering; return whether the inbox was open."""
        was_open, self._open = self._open, False
        self._waiting.clear()
        return was_open


def hash_differs(topic: str, type_name: str, ours: str, theirs: str | None, who: str) -> str | None:
    """Return the error text for a peer with another definition; None if its hash is the same or unknown."""
    if theirs is None or theirs == ours:
        return None
    return (
        f"{topic}: {who} has another definition of {type_name} (its hash is {theirs}, ours is {ours}); "
        "name the files of its definition in type_paths"
    )
