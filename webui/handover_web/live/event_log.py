"""The event log: what happened in the cell, each event once, kept across restarts.

An event has a subject ("this Task") and a mark ("completed at 12:00:03"). Recording the same pair again has
no effect, so a repeated notification or a restart of the server adds nothing. The log keeps the newest
`MAX_EVENTS`.
"""

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any, Literal, Self

import orjson
from sqlalchemy import BigInteger, Column, Engine, MetaData, String, Table, Text, delete, insert, select
from sqlalchemy.exc import SQLAlchemyError

from handover.telemetry import get_logger
from handover_datamodels.times import iso, parse
from handover_web.live.views import LiveEvent
from handover_web.metrics import EVENTS

log = get_logger(__name__)

MAX_EVENTS = 10_000
MAX_EVENTS_PER_REQUEST = 1_000
MAX_SEQ = 2**53 - 1
"""The largest `seq` that a browser can state exactly; the database holds more."""
TRIM_INTERVAL_EVENTS = 200
CURRENT_PREFIX = "alert."
"""The keys of events that may be older than the log; they do not say since when it is complete."""
MAX_CLOCK_DIFFERENCE = timedelta(minutes=5)
"""A new log records events from this time before it, since the clocks of components differ."""

Level = Literal["info", "attention", "stop"]
OnEvent = Callable[[int, LiveEvent], None]

_meta = MetaData()
_events = Table(
    "webui_events",
    _meta,
    Column("seq", BigInteger, primary_key=True, autoincrement=False),
    Column("at", String(40), nullable=False),
    Column("level", String(10), nullable=False),
    Column("source", Text, nullable=False),
    Column("key", String(60), nullable=False),
    Column("values", Text, nullable=False),
    Column("text", Text, nullable=False),
    Column("subject", Text, nullable=False),
    Column("mark", Text, nullable=False),
)


@dataclass(frozen=True, slots=True)
class Event:
    """An event: the page translates `key` with `values`; `text` is in English."""

    subject: str
    mark: str
    key: str
    source: str
    text: str
    at: str
    level: Level = "info"
    values: Mapping[str, Any] = field(default_factory=dict)

    def view(self, seq: int) -> LiveEvent:
        """Return the event as sent to pages."""
        return {
            "seq": seq,
            "at": self.at,
            "level": self.level,
            "source": self.source,
            "key": self.key,
            "values": dict(self.values),
            "text": self.text,
        }


def timestamp() -> str:
    """Return the current time in the format of events."""
    return iso(datetime.now(UTC), "milliseconds")


def normalized_timestamp(timestamp_text: str | None) -> str:
    """Return an ISO 8601 timestamp in the format of events; the current time if it is none."""
    if timestamp_text:
        with suppress(ValueError):
            return iso(parse(timestamp_text), "milliseconds")
    return timestamp()


class EventLog:
    """Stores events and calls `on_event` for each when it is stored; an asynchronous context manager."""

    def __init__(self, engine: Engine, on_event: OnEvent) -> None:
        self._engine = engine
        self._on_event = on_event
        self._next_seq = 1
        self._oldest_at = iso(datetime.now(UTC) - MAX_CLOCK_DIFFERENCE, "milliseconds")
        self._recorded: OrderedDict[tuple[str, str], None] = OrderedDict()
        self._last_marks: OrderedDict[str, str] = OrderedDict()
        self._pending: list[tuple[int, Event]] = []
        self._has_pending = asyncio.Event()
        self._writer: asyncio.Task[None] | None = None
        self._since_trim = 0

    @property
    def oldest_at(self) -> str:
        """The time from which the log is complete; older events are recorded only if they are current."""
        return self._oldest_at

    def last_mark(self, subject: str) -> str | None:
        """Return the mark of the last event about `subject`."""
        return self._last_marks.get(subject)

    def last_marks(self) -> Mapping[str, str]:
        """Return the last mark of each subject."""
        return self._last_marks

    def record(self, event: Event, *, is_current: bool = False) -> bool:
        """Record an event; return False if it is recorded already, or older than the log.

        An event that says what is still the case (`is_current`) is recorded however old it is.
        """
        key = (event.subject, event.mark)
        if key in self._recorded or (event.at < self._oldest_at and not is_current):
            return False
        self._remember(*key)
        EVENTS.labels(event.key).inc()
        self._pending.append((self._next_seq, event))
        self._next_seq += 1
        self._has_pending.set()
        return True

    async def after(self, seq: int, limit: int) -> list[LiveEvent]:
        """Return the first `limit` events after `seq`, oldest first."""
        query = select(_events).where(_events.c.seq > seq).order_by(_events.c.seq).limit(limit)
        return await asyncio.to_thread(self._read, query)

    async def before(self, seq: int | None, limit: int) -> list[LiveEvent]:
        """Return the last `limit` events before `seq` (the newest of all if None), oldest first."""
        query = select(_events).order_by(_events.c.seq.desc()).limit(limit)
        if seq is not None:
            query = query.where(_events.c.seq < seq)
        return (await asyncio.to_thread(self._read, query))[::-1]

    async def __aenter__(self) -> Self:
        await asyncio.to_thread(self._open)
        for event in await self.before(None, 100):
            self._on_event(event["seq"], event)
        self._writer = asyncio.create_task(self._write_loop())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._writer is not None:
            self._writer.cancel()
            await asyncio.wait({self._writer})
        await self._flush()
        self._engine.dispose()

    def _open(self) -> None:
        _meta.create_all(self._engine)
        with self._engine.connect() as connection:
            rows = connection.execute(
                select(_events.c.seq, _events.c.at, _events.c.key, _events.c.subject, _events.c.mark)
                .order_by(_events.c.seq.desc())
                .limit(MAX_EVENTS)
            ).all()
        for row in reversed(rows):
            self._remember(row.subject, row.mark)
        if rows:
            self._next_seq = rows[0].seq + 1
            complete_from = [row.at for row in rows if not row.key.startswith(CURRENT_PREFIX)]
            self._oldest_at = min(complete_from, default=self._oldest_at)

    def _remember(self, subject: str, mark: str) -> None:
        self._recorded[subject, mark] = None
        self._last_marks[subject] = mark
        self._last_marks.move_to_end(subject)
        for memory in (self._recorded, self._last_marks):
            while len(memory) > 2 * MAX_EVENTS:
                memory.popitem(last=False)

    async def _write_loop(self) -> None:
        while True:
            await self._has_pending.wait()
            self._has_pending.clear()
            writing = asyncio.ensure_future(self._flush())
            try:
                await asyncio.shield(writing)
            except asyncio.CancelledError:
                await writing
                raise

    async def _flush(self) -> None:
        batch, self._pending = self._pending, []
        if not batch:
            return
        try:
            await asyncio.to_thread(self._write, batch)
        except SQLAlchemyError as error:  # pages show events even when the disk is full
            log.warning("events not stored", error=str(error).splitlines()[0])
        for seq, event in batch:
            self._on_event(seq, event.view(seq))

    def _write(self, batch: Sequence[tuple[int, Event]]) -> None:
        with self._engine.begin() as connection:
            connection.execute(
                insert(_events),
                [
                    {
                        **event.view(seq),
                        "values": orjson.dumps(dict(event.values)).decode(),
                        "subject": event.subject,
                        "mark": event.mark,
                    }
                    for seq, event in batch
                ],
            )
            self._since_trim += len(batch)
            if self._since_trim >= TRIM_INTERVAL_EVENTS:
                self._since_trim = 0
                connection.execute(delete(_events).where(_events.c.seq <= batch[-1][0] - MAX_EVENTS))

    def _read(self, query: Any) -> list[LiveEvent]:
        with self._engine.connect() as connection:
            return [
                {
                    "seq": row.seq,
                    "at": row.at,
                    "level": row.level,
                    "source": row.source,
                    "key": row.key,
                    "values": orjson.loads(row._mapping["values"]),
                    "text": row.text,
                }
                for row in connection.execute(query)
            ]
