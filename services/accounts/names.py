"""The audit log of accounts as the common routes read it, with the names of its subjects."""

from collections.abc import Callable
from typing import Any

from sqlalchemy import Connection, select

from handover.security.caller import Caller
from services.accounts import tables
from services.accounts.directory import Directory


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


def subject_names(connection: Connection) -> dict[str, str]:
    """Return the names of users and tokens by subject."""
    names: dict[str, str] = {}
    for table in (tables.users, tables.tokens):
        names.update({row[0]: row[1] for row in connection.execute(select(table.c.subject, table.c.name))})
    return names
