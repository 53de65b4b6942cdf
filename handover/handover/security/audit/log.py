"""The audit log: records of changes, chained by hashes, written in the transaction of the change.

Each record has the hash of the record before it, so that a record that is changed, removed or inserted later
breaks the chain (`verify`). A chain is complete only up to its head: a writer of the database can also
shorten the chain, so the head is exported and logged once a day (`head`).

Records name a random subject id. Free text (a name, a note) is kept beside the chain, and the record has only
its salted hash: a person can be deleted, with the text and the salt, and the chain remains verifiable.

    with engine.begin() as connection:
        connection.execute(insert(grants)…)
        audit.append(connection, caller.subject, "grant.added", resource=subject, text="operator on *")

A resource that names a person (an id of a Person entity) is replaced by a random alias, if the log has a
table of aliases: deleting the person deletes the alias, and the records name nobody any more.

A log may keep the names of its subjects: a person who asks who looked gets names also after an account was
deleted. A name is kept while a record of its subject is about somebody with an alias.

An act that is no transaction of the log's database has two records: the intent (outcome `intended`) before
it, and the outcome after it, whose `intent` is the number of the first. An intent without an outcome is the
trace of a process that ended in between: the act may have happened (`open_intents`).
"""

import secrets
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

from sqlalchemy import (
    ColumnElement,
    Connection,
    Float,
    Insert,
    ScalarSelect,
    String,
    Table,
    bindparam,
    delete,
    func,
    insert,
    select,
    update,
)
from sqlalchemy.dialects import postgresql, sqlite

from handover.security.audit.records import (
    GENESIS,
    INTENDED,
    AuditFilter,
    AuditRecord,
    Verification,
    fault_of,
    record_hash,
    text_hash,
)
from handover.security.audit.tables import AuditTables

MAX_TEXT_CHARACTERS: Final = 2000
_PERSON: Final = "urn:ngsi-ld:Person:"
_SALT_BYTES: Final = 16
_READ_ROWS: Final = 1000


class AuditLog:
    """Appends to, reads and verifies one audit log. Every method works on the connection of its caller."""

    def __init__(self, tables: AuditTables) -> None:
        self._tables = tables
        head = tables.head
        own = head.c.id == 1
        # Made once: building and comparing statements costs more than executing them.
        self._step = update(head).where(own).values(seq=head.c.seq + 1).returning(head.c.seq, head.c.hash)
        self._begin: Mapping[str, Insert] = {
            "sqlite": sqlite.insert(head).on_conflict_do_nothing(),
            "postgresql": postgresql.insert(head).on_conflict_do_nothing(),
        }
        self._insert_record = insert(tables.records)
        self._insert_text = insert(tables.texts)
        self._set_head = (
            update(head)
            .where(own)
            .values(hash=bindparam("new_hash", type_=String), changed_s=bindparam("now_s", type_=Float))
        )

    def append(
        self,
        connection: Connection,
        subject: str,
        action: str,
        *,
        resource: str = "",
        outcome: str = "done",
        method: str = "",
        text: str | None = None,
        is_personal: bool = False,
        name: str | None = None,
        intent: int | None = None,
        at_ms: int | None = None,
    ) -> int:
        """Append a record in the transaction of `connection`; return its number.

        `is_personal`: the resource names a person in another way than by the id of a Person. `name` is that
        of the subject, for a log that keeps names. `intent` is the number of the intent whose outcome this
        is, in a log with intents; `at_ms` the time of an act that was not recorded at once.
        The row of the head is locked until the transaction ends, so that concurrent appends are ordered.
        """
        seq, previous = self._next(connection)
        resource = self._aliased(connection, resource[:400], is_personal=is_personal)
        text = text[:MAX_TEXT_CHARACTERS] if text is not None else None
        salt = secrets.token_hex(_SALT_BYTES) if text is not None else ""
        values: dict[str, Any] = {
            "seq": seq,
            "at_ms": time.time_ns() // 1_000_000 if at_ms is None else at_ms,
            "subject": subject,
            "action": action,
            "resource": resource,
            "outcome": outcome,
            "method": method,
            "text_hash": "" if text is None else text_hash(salt, text),
            "previous_hash": previous,
        }
        if self._tables.has_intents:
            values["intent"] = intent
        values["hash"] = record_hash(values)
        connection.execute(self._insert_record, values)
        if text is not None:
            of_text = {
                "seq": seq,
                "subject": subject,
                "about": values["resource"],
                "salt": salt,
                "text": text,
            }
            connection.execute(self._insert_text, of_text)
        connection.execute(self._set_head, {"new_hash": values["hash"], "now_s": time.time()})
        if name:
            self._keep_name(connection, subject, name)
        return seq

    def _keep_name(self, connection: Connection, subject: str, name: str) -> None:
        names = self._tables.names
        if names is None:
            return
        name, own = name[:200], names.c.subject == subject
        kept = connection.execute(select(names.c.name).where(own)).scalar()
        if kept is None:
            connection.execute(insert(names).values(subject=subject, name=name))
        elif kept != name:
            connection.execute(update(names).where(own).values(name=name))

    def names(self, connection: Connection, subjects: Iterable[str]) -> dict[str, str]:
        """Return the names that are kept of `subjects`."""
        names = self._tables.names
        if names is None:
            return {}
        query = select(names.c.subject, names.c.name).where(names.c.subject.in_(list(subjects)))
        return {str(subject): str(name) for subject, name in connection.execute(query)}

    def _delete_names(self, connection: Connection) -> None:
        """Delete the names of subjects without a record about somebody with an alias."""
        names, aliases, records = self._tables.names, self._tables.aliases, self._tables.records
        if names is None or aliases is None:
            return
        needed = select(records.c.subject).where(records.c.resource.in_(select(aliases.c.alias)))
        connection.execute(delete(names).where(names.c.subject.not_in(needed)))

    def _next(self, connection: Connection) -> tuple[int, str]:
        row = connection.execute(self._step).first()
        if row is None:  # the first record; another connection may write it now, then this one is after it
            new = {"id": 1, "seq": 0, "hash": GENESIS, "first_seq": 1, "first_previous_hash": GENESIS}
            connection.execute(self._begin[connection.dialect.name], {**new, "changed_s": time.time()})
            row = connection.execute(self._step).one()
        return int(row[0]), str(row[1])

    def _aliased(self, connection: Connection, resource: str, *, is_personal: bool) -> str:
        """Return the alias of a resource that names a person, a new one if necessary; others unchanged."""
        aliases = self._tables.aliases
        if aliases is None or not (is_personal or resource.startswith(_PERSON)):
            return resource
        alias = connection.execute(select(aliases.c.alias).where(aliases.c.name == resource)).scalar()
        if alias is None:
            alias = f"person-{secrets.token_hex(12)}"
            connection.execute(insert(aliases).values(name=resource, alias=alias))
        return str(alias)

    def forget(self, connection: Connection, name: str) -> int:
        """Delete the texts by and about a subject or Person, and the alias of the Person.

        The records remain, and the chain stays verifiable. Returns how many texts were deleted.
        """
        texts, aliases = self._tables.texts, self._tables.aliases
        names = [name]
        if aliases is not None:
            names += connection.execute(select(aliases.c.alias).where(aliases.c.name == name)).scalars()
            connection.execute(delete(aliases).where(aliases.c.name == name))
        self._delete_names(connection)
        gone = connection.execute(delete(texts).where(texts.c.subject.in_(names) | texts.c.about.in_(names)))
        return gone.rowcount

    def aliased(self, connection: Connection) -> list[str]:
        """Return the resources that have an alias."""
        aliases = self._tables.aliases
        return [] if aliases is None else list(connection.execute(select(aliases.c.name)).scalars())

    def expire(self, connection: Connection, before_ms: int) -> int:
        """Delete the records older than `before_ms` from the start of the chain; return how many."""
        records, texts, head = self._tables.records, self._tables.texts, self._tables.head
        last = connection.execute(select(func.max(records.c.seq)).where(records.c.at_ms < before_ms)).scalar()
        if last is None:
            return 0
        kept = connection.execute(
            select(records.c.seq)
            .where(records.c.seq <= last, records.c.at_ms >= before_ms)
            .order_by(records.c.seq)
        ).scalar()
        last = kept - 1 if kept is not None else last  # the clock was set back: keep the rest of the chain
        row = connection.execute(select(records.c.hash).where(records.c.seq == last)).scalar()
        if row is None:
            return 0
        connection.execute(
            update(head).where(head.c.id == 1).values(first_seq=last + 1, first_previous_hash=row)
        )
        connection.execute(delete(texts).where(texts.c.seq <= last))
        gone = connection.execute(delete(records).where(records.c.seq <= last)).rowcount
        self._delete_names(connection)
        return gone

    def head(self, connection: Connection) -> tuple[int, str]:
        """Return number and hash of the last record; (0, `GENESIS`) if there is none."""
        head = self._tables.head
        row = connection.execute(select(head.c.seq, head.c.hash).where(head.c.id == 1)).first()
        return (0, GENESIS) if row is None else (int(row[0]), str(row[1]))

    def read(
        self,
        connection: Connection,
        *,
        chosen: "AuditFilter | None" = None,
        after: int = 0,
        limit: int = 100,
        newest_first: bool = False,
        is_short: bool = False,
    ) -> list[AuditRecord]:
        """Return the records that pass a filter; `after` continues a list (before it if newest first).

        A short list leaves out each intent whose outcome is recorded, unless it asks for intents.
        """
        records, texts, aliases = self._tables.records, self._tables.texts, self._tables.aliases
        source = records.outerjoin(texts, texts.c.seq == records.c.seq)
        resource: ColumnElement[str] = records.c.resource
        if aliases is not None:
            source = source.outerjoin(aliases, aliases.c.alias == records.c.resource)
            resource = func.coalesce(aliases.c.name, records.c.resource)
        others = [column for column in records.c if column.name != "resource"]
        chosen = chosen or AuditFilter()
        columns = [*others, resource.label("resource"), texts.c.text]
        if self._tables.has_intents:
            ended_by = self._ended_by()
            columns.append(ended_by.label("ended_by"))
            if is_short and chosen.outcome != INTENDED:
                is_open = (records.c.outcome != INTENDED) | ended_by.is_(None)
                query = select(*columns).select_from(source).where(is_open)
            else:
                query = select(*columns).select_from(source)
        else:
            query = select(*columns).select_from(source)
        query = query.where(*_conditions(chosen, records, resource))
        if newest_first:
            query = query.where(records.c.seq < after) if after else query
            query = query.order_by(records.c.seq.desc())
        else:
            query = query.where(records.c.seq > after).order_by(records.c.seq)
        return [AuditRecord(**row) for row in connection.execute(query.limit(limit)).mappings()]

    def _ended_by(self) -> ScalarSelect[int]:
        """Return the number of the first record with the outcome of an intent, as a column."""
        records = self._tables.records
        ends = records.alias("ends")
        first = select(func.min(ends.c.seq)).where(ends.c.intent == records.c.seq)
        return first.correlate(records).scalar_subquery()

    def has(self, connection: Connection, *, seq: int, action: str) -> bool:
        """Return whether there is a record with this number and action."""
        records = self._tables.records
        query = select(records.c.action).where(records.c.seq == seq)
        return connection.execute(query).scalar() == action

    def open_intents(self, connection: Connection) -> list[int]:
        """Return the numbers of the intents without an outcome, the oldest first."""
        if not self._tables.has_intents:
            return []
        records = self._tables.records
        query = select(records.c.seq).where(records.c.outcome == INTENDED, self._ended_by().is_(None))
        return [int(seq) for seq in connection.execute(query.order_by(records.c.seq)).scalars()]

    def verify(self, connection: Connection) -> Verification:
        """Check every record, from the first to the head."""
        head = self._tables.head
        row = connection.execute(select(head).where(head.c.id == 1)).mappings().first()
        if row is None:
            return Verification(0, GENESIS)
        expected, previous, count = int(row["first_seq"]), str(row["first_previous_hash"]), 0
        for record, salt, text in self._chain(connection):
            fault = fault_of(record, expected, previous, salt, text)
            if fault is not None:
                return Verification(count, previous, fault)
            expected, previous, count = expected + 1, record["hash"], count + 1
        if previous != row["hash"] or expected != int(row["seq"]) + 1:
            return Verification(
                count,
                previous,
                f"records after number {expected - 1} are missing; the head names {row['seq']}",
            )
        return Verification(count, previous)

    def _chain(self, connection: Connection) -> Iterator[tuple[dict[str, Any], str | None, str | None]]:
        records, texts = self._tables.records, self._tables.texts
        query = (
            select(records, texts.c.salt, texts.c.text)
            .select_from(records.outerjoin(texts, texts.c.seq == records.c.seq))
            .order_by(records.c.seq)
        )
        for row in connection.execution_options(yield_per=_READ_ROWS).execute(query).mappings():
            values = dict(row)
            salt, text = values.pop("salt"), values.pop("text")
            yield values, salt, text


def _conditions(
    chosen: AuditFilter, records: Table, resource: ColumnElement[str]
) -> Iterator[ColumnElement[bool]]:
    if chosen.subject is not None:
        yield records.c.subject == chosen.subject
    if chosen.action is not None:
        yield records.c.action.contains(chosen.action, autoescape=True)
    if chosen.resource is not None:
        yield resource.contains(chosen.resource, autoescape=True)
    if chosen.about is not None:
        yield resource == chosen.about
    if chosen.outcome is not None:
        yield records.c.outcome == chosen.outcome
    if chosen.since_ms is not None:
        yield records.c.at_ms >= chosen.since_ms
    if chosen.until_ms is not None:
        yield records.c.at_ms < chosen.until_ms
