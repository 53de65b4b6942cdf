"""The audit log of accounts as the common routes read it, with the names of its subjects."""

from collections.abc import Callable
from typing import Any

from sqlalchemy import Connection, select

from handover.security.caller import Caller
from handover_accounts.directory import Directory
from handover_accounts.storage import tables
from handover_accounts.storage.links import LINK_ID


class AccountsAudit:
    """The audit log in the database of accounts; its records are those of changes."""

    service = "accounts"

    def __init__(self, directory: Directory) -> None:
        self._directory = directory
        self.log = directory.store.audit

    async def read(self, function: Callable[[Connection], Any]) -> Any:
        """Return the result of `function` on a connection."""
        return await self._directory.read(function)

    async def record(self, caller: Caller, action: str, resource: str) -> None:
        """Append a record."""
        await self._directory.change(caller.subject, lambda change: change.record(action, resource))


def _used_links(connection: Connection) -> dict[str, str]:
    """Return the names of the users whom links have added or given a password, by the ids of the links.

    The subject of what a link did is its id. The name of a user who was deleted since is forgotten.
    """
    records = tables.audit.records.c
    made = (
        select(records.subject, tables.users.c.name)
        .join(tables.users, tables.users.c.subject == records.resource)
        .where(records.subject.startswith(LINK_ID))
    )
    return {row[0]: row[1] for row in connection.execute(made)}


def subject_names(connection: Connection) -> dict[str, str]:
    """Return the names of users and tokens by subject."""
    names = _used_links(connection)
    for table in (tables.users, tables.tokens):
        names.update({row[0]: row[1] for row in connection.execute(select(table.c.subject, table.c.name))})
    return names
