"""A file system of a few MiB that a test fills: a real disk without room."""

import errno
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.kit.skipping import NO_MOUNT

_BLOCK = 64 * 1024


class SmallDisk:
    """A mounted file system."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._filling = folder / "filling"

    def fill(self) -> None:
        """Leave no byte."""
        size = _BLOCK
        with self._filling.open("ab", buffering=0) as file:
            while size:
                try:
                    file.write(bytes(size))
                except OSError as error:
                    if error.errno != errno.ENOSPC:
                        raise
                    size //= 2

    def free(self) -> None:
        """Make room again."""
        self._filling.unlink(missing_ok=True)


@contextmanager
def small_disk(folder: Path, size_mib: int = 48) -> Iterator[SmallDisk]:
    """Mount a file system in memory at `folder`; skip the test where that is not allowed."""
    folder.mkdir(parents=True)
    command = ["mount", "-t", "tmpfs", "-o", f"size={size_mib}m,mode=0700", "tmpfs", str(folder)]
    try:
        mounted = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        pytest.skip(f"{NO_MOUNT}: {error}")
    if mounted.returncode != 0:
        pytest.skip(f"{NO_MOUNT}: {mounted.stderr.strip()}")
    try:
        yield SmallDisk(folder)
    finally:
        with suppress(OSError):
            os.sync()
        subprocess.run(["umount", "--lazy", str(folder)], check=False, capture_output=True)
