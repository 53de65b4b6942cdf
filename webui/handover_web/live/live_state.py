"""The live state of the cell: the newest value of every topic, the recent events, and one `Viewer` per page.

A value is encoded once, however many pages are open. Each `Viewer` collects what its page has not received
yet. It keeps only the newest value of a topic, so a slow page lags but its queue does not grow.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import orjson

from handover.security.resource_patterns import ANY_RESOURCE
from handover_web.live.views import LiveEvent

DELETED = orjson.Fragment(b"null")
MAX_SNAPSHOT_EVENTS = 100
"""Events in a snapshot. A page requests older events by REST."""
MAX_PENDING_EVENTS = 500
"""Events held for a page that does not read. The page requests dropped events when it sees a gap in `seq`."""

Resources = tuple[str, ...]
"""Entity ids, or `*` for everything; a user needs the permission to read one of them. None: everybody may."""
EVERYTHING: Final[Resources] = (ANY_RESOURCE,)
MAX_REMEMBERED = 10_000
"""Decisions on resources that a page remembers."""


@dataclass(frozen=True, slots=True)
class EncodedValue:
    """A value as JSON, shared by all pages; `partial` is for users who may not read everything."""

    json: bytes
    resources: Resources = ()
    partial: "EncodedValue | None" = None


REGISTERED_DEVICES: Final = "registeredDevices"
"""A page that subscribes to this topic receives all topics that begin with `REGISTERED_DEVICE` as well."""
PULSE: Final = "pulse"
"""A topic without a value: a page that subscribes to it gets batches more often, to notice a halt sooner."""
REGISTERED_DEVICE: Final = "registeredDevice/"
_DEVICE_FAMILIES: Final = ("device/", REGISTERED_DEVICE)

MayRead = Callable[[str], bool]
"""Whether the user of a page may read an entity."""


def subscription_of(topic: str) -> str | None:
    """Return the topic that pages subscribe to for receiving `topic`; None if every page receives it."""
    if topic.startswith(REGISTERED_DEVICE):
        return REGISTERED_DEVICES
    is_stream = topic.startswith("robot/") and topic.endswith("/joints")
    return topic if is_stream or topic in {"people", PULSE, REGISTERED_DEVICES} else None


def resources_of(topic: str) -> Resources:
    """Return the resources of a topic whose publisher names none: the Device of a topic of Devices."""
    return (topic.partition("/")[2],) if topic.startswith(_DEVICE_FAMILIES) else ()


def _encode(value: Any) -> bytes:
    return orjson.dumps(value, option=orjson.OPT_NON_STR_KEYS)


class Reader:
    """The user of one page; the rights may change while the page is open."""

    def __init__(self, may_read: MayRead = lambda _: True) -> None:
        self.may_read = may_read
        self.on_change: Callable[[], None] = lambda: None

    def change(self, may_read: MayRead) -> None:
        """Replace the rights; the page gets a snapshot of what its user may read now."""
        self.may_read = may_read
        self.on_change()


class LiveState:
    """The newest value of every topic, and the viewers that are notified of a change."""

    def __init__(self) -> None:
        self._topics: dict[str, EncodedValue] = {}
        self._events: deque[tuple[int, EncodedValue]] = deque(maxlen=MAX_SNAPSHOT_EVENTS)
        self._viewers: set[Viewer] = set()

    def publish(
        self, topic: str, value: Any, resources: Resources | None = None, *, partial: Any = None
    ) -> bool:
        """Set the value of `topic`; return whether it differs from the previous one.

        Pages whose users may read one of `resources` receive it, all pages if there are none. `partial` is
        the value for users who may not read everything, if it is another one.
        """
        encoded = EncodedValue(
            _encode(value),
            resources_of(topic) if resources is None else tuple(resources),
            None if partial is None else EncodedValue(_encode(partial)),
        )
        previous = self._topics.get(topic)
        if previous == encoded:
            return False
        self._topics[topic] = encoded
        for viewer in self._viewers:
            viewer.set_topic(topic, encoded, previous)
        return True

    def remove(self, topic: str) -> None:
        """Delete `topic`."""
        previous = self._topics.pop(topic, None)
        if previous is not None:
            for viewer in self._viewers:
                viewer.set_topic(topic, None, previous)

    def publish_event(self, seq: int, event: LiveEvent) -> None:
        """Send an event to all pages; `seq` increases."""
        encoded = EncodedValue(orjson.dumps(event))
        self._events.append((seq, encoded))
        for viewer in self._viewers:
            viewer.add_event(encoded)

    def value(self, topic: str) -> Any:
        """Return the newest value of `topic`, None if there is none."""
        encoded = self._topics.get(topic)
        return None if encoded is None else orjson.loads(encoded.json)

    def topics_of(self, family: str) -> list[str]:
        """Return the topics named `family/…`."""
        return [topic for topic in self._topics if topic.startswith(f"{family}/")]

    def items(self) -> Iterator[tuple[str, EncodedValue]]:
        """Yield every topic and its value."""
        yield from self._topics.items()

    def encoded(self, topic: str) -> EncodedValue | None:
        """Return the value of `topic` as JSON."""
        return self._topics.get(topic)

    def resources(self, topic: str) -> Resources:
        """Return the resources of the newest value of `topic`."""
        encoded = self._topics.get(topic)
        return () if encoded is None else encoded.resources

    def recent_events(self) -> list[EncodedValue]:
        """Return the recent events, oldest first."""
        return [encoded for _, encoded in self._events]

    def add_viewer(self, on_change: Callable[[], None], reader: Reader | None = None) -> "Viewer":
        """Return a viewer for a new page; `on_change` is called when it has something to send."""
        viewer = Viewer(self, on_change, reader or Reader())
        self._viewers.add(viewer)
        return viewer

    def remove_viewer(self, viewer: "Viewer") -> None:
        """Stop notifying `viewer`."""
        self._viewers.discard(viewer)


class Viewer:
    """The changes that one page has not received yet; its first message is a snapshot."""

    def __init__(self, state: LiveState, on_change: Callable[[], None], reader: Reader) -> None:
        self._state = state
        self._on_change = on_change
        self._reader = reader
        reader.on_change = self._on_rights_changed
        self._allowed: dict[Resources, bool] = {}
        self._pending: dict[str, EncodedValue | None] = {}
        self._events: deque[EncodedValue] = deque(maxlen=MAX_PENDING_EVENTS)
        self._is_snapshot_due = True
        self.subscribed: frozenset[str] = frozenset()
        self.coalesced_count = 0
        """Values that a newer value replaced before the page received them."""

    def set_topic(self, topic: str, encoded: EncodedValue | None, previous: EncodedValue | None) -> None:
        """Queue a value, in place of an older one of the same topic; None for a deleted topic.

        A topic that the user may read no more, since it is about another resource now, is deleted too.
        """
        if self._is_snapshot_due or not self._is_subscribed(topic):
            return
        if encoded is None or not self._may_read(encoded.resources):
            if previous is None or not self._may_read(previous.resources):
                return
            encoded = None
        self.coalesced_count += topic in self._pending
        self._pending[topic] = encoded
        self._on_change()

    def add_event(self, event: EncodedValue) -> None:
        """Queue an event."""
        if not self._is_snapshot_due and self._may_read(EVERYTHING):
            self._events.append(event)
            self._on_change()

    def subscribe(self, topics: Iterable[str]) -> None:
        """Replace the on-demand topics that the page receives; other topics are ignored."""
        before = self.subscribed
        self.subscribed = frozenset(topic for topic in topics if subscription_of(topic) == topic)
        for topic in [topic for topic in self._pending if not self._is_subscribed(topic)]:
            del self._pending[topic]
        added = self.subscribed - before
        if not added or self._is_snapshot_due:
            return
        if PULSE in added:
            self._on_change()
        for topic, encoded in self._state.items():
            if subscription_of(topic) in added and self._receives(topic, encoded):
                self._pending[topic] = encoded
                self._on_change()

    def next_message(self, at: str) -> bytes:
        """Return the next message for the page, with the timestamp `at`, and clear the queue."""
        kind = "snapshot" if self._is_snapshot_due else "batch"
        if self._is_snapshot_due:
            self._is_snapshot_due = False
            topics: Mapping[str, EncodedValue | None] = {
                topic: encoded for topic, encoded in self._state.items() if self._receives(topic, encoded)
            }
            events = self._state.recent_events() if self._may_read(EVERYTHING) else []
        else:
            topics, events = self._pending, list(self._events)
        self._pending = {}
        self._events.clear()
        return orjson.dumps(
            {
                "type": kind,
                "at": at,
                "topics": {
                    topic: DELETED if encoded is None else orjson.Fragment(self._value_of(encoded).json)
                    for topic, encoded in topics.items()
                },
                "events": [orjson.Fragment(event.json) for event in events],
            }
        )

    def _receives(self, topic: str, encoded: EncodedValue) -> bool:
        return self._is_subscribed(topic) and self._may_read(encoded.resources)

    def _is_subscribed(self, topic: str) -> bool:
        subscription = subscription_of(topic)
        return subscription is None or subscription in self.subscribed

    def _may_read(self, resources: Resources) -> bool:
        if resources not in self._allowed:
            if len(self._allowed) >= MAX_REMEMBERED:
                self._allowed.clear()
            may_read = self._reader.may_read
            self._allowed[resources] = not resources or any(may_read(resource) for resource in resources)
        return self._allowed[resources]

    def _value_of(self, encoded: EncodedValue) -> EncodedValue:
        return encoded if encoded.partial is None or self._may_read(EVERYTHING) else encoded.partial

    def _on_rights_changed(self) -> None:
        self._allowed.clear()
        self._is_snapshot_due = True
        self._on_change()
