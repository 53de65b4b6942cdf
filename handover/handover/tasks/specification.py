"""Specifications: what a person is shown for a Task that does not say it itself."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

MAX_COMMAND_ID = 2**31 - 1
"""More is neither kept by every broker nor by the table of specifications."""
FIELDS = ("name", "description", "gesture", "commandId")
"""The fields in the words of files and of entities."""


@dataclass(frozen=True, slots=True)
class Specification:
    """Name, description and gesture or command of a Task; None if it does not have them."""

    name: str | None = None
    description: str | None = None
    gesture: Any = None
    command_id: Any = None

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """Return the specification that has `values` by field; raise `ValueError` if one is not usable."""
        texts = {}
        for field in FIELDS[:3]:
            text = values.get(field)
            if text is not None and not isinstance(text, str):
                raise ValueError(f"the {field} of a specification is a text, not {text!r}")
            texts[field] = text or None
        command = values.get("commandId")
        if isinstance(command, str) and command.isdecimal():
            command = int(command)
        if isinstance(command, bool) or not (command is None or isinstance(command, int)):
            raise ValueError(f"the commandId of a specification is a whole number such as 3, not {command!r}")
        if command is not None and not 0 <= command <= MAX_COMMAND_ID:
            raise ValueError(f"the commandId {command} is not within 0 to {MAX_COMMAND_ID}")
        if not any(value is not None for value in (*texts.values(), command)):
            raise ValueError("a specification has a description, and a gesture or a commandId")
        return cls(texts["name"], texts["description"], texts["gesture"], command)

    def as_values(self) -> dict[str, Any]:
        """Return the fields that it has, in the words of entities."""
        values = zip(FIELDS, (self.name, self.description, self.gesture, self.command_id), strict=True)
        return {field: value for field, value in values if value is not None}
