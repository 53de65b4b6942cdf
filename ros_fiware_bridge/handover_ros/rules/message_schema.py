"""Message definitions as a rule sees them: the type that a path selects, checked before anything runs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from handover_ros.mapping.paths import Each, FieldStep, Getter, Index, Path, Step, Where, getter
from handover_ros.types.definition import TEXTS, Definition, FieldType, Many
from handover_ros.types.excerpt import FieldNames

TIME = "builtin_interfaces/msg/Time"
HEADER = "std_msgs/msg/Header"

Find = Callable[[Path], Getter]


class InvalidRule(ValueError):
    """A rule cannot work as it is written; the text names the rule and the way out."""


class Definitions(Protocol):
    """Provides the definitions of message types; see `TypeStore`."""

    def definition(self, type_name: str) -> Definition:
        """Return the definition of a message type. Raises `UnknownType`."""


@dataclass(frozen=True, slots=True)
class PathTarget:
    """The target of a path: a field's type, or None inside JSON text, where no type is known."""

    type: FieldType | None

    @property
    def is_number(self) -> bool:
        """Return whether it may be one number."""
        return self.type is None or (
            self.type.many is Many.ONE and not self.type.is_message and self.type.base not in {*TEXTS, "bool"}
        )

    @property
    def is_text(self) -> bool:
        """Return whether it may be text."""
        return self.type is None or (self.type.many is Many.ONE and self.type.base in TEXTS)

    def is_message(self, type_name: str) -> bool:
        """Return whether it may be a message of this type."""
        return self.type is None or (self.type.many is Many.ONE and self.type.base == type_name)

    def __str__(self) -> str:
        return "JSON" if self.type is None else str(self.type)


class MessageSchema:
    """The fields of a message type, for the paths of one rule.

    `each` is the array that the rule iterates over; `json_text` are fields that hold JSON.
    """

    def __init__(
        self,
        definitions: Definitions,
        type_name: str,
        element: Path | None = None,
        json_text: Sequence[Path] = (),
    ) -> None:
        self._definitions = definitions
        self._top = FieldType(type_name)
        self.each = element
        self._json_text: frozenset[Path] = frozenset()
        self._looked_at: set[FieldNames] = set()
        for path in json_text:
            if not (kind := self._resolve(path)).is_text:
                raise InvalidRule(f"{path} is {kind}, and only text (string) can hold JSON")
        self._json_text = frozenset(json_text)
        through = self._resolve(element).type if element is not None else None
        if through is not None and through.many is Many.ONE:
            raise InvalidRule(f"{element} is one {through}; `each` is for arrays, so drop it and its []")

    def target(self, path: Path) -> PathTarget:
        """Return the target of `path`. Raises `InvalidRule` if there is none."""
        split = path.split()
        if split is None:
            return self._resolve(path)
        if split[0] != self.each:
            meant = f"`each` is {self.each}" if self.each else f"the rule has no `each: {split[0]}`"
            raise InvalidRule(f"{path} goes over each element of {split[0]}, but {meant}")
        kind = self._resolve(split[0]).type
        return PathTarget(None) if kind is None else self._walk(split[1], kind.item, path)

    @property
    def fields(self) -> frozenset[FieldNames]:
        """Return the fields that the rule reads; `()` is the whole message."""
        return frozenset(self._looked_at)

    def require_time(self, path: Path) -> None:
        """Raise `InvalidRule` unless `path` is a time field."""
        if not (moment := self.target(path)).is_message(TIME):
            raise InvalidRule(
                f"{path} is {moment}, not a time ({TIME}); name a time field, or write received or none"
            )

    def find(self, path: Path) -> Getter:
        """Return the function that reads the value at `path`.

        With `each` its argument is the pair of message and element, else the message.
        """
        self.target(path)
        split = path.split()
        if self.each is None:
            return getter(path)
        if split is None:
            in_message = getter(path)
            return lambda scope: in_message(scope[0])
        in_element = getter(split[1])
        return lambda scope: in_element(scope[1])

    def definition(self, type_name: str) -> Definition:
        """Return the definition of a message type."""
        return self._definitions.definition(type_name)

    def has_stamp(self) -> bool:
        """Return whether the message has a header."""
        header = self._definitions.definition(self._top.base).field("header")
        return header is not None and header.type == FieldType(HEADER)

    def _resolve(self, path: Path) -> PathTarget:
        return self._walk(path, self._top, path)

    def _walk(self, path: Path, start: FieldType, whole: Path) -> PathTarget:
        here, holder = start, None
        if start == self._top:
            self._looked_at.add(_names(path.steps))
        for place, step in enumerate(path.steps):
            if Path(path.steps[:place]) in self._json_text:
                return PathTarget(None)
            so_far = str(Path(path.steps[:place])) if place else "the message"
            if isinstance(step, FieldStep):
                holder = self._definition_of(here, so_far, step.name)
                here = _field_of(holder, step.name, so_far)
            elif isinstance(step, Each):
                raise InvalidRule(f"{whole} goes over [] where the rule has no `each`")
            else:
                if isinstance(step, Where) and start == self._top and not here.is_message:
                    self._looked_at.add((*_names(path.steps[: place - 1]), step.key))
                here, holder = self._element(here, holder, step, so_far), None
        return PathTarget(None if path in self._json_text else here)

    def _definition_of(self, here: FieldType, so_far: str, name: str) -> Definition:
        if here.many is not Many.ONE:
            raise InvalidRule(
                f"{so_far} is an array ({here}) and has no field {name}; choose an element, as {so_far}[0]"
            )
        if not here.is_message:
            raise InvalidRule(f"{so_far} is {here} and has no field {name}")
        return self._definitions.definition(here.base)

    def _element(
        self, here: FieldType, holder: Definition | None, step: Index | Where, so_far: str
    ) -> FieldType:
        if here.many is Many.ONE:
            raise InvalidRule(f"{so_far} is {here}, not an array, and has no element {step}")
        if isinstance(step, Index):
            if here.size and step.place >= here.size:
                raise InvalidRule(f"{so_far} holds {here.size} at most ({here}), so there is no {step}")
            return here.item
        if here.is_message:
            _field_of(self._definitions.definition(here.base), step.key, f"each of {so_far}")
        else:
            names = _field_of(holder, step.key, "the message") if holder else None
            if names is None or names.many is Many.ONE:
                raise InvalidRule(
                    f"{so_far}{step} looks for {step.wanted} in the array {step.key} beside {so_far}, "
                    "and there is no such array"
                )
        return here.item


def _names(steps: Sequence[Step]) -> FieldNames:
    """Return the fields of a path up to its first array."""
    names: list[str] = []
    for step in steps:
        if not isinstance(step, FieldStep):
            break
        names.append(step.name)
    return tuple(names)


def _field_of(definition: Definition, name: str, so_far: str) -> FieldType:
    field = definition.field(name)
    if field is not None:
        return field.type
    hint = definition.suggest_field(name)
    raise InvalidRule(f'{so_far} ({definition.type_name}) has no field "{name}"; {hint}')
