"""Messages: those of the outbox to the broker, and those to processes."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Any


class MessageKind(StrEnum):
    """The kinds of writes to the broker; each is idempotent."""

    CREATE = "create"
    SPECIFY = "specify"
    """Write a row of the specification database, then create its Task, if it has one; or delete the row."""
    UPSERT = "upsert"
    DEFINE = "define"
    APPEND = "append"
    RAISE = "raise"
    CLEAR = "clear"
    DELETE = "delete"


@dataclass(frozen=True, slots=True)
class Message:
    """A message of the outbox; messages of one `stream` are delivered in the order of `seq`."""

    seq: int
    stream: str
    kind: MessageKind
    subject: str
    body: Any


class MessageOutcome(StrEnum):
    """What became of a message to a process."""

    DELIVERED = "delivered"
    STARTED = "started"
    STORED = "stored"
    DISCARDED = "discarded"


@dataclass(frozen=True, slots=True)
class MessageRecord:
    """A message to a process that nobody waited for yet."""

    id: str
    name: str
    key: Any
    variables: Mapping[str, Any]
    sender: str | None
    """The process that has sent it."""
    sent_at: datetime
    expires_at: datetime
    process: str | None = None
    """The only process that may get it; None: any that waits for it, or that it starts."""
