"""Storage: whether a service can keep what it must, as `/readyz` reports it.

A full disk is no reason to stop: what is there can be read. But a service that cannot store is not ready.
"""

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from handover.service import Check

MIN_FREE_BYTES: Final = 8 * 1024 * 1024
"""Below this a service is not ready: the log and the tables of a database need some space to be written."""


def require_storage(directory: Path, min_free_bytes: int = MIN_FREE_BYTES) -> None:
    """Raise OSError with one sentence if nothing, or too little, can be stored in `directory`."""
    while not directory.exists():  # it is made when the service starts to keep something
        directory = directory.absolute().parent
    if not os.access(directory, os.W_OK | os.X_OK):
        raise OSError(f"{directory} is read-only; make it writable, or name another with HANDOVER_DATA_DIR")
    free = shutil.disk_usage(directory).free
    if free < min_free_bytes:
        raise OSError(f"{directory} has {free} bytes free, and {min_free_bytes} are needed; make room there")


def storage_check(directory: Path) -> "Check":
    """Return the readiness check of a service that keeps its data in `directory`."""

    async def check() -> None:
        require_storage(directory)

    return check
