"""Durable files: a small file is replaced as a whole, or not at all."""

import os
from pathlib import Path


def replace_durably(path: Path, content: bytes, *, mode: int = 0o666) -> None:
    """Replace a file such that after a power cut it has either content as a whole. Raises `OSError`.

    `mode` are the permissions of the file, less the umask.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_suffix(".new")
    new.unlink(missing_ok=True)
    with os.fdopen(os.open(new, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode), "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Flush a folder, where that is possible, so that the name of a new file survives a power cut."""
    if not hasattr(os, "O_DIRECTORY"):  # Windows cannot open a directory
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
