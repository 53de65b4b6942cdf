"""Durable files: a small file is replaced as a whole, or not at all."""

import os
from pathlib import Path


def replace_durably(path: Path, content: bytes, *, mode: int | None = None) -> None:
    """Replace a file such that after a power cut it has either content as a whole. Raises `OSError`.

    `mode` are the permissions of the file, whatever the umask; without it the umask decides.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_suffix(".new")
    new.unlink(missing_ok=True)
    created = os.open(new, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666 if mode is None else mode)
    with os.fdopen(created, "wb") as file:
        if mode is not None and os.name == "posix":
            os.fchmod(created, mode)
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
