"""Field paths: name a part of a message, as in `position[0]` or `pose.pose.position`."""

import difflib
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ros_fiware_bridge.errors import UnknownField
from ros_fiware_bridge.types.definition import Definition, FieldType, Many

_STEP = re.compile(r"([A-Za-z][A-Za-z0-9_]*)(?:\[([0-9]+)\])?")


@dataclass(frozen=True, slots=True)
class FieldPath:
    """A path checked against a definition: its names and indexes, and the type at its end."""

    text: str
    steps: tuple[str | int, ...]
    type: FieldType

    def of(self, message: dict[str, Any]) -> Any:
        """Return the value in a whole message; None beyond the end of an array."""
        value: Any = message
        for step in self.steps:
            if isinstance(step, int) and step >= len(value):
                return None
            value = value[step]
        return value.item() if isinstance(value, np.generic) else value


def field_path(text: str, type_name: str, definition_of: Callable[[str], Definition]) -> FieldPath:
    """Check `text` against the definition of `type_name`.

    Raises:
        UnknownField: the error names the missing part and the existing ones.
    """
    steps: list[str | int] = []
    here = FieldType(type_name)
    so_far = ""
    for part in text.split("."):
        match = _STEP.fullmatch(part)
        if match is None:
            raise UnknownField(
                f'"{text}" is not a field path; write names with dots and indexes, '
                "pose.position.x or position[0]"
            )
        if here.many is not Many.ONE:
            raise UnknownField(
                f'"{text}": {so_far} of {type_name} is {here}; name one element, {so_far}[0].{part}'
            )
        if not here.is_message:
            raise UnknownField(f'"{text}": {so_far} of {type_name} is {here}, which has no fields')
        name, index = match[1], match[2]
        definition = definition_of(here.base)
        field = definition.field(name)
        if field is None:
            raise UnknownField(f'"{text}": {here.base} has no field "{name}"; {meant(name, definition)}')
        steps.append(name)
        here = field.type
        so_far = f"{so_far}.{name}" if so_far else name
        if index is not None:
            here = _item(here, int(index), text, f"{so_far} of {type_name}")
            steps.append(int(index))
            so_far = f"{so_far}[{index}]"
    return FieldPath(text, tuple(steps), here)


def _item(kind: FieldType, index: int, text: str, where: str) -> FieldType:
    if kind.many is Many.ONE:
        raise UnknownField(f'"{text}": {where} is {kind}, not an array; remove the [{index}]')
    if kind.size and index >= kind.size:
        raise UnknownField(f'"{text}": {where} is {kind}; the last index is {kind.size - 1}')
    return kind.item


def meant(name: str, definition: Definition) -> str:
    """Return a hint: the field that `name` may mean, or all fields."""
    names = [one.name for one in definition.fields]
    near = difflib.get_close_matches(name, names, n=1)
    if near:
        return f'did you mean "{near[0]}"?'
    return f"it has {', '.join(names)}" if names else "it has no fields"
