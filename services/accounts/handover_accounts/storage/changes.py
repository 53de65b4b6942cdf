"""Changes: one transaction has a change, its revocations, and at least one audit record.

    with store.change(caller.subject) as change:
        change.connection.execute(delete(grants)…)
        change.revoke(subject)
        change.record("grant.removed", subject, text="operator on *")

Changes are ordered by a lock, so what a change reads remains true until it is committed.
"""

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

from sqlalchemy import Column, Connection, Engine, delete, insert, select, update

from handover.database import connect, purge_log
from handover.database.migrations import migrate
from handover.security.audit import AuditLog
from handover.security.revocations import KEPT_S
from handover_accounts.storage import tables

COMPONENT: Final = "accounts"


class Change:
    """A transaction of `actor`, a subject; `method` says how the actor was identified."""

    def __init__(self, connection: Connection, audit: AuditLog, actor: str, method: str) -> None:
        self.connection = connection
        self.actor = actor
        self.is_recorded = False
        self._audit = audit
        self._method = method

    def record(
        self, action: str, resource: str = "", *, text: str | None = None, outcome: str = "done"
    ) -> None:
        """Append an audit record; personal data belongs into `text`, which can be deleted."""
        self._audit.append(
            self.connection,
            self.actor,
            action,
            resource=resource,
            text=text,
            outcome=outcome,
            method=self._method,
        )
        self.is_recorded = True

    def revoke(self, name: str) -> int:
        """Make the access tokens of a subject or session invalid; return the number of the revocation."""
        now_s = time.time()
        number = int(
            self.connection.execute(
                update(tables.state)
                .where(tables.state.c.id == 1)
                .values(revision=tables.state.c.revision + 1)
                .returning(tables.state.c.revision)
            ).scalar_one()
        )
        table = tables.revocations
        self.connection.execute(delete(table).where(table.c.at_s < now_s - KEPT_S))
        self.connection.execute(insert(table).values(number=number, name=name, at_s=now_s))
        return number


class Store:
    """The database of accounts; every method blocks for the disk."""

    def __init__(self, url: str) -> None:
        self.engine: Engine = connect(url)
        self.audit = AuditLog(tables.audit)
        self._writing = threading.Lock()
        self._is_sqlite = self.engine.dialect.name == "sqlite"

    def prepare(self) -> None:
        """Create the tables, or bring them forward."""
        migrate(
            self.engine,
            tables.metadata,
            component=COMPONENT,
            version=tables.VERSION,
            steps=dict.fromkeys(range(1, tables.VERSION), tables.metadata.create_all),
        )
        with self._locked() as connection:
            if connection.execute(select(tables.state.c.id)).scalar() is None:
                connection.execute(insert(tables.state).values(id=1, revision=0))

    def close(self) -> None:
        """Close the connections."""
        self.engine.dispose()

    @contextmanager
    def change(self, actor: str, method: str = "") -> Iterator[Change]:
        """Yield a change that is committed at the end, durably; an exception rolls it back."""
        with self._locked() as connection:
            change = Change(connection, self.audit, actor, method)
            yield change
            if not change.is_recorded:
                raise AssertionError("a change without an audit record")

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """Yield a connection for reading."""
        with self.engine.begin() as connection:
            yield connection

    @contextmanager
    def _locked(self) -> Iterator[Connection]:
        # Threads wait here in order; those that wait for SQLite poll, and some would wait too long.
        with self._writing, self.engine.begin() as connection:
            if self._is_sqlite:
                connection.exec_driver_sql("PRAGMA secure_delete=ON")
                connection.exec_driver_sql("BEGIN IMMEDIATE")  # the driver begins only with the first write
            else:
                connection.execute(select(tables.state.c.id).with_for_update())
            yield connection

    def note_uses(self, uses: Mapping[Column[Any], Mapping[str, float]]) -> None:
        """Set the times of the last use: a column, and Unix times by the primary key of its table."""
        with self._locked() as connection:
            for column, times in uses.items():
                (key,) = column.table.primary_key.columns
                for name, at_s in times.items():
                    connection.execute(update(column.table).where(key == name).values({column.name: at_s}))

    def empty_journal(self) -> None:
        """Remove deleted data from the journal of SQLite too."""
        purge_log(self.engine)


def revision_of(connection: Connection) -> int:
    """Return the number of the last revocation. Read before grants, so that a token is never too new."""
    return int(connection.execute(select(tables.state.c.revision)).scalar() or 0)
