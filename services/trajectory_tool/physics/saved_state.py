"""The stored state of a simulation: one file, replaced atomically."""

import io
import zipfile
from pathlib import Path

import numpy as np

from handover.telemetry import get_logger
from services.trajectory_tool.physics.simulation import Simulation

log = get_logger(__name__)


class SavedState:
    """The state of a simulation in a file, for the scene and the robot that `digest` identifies."""

    def __init__(self, file: Path, digest: str, simulation: Simulation) -> None:
        self._file = file
        self._digest = digest
        self._simulation = simulation

    def load(self) -> bool:
        """Take the stored state over; return False if there is none for this scene and robot."""
        try:
            with np.load(io.BytesIO(self._file.read_bytes()), allow_pickle=False) as arrays:
                stored = dict(arrays)
            is_of_this_cell = str(stored.pop("digest")) == self._digest
            return is_of_this_cell and self._simulation.restore(stored)
        except FileNotFoundError:
            return False
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            log.warning("state of the simulation not read", file=str(self._file), error=str(error))
            return False

    def save(self) -> None:
        """Write the state; a full disk is logged, since the parts can be filled in again."""
        buffer = io.BytesIO()
        np.savez(buffer, digest=np.array(self._digest), **self._simulation.saved())
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            new = self._file.with_suffix(".new")
            new.write_bytes(buffer.getvalue())
            new.replace(self._file)
        except OSError as error:
            log.warning("state of the simulation not stored", file=str(self._file), error=str(error))
