"""The glove store: what must survive of a glove, one small file each in the data directory.

A file is written beside its place, forced to the disk and moved there, so that a power cut leaves either
the old or the new one whole.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from handover.errors import UsageError
from services.gesture_controller.thresholds import M2O2P_THRESHOLDS, Thresholds


@dataclass(frozen=True, slots=True)
class StoredGlove:
    """What is kept of a glove; None where nothing was ever set. `previous` are the thresholds before."""

    name: str
    hand: str = "right"
    person: str | None = None
    declared: bool = False
    thresholds: Thresholds | None = None
    previous: Thresholds | None = None


class GloveStore:
    """The files of all gloves in `directory`."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory

    def load(self) -> dict[str, StoredGlove]:
        """Return all stored gloves by name; raise `UsageError` for a file that cannot be read."""
        gloves = (self._read(path) for path in sorted(self._directory.glob("*.json")))
        return {glove.name: glove for glove in gloves}

    def save(self, glove: StoredGlove) -> None:
        """Write `glove` so that it survives; returns when it does. Blocks for the disk."""
        self._directory.mkdir(parents=True, exist_ok=True)
        path = self._directory / f"{glove.name}.json"
        beside = path.with_suffix(".json.new")
        with beside.open("wb") as file:
            file.write(orjson.dumps(_as_json(glove), option=orjson.OPT_INDENT_2))
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
        _force(self._directory)

    def _read(self, path: Path) -> StoredGlove:
        try:
            given = orjson.loads(path.read_bytes())
            return StoredGlove(
                path.stem,
                given["hand"],
                given["person"],
                given["declared"],
                _thresholds(given["thresholds"]),
                _thresholds(given["previous"]),
            )
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise UsageError(
                f"the stored glove {path} cannot be read ({type(error).__name__}: {error}); "
                "remove the file to begin again with the thresholds of the gestures file"
            ) from None


def _as_json(glove: StoredGlove) -> dict[str, Any]:
    return {
        "hand": glove.hand,
        "person": glove.person,
        "declared": glove.declared,
        "thresholds": glove.thresholds.as_dict() if glove.thresholds else None,
        "previous": glove.previous.as_dict() if glove.previous else None,
    }


def _thresholds(given: Any) -> Thresholds | None:
    return None if given is None else M2O2P_THRESHOLDS.with_changes(given)


def _force(directory: Path) -> None:
    if os.name == "nt":  # directories cannot be opened there; moving a file is journaled
        return
    handle = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
