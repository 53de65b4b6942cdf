"""The simulated sensors of the person of a case."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Sensor:
    """A simulated sensor of the person: the settings of its driver, and the acts it receives (None: all)."""

    name: str
    settings: Mapping[str, Any]
    acts: frozenset[str] | None = None

    def taken(self, acts: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return what this sensor receives of what the person does."""
        return acts if self.acts is None else {name: acts[name] for name in acts if name in self.acts}
