"""The replica: several brokers on one database, each with everything in memory, and all of one mind.

Every commit leaves a row in the feed that tells what it changed. Under the lock of its own commit a broker
first reads what the others did since it looked last. A write of its own that was made before that was known
here is overtaken: it is not stored, and its operation is carried out again with what is known then. So no
update is lost, and no id is given twice.
"""

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol, TypeVar
from uuid import uuid4

import orjson

from handover.telemetry import get_logger
from services.context_broker.storage.database import FateUnknown, NotStored, Writer
from services.context_broker.storage.entries import DocumentKey, Entries, Kind
from services.context_broker.storage.journal import Journal
from services.context_broker.storage.postgres import CHANNEL

log = get_logger(__name__)

NOTICES_A_COMMIT: Final = 1 << 24
"""Numbers of the outbox that belong to one number of the feed."""
WEIGHED: Final = frozenset({Kind.REGISTRATION, Kind.SOURCE_SUBSCRIPTION})
"""Kinds of documents that are weighed against all others of the tenant when one is written."""
SOURCES: Final = "sources"
DEPARTED: Final = "departed"
TRIMMING: Final = """
    DELETE FROM changes WHERE at < extract(epoch FROM clock_timestamp()) - 3600
    AND number < (SELECT max(number) FROM changes)
"""
"""The feed tells of the last hour; who was away for longer loads everything anew. The last row stays, to
count from."""
SURE_WITHIN: Final = 3
"""Attempts to learn what became of a commit during which the connection broke."""
BOOKKEEPING: Final = frozenset({Kind.COUNTS, Kind.ATTEMPTS, Kind.CONTEXT_USAGE})
"""Kinds of documents that nothing builds on: the last to write is right."""
FEED: Final = """
    CREATE TABLE IF NOT EXISTS changes (
        number BIGINT PRIMARY KEY, process TEXT NOT NULL, body BYTEA NOT NULL,
        at DOUBLE PRECISION NOT NULL DEFAULT extract(epoch FROM clock_timestamp())
    );
    INSERT INTO changes (number, process, body) VALUES (0, '', '[[],[],[],[]]') ON CONFLICT DO NOTHING
"""


class Overtaken(NotStored):
    """Another broker changed what this write builds on; it is to be made again from what is there now."""


class FeedLost(Exception):
    """The feed does not reach back to what was seen last."""


@dataclass(slots=True)
class News:
    """What others did, up to `number` of the feed: the latest state of everything that was touched."""

    number: int
    process: str
    """Who wrote that."""
    entities: dict[int, tuple[str, str, bytes | None]] = field(default_factory=dict)
    """Tenant, id and content by place in the order of creation."""
    documents: dict[DocumentKey, bytes | None] = field(default_factory=dict)
    owed: set[tuple[str, str]] = field(default_factory=set)
    """Tenant and id of the subscriptions to which something is owed."""
    departed: dict[int, tuple[str, str]] = field(default_factory=dict)
    """Tenant and id of what became history only, or no longer is it, by place."""
    is_everything: bool = False
    """Whether what is not told of is not there either."""

    def __bool__(self) -> bool:
        """Say whether there are any."""
        return bool(self.entities or self.documents or self.owed or self.departed or self.is_everything)

    def touched(self) -> Iterator[Hashable]:
        """Yield what writes must not have built on: entities, their places, documents, whole tenants."""
        for place, (tenant, entity_id, _) in self.entities.items():
            yield place
            yield tenant, entity_id
        for place, (tenant, entity_id) in self.departed.items():
            yield place
            yield DEPARTED, tenant, entity_id
        for key in self.documents:
            if key[0] not in BOOKKEEPING:
                yield key
            if key[0] in WEIGHED:
                yield SOURCES, key[1]
            if key[0] is Kind.SUBSCRIPTION:
                yield key[1]  # who is to be told of a change is decided when it is made


class Feed:
    """The order of all changes, as one broker reads and writes it; used by the thread that commits."""

    def __init__(self) -> None:
        self.process = uuid4().hex
        self._seen = (0, "")
        """Number and writer of the last row seen."""
        self._documents: set[DocumentKey] = set()
        """All that are known, so that it can be told which are gone when everything is loaded anew."""

    @property
    def number(self) -> int:
        """Return the number of the last row seen."""
        return self._seen[0]

    def open(self, writer: Writer) -> None:
        """Begin after the last change; call it before anything is loaded."""
        for statement in FEED.split(";"):
            writer.run(statement)
        self._to_the_end(writer)
        self._documents = {
            (Kind(kind), tenant, name)
            for kind, tenant, name in writer.run("SELECT kind, tenant, id FROM documents")
        }

    def news(self, writer: Writer) -> News:
        """Return what others did since; raise `FeedLost` if that cannot be told."""
        rows = writer.run(
            "SELECT number, process, body FROM changes WHERE number >= ? ORDER BY number", (self.number,)
        )
        if not rows or rows[0][:2] != self._seen:
            raise FeedLost
        news = News(*rows[-1][:2])
        for _, _, body in rows[1:]:
            _add(news, body)
        _complete(news, writer)
        return news

    def everything(self, writer: Writer) -> News:
        """Return all there is, as news."""
        self._to_the_end(writer)
        news = News(*self._seen, is_everything=True)
        news.documents = dict.fromkeys(self._documents)
        for place, tenant, body in writer.run("SELECT seq, tenant, body FROM entities ORDER BY seq"):
            news.entities[place] = (tenant, orjson.loads(body)[0], body)
        for kind, tenant, name, body in writer.run("SELECT kind, tenant, id, body FROM documents"):
            news.documents[Kind(kind), tenant, name] = body
        self._documents = set(news.documents)
        return news

    def tell(self, writer: Writer, news: News, entries: Entries) -> bool:
        """Tell the others what is written after `news`; say whether there was anything to tell."""
        body = _told(entries)
        if body is None:
            return False
        writer.run_many(
            "INSERT INTO changes (number, process, body) VALUES (?, ?, ?)",
            [(news.number + 1, self.process, body)],
        )
        writer.run_many(f"SELECT pg_notify('{CHANNEL}', ?)", [(self.process,)])
        return True

    def went_on(self, news: News, entries: Entries, *, told: bool) -> None:
        """Note what is seen now that the transaction is committed: the news, and what was told after them."""
        for documents in (news.documents, entries.documents):
            for key, body in documents.items():
                if body is None:
                    self._documents.discard(key)
                else:
                    self._documents.add(key)
        self._seen = (news.number + 1, self.process) if told else (news.number, news.process)

    def holds_own(self, writer: Writer, news: News) -> bool:
        """Say whether what was told after `news` is there."""
        rows = writer.run("SELECT process FROM changes WHERE number = ?", (news.number + 1,))
        return bool(rows) and rows[0][0] == self.process

    def _to_the_end(self, writer: Writer) -> None:
        ((number, process),) = writer.run("SELECT number, process FROM changes ORDER BY number DESC LIMIT 1")
        self._seen = (number, process)


def _told(entries: Entries) -> bytes | None:
    entities = [(place, row.tenant, row.id) for place, row in entries.entities.items()]
    documents = list(entries.documents)
    owed = list({(one.tenant, one.subscription) for one in entries.owed})
    departed = [(place, row.tenant, row.id) for place, row in entries.departed.items()]
    if not (entities or documents or owed or departed):
        return None
    return orjson.dumps([entities, documents, owed, departed])


def _add(news: News, body: bytes) -> None:
    entities, documents, owed, departed = orjson.loads(body)
    for place, tenant, entity_id in entities:
        news.entities[place] = (tenant, entity_id, None)
    for kind, tenant, name in documents:
        news.documents[Kind(kind), tenant, name] = None
    news.owed.update((tenant, one) for tenant, one in owed)
    news.departed.update((place, (tenant, one)) for place, tenant, one in departed)


def _complete(news: News, writer: Writer) -> None:
    """Put in how everything that was touched is now."""
    if news.entities:
        found = writer.run("SELECT seq, body FROM entities WHERE seq = ANY(?)", (list(news.entities),))
        for place, body in found:
            tenant, entity_id, _ = news.entities[place]
            news.entities[place] = (tenant, entity_id, body)
    for key in news.documents:
        rows = writer.run("SELECT body FROM documents WHERE kind = ? AND tenant = ? AND id = ?", key)
        news.documents[key] = rows[0][0] if rows else None


class Unknown:
    """What others did that the event loop may not have known when it made a write; used by the thread."""

    def __init__(self) -> None:
        self._numbers: dict[Hashable, int] = {}
        self._all_before = 0

    def note(self, news: News) -> None:
        """Note what the event loop is about to learn."""
        if news.is_everything:
            self._all_before = news.number
            return
        for key in news.touched():
            self._numbers[key] = news.number

    def overtakes(self, entries: Entries, known: int) -> bool:
        """Say whether a write that was made when `known` was the last news builds on what is no longer."""
        if known < self._all_before:
            return True
        numbers = self._numbers
        if not numbers:
            return False
        for key in entries.documents:
            if key[0] not in BOOKKEEPING and numbers.get(key, 0) > known:
                return True
            if key[0] in WEIGHED and numbers.get((SOURCES, key[1]), 0) > known:
                return True
        if any(
            numbers.get(key, 0) > known
            for place, gone in entries.departed.items()
            for key in (place, (DEPARTED, gone.tenant, gone.id))
        ):
            return True
        return any(
            numbers.get(key, 0) > known
            for place, row in entries.entities.items()
            for key in (place, (row.tenant, row.id), row.tenant)
        )

    def forget(self, known: int) -> None:
        """Forget what the event loop knows: all writes to come were made with it."""
        self._numbers = {key: number for key, number in self._numbers.items() if number > known}


class Made(Protocol):
    """A write, and the number of the last news that the event loop knew when it was made."""

    entries: Entries
    known: int


M = TypeVar("M", bound=Made)


class Replica:
    """Commits among others: reads their news first, and leaves out what they have overtaken."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._feed = Feed()
        self._unknown = Unknown()

    def open(self) -> int:
        """Begin; return the number up to which the journal is known once it is loaded after this."""
        with self._journal.transaction() as writer:
            self._feed.open(writer)
        return self._feed.number

    def commit(self, writes: Sequence[M]) -> tuple[News, list[M], list[M]]:
        """Write what may be written; return the news, what was written, and what was overtaken.

        The news come before what was written. Raises `NotStored` when nothing was written.
        """
        try:
            return self._commit(writes)
        except FeedLost:
            return self._reload(), [], list(writes)
        except NotStored as error:
            log.info("a commit is tried once more", error=str(error))
        try:  # for the connection may have died long ago, while nothing was to be done
            return self._commit(writes)
        except FeedLost:
            return self._reload(), [], list(writes)

    def look(self) -> News:
        """Return what others did."""
        return self.commit(())[0]

    def forget(self, known: int) -> None:
        """Forget news that every write to come was made with."""
        self._unknown.forget(known)

    def _commit(self, writes: Sequence[M]) -> tuple[News, list[M], list[M]]:
        standing: list[M] = []
        overtaken: list[M] = []
        tells = False
        try:
            with self._journal.transaction() as writer:
                news = self._feed.news(writer)
                self._unknown.note(news)
                together = Entries()
                for one in writes:
                    if self._unknown.overtakes(one.entries, one.known):
                        overtaken.append(one)
                    else:
                        standing.append(one)
                        together.add(one.entries)
                self._journal.write(writer, together, news.number * NOTICES_A_COMMIT)
                tells = self._feed.tell(writer, news, together)
        except FateUnknown as error:
            if not (tells and self._is_there(news)):
                raise NotStored(str(error)) from error
        self._feed.went_on(news, together, told=tells)
        return news, standing, overtaken

    def _is_there(self, news: News) -> bool:
        """Ask what became of a commit during which the connection broke."""
        for _ in range(SURE_WITHIN):
            try:
                with self._journal.transaction() as writer:  # which waits for the end of the one in question
                    return self._feed.holds_own(writer, news)
            except NotStored as error:
                log.warning("it is not known yet whether a commit went through", error=str(error))
        return False

    def _reload(self) -> News:
        log.warning("the feed of changes does not reach back far enough; everything is loaded anew")
        with self._journal.transaction() as writer:
            news = self._feed.everything(writer)
        self._unknown.note(news)
        return news
