"""The live state of the cell: the newest value of every topic, the recent events, and one `Viewer` per page.

A value is encoded once, however many pages are open. Each `Viewer` collects what its page has not received
yet. It keeps only the newest value of a topic, so a slow page lags but its queue does not grow.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import orjson

from webui.live.views import LiveEvent

DELETED = orjson.Fragment(b"null")
MAX_SNAPSHOT_EVENTS = 100
"""Events in a snapshot. A page requests older events by REST."""
MAX_PENDING_EVENTS = 500
"""Events held for a page that does not read. The page requests dropped events when it sees a gap in `seq`."""


@dataclass(frozen=True, slots=True)
class EncodedValue:
    """A value as JSON, shared by all pages."""

    json: bytes


def is_on_demand(topic: str) -> bool:
    """Whether a topic is sent to subscribed pages only: the joints of a robot, and `people`."""
    return topic == "people" or (topic.startswith("robot/") and topic.endswith("/joints"))


class LiveState:
    """The newest value of every topic, and the viewers that are notified of a change."""

    def __init__(self) -> None:
        self._topics: dict[str, EncodedValue] = {}
        self._events: deque[tuple[int, EncodedValue]] = deque(maxlen=MAX_SNAPSHOT_EVENTS)
        self._viewers: set[Viewer] = set()

    def publish(self, topic: str, value: Any) -> bool:
        """Set the value of `topic`; return whether it differs from the previous one."""
        encoded = EncodedValue(orjson.dumps(value, option=orjson.OPT_NON_STR_KEYS))
        if self._topics.get(topic) == encoded:
            return False
        self._topics[topic] = encoded
        self._notify(topic, encoded)
        return True

    def remove(self, topic: str) -> None:
        """Delete `topic`."""
        if self._topics.pop(topic, None) is not None:
            self._notify(topic, None)

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

    def recent_events(self) -> list[EncodedValue]:
        """Return the recent events, oldest first."""
        return [encoded for _, encoded in self._events]

    def add_viewer(self, on_change: Callable[[], None]) -> "Viewer":
        """Return a viewer for a new page; `on_change` is called when it has something to send."""
        viewer = Viewer(self, on_change)
        self._viewers.add(viewer)
        return viewer

    def remove_viewer(self, viewer: "Viewer") -> None:
        """Stop notifying `viewer`."""
        self._viewers.discard(viewer)

    def _notify(self, topic: str, encoded: EncodedValue | None) -> None:
        for viewer in self._viewers:
            viewer.set_topic(topic, encoded)


class Viewer:
    """The changes that one page has not received yet; its first message is a snapshot."""

    def __init__(self, state: LiveState, on_change: Callable[[], None]) -> None:
        self._state = state
        self._on_change = on_change
        self._pending: dict[str, EncodedValue | None] = {}
        self._events: deque[EncodedValue] = deque(maxlen=MAX_PENDING_EVENTS)
        self._is_snapshot_due = True
        self.subscribed: frozenset[str] = frozenset()
        self.coalesced_count = 0
        """Values that a newer value replaced before the page received them."""

    def set_topic(self, topic: str, encoded: EncodedValue | None) -> None:
        """Queue a value, in place of an older one of the same topic; None for a deleted topic."""
        if self._is_snapshot_due or not self._receives(topic):
            return
        self.coalesced_count += topic in self._pending
        self._pending[topic] = encoded
        self._on_change()

    def add_event(self, event: EncodedValue) -> None:
        """Queue an event."""
        if not self._is_snapshot_due:
            self._events.append(event)
            self._on_change()

    def subscribe(self, topics: Iterable[str]) -> None:
        """Replace the on-demand topics that the page receives; other topics are ignored."""
        before, self.subscribed = self.subscribed, frozenset(topic for topic in topics if is_on_demand(topic))
        for topic in before - self.subscribed:
            self._pending.pop(topic, None)
        for topic in self.subscribed - before:
            encoded = self._state.encoded(topic)
            if encoded is not None and not self._is_snapshot_due:
                self._pending[topic] = encoded
                self._on_change()

    def next_message(self, at: str) -> bytes:
        """Return the next message for the page, with the timestamp `at`, and clear the queue."""
        kind = "snapshot" if self._is_snapshot_due else "batch"
        if self._is_snapshot_due:
            self._is_snapshot_due = False
            topics: Mapping[str, EncodedValue | None] = {
                topic: encoded for topic, encoded in self._state.items() if self._receives(topic)
            }
            events = self._state.recent_events()
        else:
            topics, events = self._pending, list(self._events)
        self._pending = {}
        self._events.clear()
        return orjson.dumps(
            {
                "type": kind,
                "at": at,
                "topics": {
                    topic: DELETED if encoded is None else orjson.Fragment(encoded.json)
                    for topic, encoded in topics.items()
                },
                "events": [orjson.Fragment(event.json) for event in events],
            }
        )

    def _receives(self, topic: str) -> bool:
        return not is_on_demand(topic) or topic in self.subscribed
