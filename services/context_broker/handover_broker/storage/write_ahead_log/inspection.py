"""The content of a broker's write-ahead log in readable form: `handover broker inspect`. It writes nothing.

Both files are read as they are, also those of a running broker, which may change them meanwhile. Unlike the
start of the broker it stops at nothing: damaged and interrupted frames are listed with the others, and so are
records of unknown types.
"""

import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import orjson

from handover.errors import UsageError
from handover_broker.storage.write_ahead_log.frames import FileHeader, Frame, UnknownVersion
from handover_broker.storage.write_ahead_log.log import WriteAheadLog
from handover_broker.storage.write_ahead_log.log_file import LogFile
from handover_broker.storage.write_ahead_log.records import read_bodies


def describe(path: Path) -> Iterator[str]:
    """Yield lines about the log beside the database `path`. Raises `UsageError` if there is none."""
    log, checkpointed = _log(path), _checkpointed(path)
    yield f"{path}: the tables have everything up to change {checkpointed}"
    for file in _existing_files(log):
        try:
            header = file.header()
        except UnknownVersion as error:
            yield str(error)
            continue
        if header is None:
            yield f"{file.path}: its first page is damaged, or is not of this format"
            continue
        yield f"{file.path}: {_header_summary(header)}"
        for frame in file.content().frames():
            yield f"  byte {frame.offset:>8}  {_summary(frame, checkpointed)}"


def changes(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the changes in the log beside `path` as JSON, in the order of their numbers."""
    log, checkpointed = _log(path), _checkpointed(path)
    try:
        frames = [frame for file in _existing_files(log) for frame in file.content().frames()]
    except UnknownVersion as error:
        raise UsageError(str(error)) from None
    for frame in sorted(frames, key=lambda frame: frame.number):
        if frame.record is not None:
            yield {
                "number": frame.number,
                "in_tables": frame.number <= checkpointed,
                "records": _records(frame.record),
            }


def _log(path: Path) -> WriteAheadLog:
    log = WriteAheadLog(path)
    if not log.exists():
        raise UsageError(f"there is no log to inspect: {log.names}; name the directory with --data-dir")
    return log


def _existing_files(log: WriteAheadLog) -> list[LogFile]:
    return [file for file in log.files if file.path.exists()]


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


def _header_summary(header: FileHeader) -> str:
    state = "closed, everything is in the tables" if header.is_closed else "open"
    return f"database {header.database_id.hex()}, log {header.log_id.hex()}, {state}"


def _summary(frame: Frame, checkpointed: int) -> str:
    if frame.is_damaged:
        return "damaged: some sectors are neither old nor new"
    if frame.record is None:
        return f"after change {frame.number}: void or interrupted, never acknowledged"
    counts = Counter(record_type for record_type, _, _ in read_bodies(frame.record))
    where = "in the tables" if frame.number <= checkpointed else "in the log only"
    content = ", ".join(f"{count} {record_type}" for record_type, count in counts.items()) or "nothing"
    return f"change {frame.number}, {len(frame.record)} bytes, {where}: {content}"


def _records(content: bytes) -> list[dict[str, Any]]:
    return [
        {"type": record_type, **fields, **{name: _json(body) for name, body in bodies.items()}}
        for record_type, fields, bodies in read_bodies(content)
    ]


def _json(body: bytes | None) -> Any:
    """Return a body as JSON; as text where it is something else."""
    if body is None:
        return None
    try:
        return orjson.loads(body)
    except orjson.JSONDecodeError:
        return body.decode(errors="replace")
