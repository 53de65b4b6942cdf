"""The content of a TaskDefinition that concerns the person."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from handover.tasks.specification import Specification


@dataclass(frozen=True, slots=True)
class Definition(Specification):
    """What the TaskDefinition of a Task adds to it."""

    handles_outcomes: Any = None
    """Only the TaskDefinition in the broker has it."""
    require_pin: Any = None
    """As above."""

    @property
    def has_prompt(self) -> bool:
        """True if it has a gesture or a command."""
        return self.gesture is not None or self.command_id is not None

    def filled_from(self, other: Specification) -> "Definition":
        """Return this definition with missing values taken from `other`.

        A definition with a command does not get the gesture of `other`, which may have another command.
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
            self.require_pin,
        )


def needs_definition(parameters: Mapping[str, Any], definition: Definition = Definition()) -> bool:
    """Return True if workParameters and `definition` lack a gesture and command, or a description."""
    has_prompt = parameters.get("gesture") is not None or parameters.get("commandId") is not None
    described = parameters.get("description")
    is_described = isinstance(described, str) and bool(described)
    return not ((has_prompt or definition.has_prompt) and (is_described or bool(definition.description)))
