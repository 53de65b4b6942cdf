"""The scene as it was changed at run time: one file beside the memory of the cell.

The change belongs to the scene that it was made from. When that scene, a file, is another one at the next
start, the file counts and the change is dropped.
"""

from pathlib import Path
from typing import Any

import orjson
from pydantic import Field, ValidationError

from handover.errors import UsageError
from handover.files.durable_files import replace_durably
from handover.formats.validation import ClosedModel
from handover.telemetry import get_logger

log = get_logger(__name__)


class ChangedScene(ClosedModel):
    """A changed scene: `origin` is the digest of the scene it was made from, `revision` counts changes."""

    origin: str
    revision: int = Field(ge=1)
    scene: dict[str, Any]


class SceneFile:
    """The file of the changed scene."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def load(self, origin: str) -> ChangedScene | None:
        """Return the change of the scene `origin`; None without one. Raises `UsageError`."""
        try:
            changed = ChangedScene.model_validate_json(self.path.read_bytes())
        except FileNotFoundError:
            return None
        except OSError as error:
            raise UsageError(f"the changed scene {self.path} cannot be read: {error.strerror}") from None
        except ValidationError:
            raise UsageError(
                f"the changed scene {self.path} is damaged; delete it to use the scene of the cell"
            ) from None
        if changed.origin != origin:
            log.warning("scene file changed, changes at run time are dropped", file=str(self.path))
            return None
        return changed

    def save(self, changed: ChangedScene) -> None:
        """Write the change atomically and durably. Raises `OSError`."""
        replace_durably(self.path, orjson.dumps(changed.model_dump(mode="json")))
