"""Databases of services: SQLite files and PostgreSQL."""

from handover.database.connection import (
    LOCK_POLL_S,
    DatabaseLock,
    LockLost,
    connect,
    purge_log,
)

__all__ = [
    "LOCK_POLL_S",
    "DatabaseLock",
    "LockLost",
    "connect",
    "purge_log",
]
