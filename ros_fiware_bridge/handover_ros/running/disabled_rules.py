"""The names of the rules that a user has disabled, in a file; a power cut does not damage it."""

from collections.abc import Iterable
from pathlib import Path

import orjson

from handover.errors import Problem, UsageError
from handover.files.durable_files import replace_durably


class DisabledRules:
    """One small JSON file, replaced atomically."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def load(self) -> frozenset[str]:
        """Return the names of the disabled rules. Raises `UsageError` if the file is damaged."""
        try:
            written = orjson.loads(self._path.read_bytes())
            return frozenset(str(name) for name in written["off"])
        except FileNotFoundError:
            return frozenset()
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UsageError(
                f"the disabled rules of the ROS bridge, {self._path}, cannot be read ({error}); "
                "delete the file to start with all rules enabled"
            ) from None

    def save(self, off: Iterable[str]) -> None:
        """Replace the file; it is on the disk when this returns. Raises `Problem`."""
        try:
            replace_durably(self._path, orjson.dumps({"off": sorted(off)}))
        except OSError as error:
            raise Problem.translated(
                507,
                "Not kept",
                "ros.not_kept",
                "{path} cannot be written: {error}; free disk space",
                path=str(self._path),
                error=error.strerror,
            ) from error
