"""The stored state of a simulation: one file, replaced atomically."""

import io
import zipfile
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from handover.files.durable_files import replace_durably
from handover.telemetry import get_logger
from handover_robots.physics.simulation import Simulation

log = get_logger(__name__)


class SavedState:
    """The state of a simulation in a file, for the scene and the robots that `digest` identifies."""

    def __init__(self, file: Path, digest: str, simulation: Simulation) -> None:
        self._file = file
        self.digest = digest
        self._simulation = simulation
        self._writing = Lock()

    @staticmethod
    def parts_in(file: Path, digest: str) -> int:
        """Return how many parts a stored state has; 0 if there is none for this scene and its robots."""
        stored = _read(file)
        return len(stored["parked"]) if _is_of(stored, digest) else 0

    def load(self) -> bool:
        """Take the stored state over; return False if there is none for this scene and its robots."""
        stored = _read(self._file)
        return _is_of(stored, self.digest) and self._simulation.restore(stored)

    def save(self) -> None:
        """Write the state; a full disk is logged, since the parts can be filled in again."""
        with self._writing:
            buffer = io.BytesIO()
            np.savez(buffer, digest=np.array(self.digest), **self._simulation.saved())
            try:
                replace_durably(self._file, buffer.getvalue())
            except OSError as error:
                log.warning("state of the simulation not stored", file=str(self._file), error=str(error))


def _read(file: Path) -> dict[str, Any]:
    """Return the arrays of a stored state; none if there is no readable one."""
    try:
        with np.load(io.BytesIO(file.read_bytes()), allow_pickle=False) as arrays:
            return dict(arrays)
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        log.warning("state of the simulation not read", file=str(file), error=str(error))
        return {}


def _is_of(stored: dict[str, Any], digest: str) -> bool:
    return {"digest", "state", "parked", "fingers"} <= stored.keys() and str(stored["digest"]) == digest
