"""The content of a broker's write-ahead log in readable form: `handover broker inspect`. It writes nothing.

Both files are read as they are, also those of a running broker, which may change them meanwhile. Unlike the
start of the broker it stops at nothing: damaged and interrupted frames are listed with the others.
"""

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import orjson

from handover.errors import UsageError
from services.context_broker.storage.entries import Entries
from services.context_broker.storage.records import decoded
from services.context_broker.storage.write_ahead_log import Frame, WriteAheadLog

_COUNTED = ("entities", "documents", "pending", "settled", "history", "cleared", "departed")


def describe(path: Path) -> Iterator[str]:
    """Yield lines about the log beside the database `path`. Raises `UsageError` if there is none."""
    log, checkpointed = _log(path), _checkpointed(path)
    yield f"{path}: the tables have everything up to change {checkpointed}"
    for file, stamp in log.stamps():
        if stamp is None:
            yield f"{file}: its first page is damaged, or is not of this format"
            continue
        state = "closed, everything is in the tables" if stamp.is_closed else "open"
        yield f"{file}: database {stamp.database.hex()}, opening {stamp.opening.hex()}, {state}"
        for frame in log.frames(file):
            yield f"  byte {frame.offset:>8}  {_summary(frame, checkpointed)}"


def records(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the complete records of the log beside `path` as JSON, in the order of their numbers."""
    log = _log(path)
    frames = [frame for file, _ in log.stamps() for frame in log.frames(file) if frame.record is not None]
    checkpointed = _checkpointed(path)
    for frame in sorted(frames, key=lambda frame: frame.number):
        yield {
            "number": frame.number,
            "inTables": frame.number <= checkpointed,
            **_document(decoded(frame.record or b"")),
        }


def _log(path: Path) -> WriteAheadLog:
    log = WriteAheadLog(path)
    if not log.exists():
        names = " and ".join(str(file) for file in log.paths)
        raise UsageError(f"there is no log to inspect: {names}; name the directory with --data-dir")
    return log


def _checkpointed(path: Path) -> int:
    """Return the number of the last change in the tables; 0 if the tables cannot say it."""
    if not path.exists():
        return 0
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=5)) as reader:
            rows = reader.execute("SELECT checkpointed FROM log_state").fetchall()
    except sqlite3.Error:
        return 0
    return int(rows[0][0]) if rows else 0


def _summary(frame: Frame, checkpointed: int) -> str:
    if frame.is_damaged:
        return "damaged: some sectors are neither old nor new"
    if frame.record is None:
        return f"after change {frame.number}: void or interrupted, never acknowledged"
    entries = decoded(frame.record)
    counts = [f"{len(getattr(entries, name))} {name}" for name in _COUNTED if getattr(entries, name)]
    where = "in the tables" if frame.number <= checkpointed else "in the log only"
    return f"change {frame.number}, {len(frame.record)} bytes, {where}: {', '.join(counts) or 'nothing'}"


def _document(entries: Entries) -> Mapping[str, Any]:
    found: dict[str, Any] = {
        "entities": [
            {"sequence": sequence, "tenant": row.tenant, "id": row.id, "body": _json(row.body)}
            for sequence, row in entries.entities.items()
        ],
        "documents": [
            {"kind": kind.value, "tenant": tenant, "id": name, "body": _json(body)}
            for (kind, tenant, name), body in entries.documents.items()
        ],
        "pending": [
            {"seq": one.seq, "tenant": one.tenant, "subscription": one.subscription, "entity": one.entity,
             "body": _json(one.body)}
            for one in entries.pending
        ],
        "settled": entries.settled,
        "history": [{"sequence": row[0], "seq": row[1], "body": _json(row[5])} for row in entries.history],
        "cleared": [{"sequence": sequence, "below": below} for sequence, below in entries.cleared],
        "departed": [
            {"sequence": sequence, "tenant": row.tenant, "id": row.id}
            for sequence, row in entries.departed.items()
        ],
    }  # fmt: skip
    return {name: content for name, content in found.items() if content}


def _json(body: bytes | None) -> Any:
    """Return a body as JSON; as text where it is something else."""
    if body is None:
        return None
    try:
        return orjson.loads(body)
    except orjson.JSONDecodeError:
        return body.decode(errors="replace")
