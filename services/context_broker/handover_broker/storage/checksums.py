"""Checksums of rows: 32 bits over all columns, stored with the row and compared when it is read.

A flipped bit in the database file changes a row or its checksum, so no wrong value is served.
"""

import struct
from collections.abc import Callable, Sequence
from struct import Struct
from typing import Any, Final
from zlib import crc32

_SEQ: Final = Struct("<q")
_CHANGE: Final = Struct("<qqqdd")
_NOTICE: Final = Struct("<qd")
_NOTHING: Final = float("-inf")
"""Stands for a missing time; no time has this value."""


def of_entity(seq: int, tenant: str, body: bytes) -> int:
    """Return the checksum of a row of `entities`."""
    return crc32(body, crc32(tenant.encode(), crc32(_SEQ.pack(seq))))


def of_document(kind: str, tenant: str, name: str, body: bytes) -> int:
    """Return the checksum of a row of `documents`."""
    return crc32(body, crc32(f"{kind}\0{tenant}\0{name}".encode()))


def of_notice(  # noqa: PLR0917 - as the row has them
    seq: int,
    tenant: str,
    subscription: str,
    entity: str,
    at: float,
    body: bytes | None,
    headers: bytes | None,
) -> int:
    """Return the checksum of a row of `outbox`."""
    head = crc32(f"{tenant}\0{subscription}\0{entity}\0{body is None}{headers is None}".encode())
    return crc32(headers or b"", crc32(body or b"", crc32(_NOTICE.pack(seq, at), head)))


def of_change(  # noqa: PLR0917 - as the row has them
    entity: int,
    seq: int,
    observed_from: float | None,
    observed_to: float | None,
    rewritten: int,
    body: bytes,
) -> int:
    """Return the checksum of a row of `history`."""
    first = _NOTHING if observed_from is None else observed_from
    last = _NOTHING if observed_to is None else observed_to
    return crc32(body, crc32(_CHANGE.pack(entity, seq, rewritten, first, last)))


def of_temporal_only(seq: int, tenant: str, name: str, body: bytes) -> int:
    """Return the checksum of a row of `temporal_only_entities`."""
    return crc32(body, crc32(f"{tenant}\0{name}".encode(), crc32(_SEQ.pack(seq))))


def of_state(database_id: str, log_id: str, checkpointed: int, is_open: int) -> int:
    """Return the checksum of the row of `log_state`."""
    return crc32(f"{database_id} {log_id} {checkpointed} {is_open}".encode())


def holds(of: Callable[..., int], checksum: Any, row: Sequence[Any]) -> bool:
    """Return whether a row has the checksum that `of` computes; damage may have changed its types too."""
    try:
        return bool(of(*row) == checksum)
    except (TypeError, ValueError, AttributeError, OverflowError, struct.error):
        return False


def require_row(
    of: Callable[..., int], checksum: Any, row: Sequence[Any], damaged: Callable[[Sequence[Any]], Exception]
) -> None:
    """Raise the error that `damaged` returns for a row without its checksum."""
    if not holds(of, checksum, row):
        raise damaged(row)
