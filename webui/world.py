"""The world as the screen knows it: the newest value of every topic, the last events, and who is told.

A topic's value is written once, however many pages look. Each page has a `Reader`, which gathers what the
page has not been sent yet: of a topic only the newest value, so that a slow page lags but never piles up.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import orjson

GONE = orjson.Fragment(b"null")
KEPT_EVENTS = 100
"""Events that a page gets with its first look; the older ones it asks for."""
READER_EVENTS = 500
"""Events held for a page that does not read; what is beyond is a gap in `seq`, which the page fills."""


@dataclass(frozen=True, slots=True)
class Written:
    """A value as JSON, ready for every page."""

    json: bytes


def on_request(topic: str) -> bool:
    """Say whether a topic is sent only to pages that want it: the joints of a robot, and `people`."""
    return topic == "people" or (topic.startswith("robot/") and topic.endswith("/joints"))


class World:
    """The newest value of every topic, and the readers that are told when one changes."""

    def __init__(self) -> None:
        self._topics: dict[str, Written] = {}
        self._events: deque[tuple[int, Written]] = deque(maxlen=KEPT_EVENTS)
        self._readers: set[Reader] = set()

    def tell(self, topic: str, value: Any) -> bool:
        """Take `value` for the newest of `topic`; return whether it differs from the last."""
        written = Written(orjson.dumps(value, option=orjson.OPT_NON_STR_KEYS))
        if self._topics.get(topic) == written:
            return False
        self._topics[topic] = written
        self._announce(topic, written)
        return True

    def forget(self, topic: str) -> None:
        """Take `topic` for gone."""
        if self._topics.pop(topic, None) is not None:
            self._announce(topic, None)

    def happened(self, seq: int, event: Mapping[str, Any]) -> None:
        """Pass on an event; `seq` rises."""
        written = Written(orjson.dumps(event))
        self._events.append((seq, written))
        for reader in self._readers:
            reader.happened(written)

    def value(self, topic: str) -> Any:
        """Return the newest value of `topic`, None if there is none."""
        written = self._topics.get(topic)
        return None if written is None else orjson.loads(written.json)

    def names(self, family: str) -> list[str]:
        """Return the topics `family/…` that there are."""
        return [topic for topic in self._topics if topic.startswith(f"{family}/")]

    def written(self) -> Iterator[tuple[str, Written]]:
        """Yield every topic and its value."""
        yield from self._topics.items()

    def written_of(self, topic: str) -> Written | None:
        """Return the value of `topic` as JSON."""
        return self._topics.get(topic)

    def last_events(self) -> list[Written]:
        """Return the last events, the newest last."""
        return [written for _, written in self._events]

    def open_reader(self, on_news: Callable[[], None]) -> "Reader":
        """Return a reader for a page that has just come; `on_news` is called whenever there is some."""
        reader = Reader(self, on_news)
        self._readers.add(reader)
        return reader

    def close_reader(self, reader: "Reader") -> None:
        """Tell `reader` no more."""
        self._readers.discard(reader)

    def _announce(self, topic: str, written: Written | None) -> None:
        for reader in self._readers:
            reader.changed(topic, written)


class Reader:
    """What one page has not been sent yet; its first message is a snapshot of everything."""

    def __init__(self, world: World, on_news: Callable[[], None]) -> None:
        self._world = world
        self._on_news = on_news
        self._pending: dict[str, Written | None] = {}
        self._events: deque[Written] = deque(maxlen=READER_EVENTS)
        self._snapshot_due = True
        self.wanted: frozenset[str] = frozenset()
        self.overtaken = 0
        """Values that newer ones took the place of before the page was sent them."""

    def changed(self, topic: str, written: Written | None) -> None:
        """Take note of a new value, in place of an older one that was not sent."""
        if self._snapshot_due or not self._is_for_me(topic):
            return
        self.overtaken += topic in self._pending
        self._pending[topic] = written
        self._on_news()

    def happened(self, event: Written) -> None:
        """Take note of an event."""
        if not self._snapshot_due:
            self._events.append(event)
            self._on_news()

    def want(self, topics: Iterable[str]) -> None:
        """Take `topics` for what the page wants beyond the usual ones, in place of what it wanted before."""
        before, self.wanted = self.wanted, frozenset(topic for topic in topics if on_request(topic))
        for topic in before - self.wanted:
            self._pending.pop(topic, None)
        for topic in self.wanted - before:
            written = self._world.written_of(topic)
            if written is not None and not self._snapshot_due:
                self._pending[topic] = written
                self._on_news()

    def take(self, at: str) -> bytes:
        """Return the next message for the page, sent `at` a moment, and begin to gather anew."""
        kind = "snapshot" if self._snapshot_due else "batch"
        if self._snapshot_due:
            self._snapshot_due = False
            topics: Mapping[str, Written | None] = {
                topic: written for topic, written in self._world.written() if self._is_for_me(topic)
            }
            events = self._world.last_events()
        else:
            topics, events = self._pending, list(self._events)
        self._pending = {}
        self._events.clear()
        return orjson.dumps(
            {
                "type": kind,
                "at": at,
                "topics": {
                    topic: GONE if written is None else orjson.Fragment(written.json)
                    for topic, written in topics.items()
                },
                "events": [orjson.Fragment(event.json) for event in events],
            }
        )

    def _is_for_me(self, topic: str) -> bool:
        return not on_request(topic) or topic in self.wanted
