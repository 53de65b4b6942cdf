"""A definition: what a TaskDefinition says to the person, wherever it is kept."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Definition:
    """What a TaskDefinition says to the person, as far as it says anything."""

    name: str | None = None
    description: str | None = None
    gesture: Any = None
    command_id: Any = None
    handles_outcomes: Any = None
    """Only the broker's TaskDefinition says it."""

    @property
    def asks(self) -> bool:
        """Say whether it says what to show."""
        return self.gesture is not None or self.command_id is not None

    def filled_from(self, other: "Definition") -> "Definition":
        """Return this definition with what it leaves out taken from `other`.

        Its own command is never joined by the gesture of `other`, which may stand for another command.
        """
        gesture = self.gesture
        if gesture is None and self.command_id is None:
            gesture = other.gesture
        return Definition(
            self.name or other.name,
            self.description or other.description,
            gesture,
            other.command_id if self.command_id is None else self.command_id,
            self.handles_outcomes,
        )


def needs_definition(parameters: Mapping[str, Any], definition: Definition = Definition()) -> bool:
    """Say whether the workParameters, and what is known of the definition, leave something to ask for."""
    asks = parameters.get("gesture") is not None or parameters.get("commandId") is not None
    described = parameters.get("description")
    is_described = isinstance(described, str) and bool(described)
    return not ((asks or definition.asks) and (is_described or bool(definition.description)))
