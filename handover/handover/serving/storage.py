"""Storage: the readiness check of the data directory for `/readyz`.

A service continues with a full disk, since existing data can be read, but it is not ready.
"""

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from handover.serving.service import Check

MIN_FREE_BYTES: Final = 8 * 1024 * 1024
"""With less a service is not ready: the log and the tables of a database need some space."""


def require_storage(directory: Path, min_free_bytes: int = MIN_FREE_BYTES) -> None:
    """Raise OSError with one sentence if `directory` is not writable or has too little space."""
    while not directory.exists():  # it is created at the first write
        directory = directory.absolute().parent
    if not os.access(directory, os.W_OK | os.X_OK):
        raise OSError(f"{directory} is read-only; make it writable, or name another with HANDOVER_DATA_DIR")
    free = shutil.disk_usage(directory).free
    if free < min_free_bytes:
        raise OSError(f"{directory} has {free} bytes free, and {min_free_bytes} are needed; free disk space")


def storage_check(directory: Path) -> "Check":
    """Return the readiness check of a service with its data in `directory`."""

    async def check() -> None:
        require_storage(directory)

    return check
