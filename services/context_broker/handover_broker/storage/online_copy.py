"""A consistent copy of the database and the write-ahead log of a broker that runs.

The tables of a snapshot have everything up to a number; what follows is in the two files of the log, of which
the broker overwrites one as soon as its changes are in the tables. So the files are read right after the
snapshot begins. If the broker has overwritten what the snapshot needs, both are taken again.
"""

import sqlite3
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from handover.backup.sqlite_snapshot import SqliteSnapshot
from handover.errors import UsageError
from handover_broker.storage.write_ahead_log.frames import UnknownVersion
from handover_broker.storage.write_ahead_log.log import WriteAheadLog
from handover_broker.storage.write_ahead_log.log_file import Damaged

MAX_ATTEMPTS: Final = 200
RETRY_S: Final = 0.02


def snapshot_with_log(
    path: Path, folder: Path, *, pause: Callable[[float], None] = time.sleep
) -> SqliteSnapshot:
    """Return a snapshot of the tables; the log files that belong to it are copied into `folder`.

    Raises `UsageError` if the two never agree, `sqlite3.Error` and `OSError`.
    """
    reason = ""
    for _ in range(MAX_ATTEMPTS):
        snapshot = SqliteSnapshot(path)
        try:
            _copy_log(path, folder)
            _require_log(snapshot.reader, folder / path.name)
        except Damaged as error:
            snapshot.close()
            reason = str(error)
            pause(RETRY_S)
        except UnknownVersion as error:
            snapshot.close()
            raise UsageError(str(error)) from None
        except BaseException:
            snapshot.close()
            raise
        else:
            return snapshot
    raise UsageError(f"the log of {path} does not agree with its tables: {reason}; see `handover check`")


def _copy_log(path: Path, folder: Path) -> None:
    for source in WriteAheadLog(path).paths:
        target = folder / source.name
        target.unlink(missing_ok=True)
        if source.exists():
            target.touch(0o600)
            target.write_bytes(source.read_bytes())


def _require_log(reader: sqlite3.Connection, copy: Path) -> None:
    """Raise `Damaged` if the copied log lacks changes that follow those of the tables."""
    states = reader.execute("SELECT database_id, log_id, checkpointed, is_open FROM log_state").fetchall()
    if not states:
        return
    database_id, log_id, checkpointed, is_open = states[0]
    log = WriteAheadLog(copy)
    if is_open:
        log.read(bytes.fromhex(database_id), bytes.fromhex(log_id), checkpointed)
    elif (foreign := log.describe_foreign(bytes.fromhex(database_id), bytes.fromhex(log_id))) is not None:
        raise Damaged(foreign)
