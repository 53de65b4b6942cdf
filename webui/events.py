"""Events: what has happened on the shop floor, each told once, kept across restarts.

An event has a subject ("this Task") and a mark ("completed at 12:00:03"): whoever tells the same again, a
doubled notification or a server that was started anew, adds nothing. The newest `KEPT` are kept.
"""

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Literal, Self

import orjson
from sqlalchemy import BigInteger, Column, Engine, MetaData, String, Table, Text, delete, insert, select
from sqlalchemy.exc import SQLAlchemyError

from datamodels.times import iso, parse
from handover.telemetry import get_logger
from webui.metrics import EVENTS

log = get_logger(__name__)

KEPT = 10_000
MOST_AT_ONCE = 1_000
MAX_SEQ = 2**53 - 1
"""The largest `seq` that a browser can state exactly; the database holds more."""
_TRIM_EVERY = 200

Level = Literal["info", "attention", "stop"]
Told = Callable[[int, Mapping[str, Any]], None]

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
class Happening:
    """Something that happened: `key` and `values` are for the page's languages, `text` is in English."""

    subject: str
    mark: str
    key: str
    source: str
    text: str
    at: str
    level: Level = "info"
    values: Mapping[str, str | int | float] = field(default_factory=dict)

    def as_event(self, seq: int) -> dict[str, Any]:
        """Return the event as pages get it."""
        return {
            "seq": seq,
            "at": self.at,
            "level": self.level,
            "source": self.source,
            "key": self.key,
            "values": dict(self.values),
            "text": self.text,
        }


def now() -> str:
    """Return this moment as events have it."""
    return iso(datetime.now(UTC), "milliseconds")


def in_milliseconds(moment: str | None) -> str:
    """Return `moment` in the one form that marks are compared in; this moment if it is none."""
    if moment:
        with suppress(ValueError):
            return iso(parse(moment), "milliseconds")
    return now()


class EventLog:
    """Takes happenings, keeps them, and passes each on to `told` once it is kept.

    An asynchronous context manager while it is open; `record` may be called at any time between.
    """

    def __init__(self, engine: Engine, told: Told) -> None:
        self._engine = engine
        self._told = told
        self._next_seq = 1
        self._began = now()
        self._known: OrderedDict[tuple[str, str], None] = OrderedDict()
        self._last: OrderedDict[str, str] = OrderedDict()
        self._waiting: list[tuple[int, Happening]] = []
        self._something_waits = asyncio.Event()
        self._writer: asyncio.Task[None] | None = None
        self._since_trim = 0

    @property
    def began(self) -> str:
        """Return since when events are kept: what happened before is no news."""
        return self._began

    def last_mark(self, subject: str) -> str | None:
        """Return the mark of the last event about `subject`."""
        return self._last.get(subject)

    def subjects(self) -> Mapping[str, str]:
        """Return the last mark of every subject that is remembered."""
        return self._last

    def record(self, happening: Happening) -> bool:
        """Take a happening; return False if it is known already, or older than the log."""
        known = (happening.subject, happening.mark)
        if known in self._known or happening.at < self._began:
            return False
        self._remember(*known)
        EVENTS.labels(happening.key).inc()
        self._waiting.append((self._next_seq, happening))
        self._next_seq += 1
        self._something_waits.set()
        return True

    async def after(self, seq: int, limit: int) -> list[dict[str, Any]]:
        """Return the first `limit` events after `seq`, oldest first."""
        chosen = select(_events).where(_events.c.seq > seq).order_by(_events.c.seq).limit(limit)
        return await asyncio.to_thread(self._read, chosen)

    async def before(self, seq: int | None, limit: int) -> list[dict[str, Any]]:
        """Return the last `limit` events before `seq` (the newest of all if None), oldest first."""
        chosen = select(_events).order_by(_events.c.seq.desc()).limit(limit)
        if seq is not None:
            chosen = chosen.where(_events.c.seq < seq)
        return (await asyncio.to_thread(self._read, chosen))[::-1]

    async def __aenter__(self) -> Self:
        await asyncio.to_thread(self._open)
        for event in await self.before(None, 100):
            self._told(event["seq"], event)
        self._writer = asyncio.create_task(self._keep_writing())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._writer is not None:
            self._writer.cancel()
            await asyncio.wait({self._writer})
        await self._write_waiting()
        self._engine.dispose()

    # Within

    def _open(self) -> None:
        _meta.create_all(self._engine)
        with self._engine.connect() as connection:
            rows = connection.execute(
                select(_events.c.seq, _events.c.at, _events.c.subject, _events.c.mark)
                .order_by(_events.c.seq.desc())
                .limit(KEPT)
            ).all()
        for row in reversed(rows):
            self._remember(row.subject, row.mark)
        if rows:
            self._next_seq = rows[0].seq + 1
            self._began = min(row.at for row in rows)

    def _remember(self, subject: str, mark: str) -> None:
        self._known[subject, mark] = None
        self._last[subject] = mark
        self._last.move_to_end(subject)
        for memory in (self._known, self._last):
            while len(memory) > 2 * KEPT:
                memory.popitem(last=False)

    async def _keep_writing(self) -> None:
        while True:
            await self._something_waits.wait()
            self._something_waits.clear()
            writing = asyncio.ensure_future(self._write_waiting())
            try:
                await asyncio.shield(writing)
            except asyncio.CancelledError:
                await writing
                raise

    async def _write_waiting(self) -> None:
        batch, self._waiting = self._waiting, []
        if not batch:
            return
        try:
            await asyncio.to_thread(self._write, batch)
        except SQLAlchemyError as error:  # people must see what happens, even on a full disk
            log.warning("events could not be kept", count=len(batch), error=str(error).splitlines()[0])
        for seq, happening in batch:
            self._told(seq, happening.as_event(seq))

    def _write(self, batch: Sequence[tuple[int, Happening]]) -> None:
        with self._engine.begin() as connection:
            connection.execute(
                insert(_events),
                [
                    {
                        **happening.as_event(seq),
                        "values": orjson.dumps(dict(happening.values)).decode(),
                        "subject": happening.subject,
                        "mark": happening.mark,
                    }
                    for seq, happening in batch
                ],
            )
            self._since_trim += len(batch)
            if self._since_trim >= _TRIM_EVERY:
                self._since_trim = 0
                connection.execute(delete(_events).where(_events.c.seq <= batch[-1][0] - KEPT))

    def _read(self, chosen: Any) -> list[dict[str, Any]]:
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
                for row in connection.execute(chosen)
            ]
