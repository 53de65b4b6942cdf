"""Memory: which rules somebody has switched off; it survives a power cut."""

import os
from collections.abc import Iterable
from pathlib import Path

import orjson

from handover.errors import Problem, UsageError
from handover.messages import message


class Memory:
    """One small file, replaced as a whole."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def load(self) -> frozenset[str]:
        """Return the names of the rules that are off. Raises `UsageError` when the file is damaged."""
        try:
            written = orjson.loads(self._path.read_bytes())
            return frozenset(str(name) for name in written["off"])
        except FileNotFoundError:
            return frozenset()
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UsageError(
                f"the memory of the ROS bridge, {self._path}, cannot be read ({error}); "
                "delete it to begin with all rules on"
            ) from None

    def save(self, off: Iterable[str]) -> None:
        """Write which rules are off; it is there, as a whole, once this returns. Raises `Problem`."""
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            new = self._path.with_suffix(".new")
            with new.open("wb") as file:
                file.write(orjson.dumps({"off": sorted(off)}))
                file.flush()
                os.fsync(file.fileno())
            new.replace(self._path)
            _sync_folder(self._path.parent)
        except OSError as error:
            raise Problem(
                507,
                "Not kept",
                message(
                    "ros.not_kept",
                    "{path} cannot be written: {error}; make room for it",
                    path=str(self._path),
                    error=error.strerror,
                ),
            ) from error


def _sync_folder(folder: Path) -> None:
    if not hasattr(os, "O_DIRECTORY"):  # where a folder cannot be opened, as on Windows
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
