"""Paths to values inside a message, as a mapping writes them.

header.stamp                    a field of a field
position[0]                     an element of an array
position[name=elbow_joint]      the element whose field `name` has this value; in an array of plain values
                                the element at the index of that name in the array `name` beside it
status[].level                  a field of the current element of the rule's `each: status`
.                               the whole message
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any, TypeAlias

from handover.errors import HandoverError

Getter: TypeAlias = Callable[[Any], Any]

MAX_PATH_LENGTH = 200
_TOKEN = re.compile(
    r"(?P<name>[A-Za-z][A-Za-z0-9_]*)"
    r"|\[(?P<index>\d{1,9})\]"
    r"|(?P<each>\[\])"
    r"|\[(?P<key>[A-Za-z][A-Za-z0-9_]*)=(?P<wanted>[^\]]+)\]"
)


class InvalidPath(ValueError):
    """The text is not a path; the message gives the reason."""


class MissingValue(HandoverError):
    """A message does not have the value at a path."""


@dataclass(frozen=True, slots=True)
class FieldStep:
    """Selects the field `name`."""

    name: str

    def __str__(self) -> str:
        return f".{self.name}"


@dataclass(frozen=True, slots=True)
class Index:
    """Selects the element at `place`, from 0."""

    place: int

    def __str__(self) -> str:
        return f"[{self.place}]"


@dataclass(frozen=True, slots=True)
class Where:
    """Selects the element whose `key` is `wanted`."""

    key: str
    wanted: str

    def __str__(self) -> str:
        return f"[{self.key}={self.wanted}]"


@dataclass(frozen=True, slots=True)
class Each:
    """Selects the current element of the rule."""

    def __str__(self) -> str:
        return "[]"


Step: TypeAlias = FieldStep | Index | Where | Each


@dataclass(frozen=True, slots=True)
class Path:
    """The steps from a message to a value; no steps for the whole message."""

    steps: tuple[Step, ...] = ()

    def __str__(self) -> str:
        return "".join(map(str, self.steps)).removeprefix(".") or "."

    @property
    def root(self) -> str | None:
        """Return the first field; None for the whole message."""
        first = self.steps[0] if self.steps else None
        return first.name if isinstance(first, FieldStep) else None

    def split(self) -> tuple["Path", "Path"] | None:
        """Return the path to the array and the path inside its element; None without `[]`."""
        if Each() not in self.steps:
            return None
        at = self.steps.index(Each())
        return Path(self.steps[:at]), Path(self.steps[at + 1 :])


WHOLE = Path()


def parse(text: str) -> Path:
    """Return the path in `text`. Raises `InvalidPath`."""
    if text == ".":
        return WHOLE
    if not text or len(text) > MAX_PATH_LENGTH:
        raise InvalidPath(
            f"a path has 1 to {MAX_PATH_LENGTH} characters, such as pose.pose.position or position[0]"
        )
    path = Path(tuple(_steps(text)))
    if sum(isinstance(step, Each) for step in path.steps) > 1:
        raise InvalidPath(f'the path "{text}" contains [] twice; a rule has one `each`')
    return path


def _steps(text: str) -> Iterator[Step]:
    at, after_dot = 0, True
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None or (match["name"] is not None) is not after_dot:
            raise InvalidPath(
                f'the path "{text}" cannot be parsed from "{text[at:]}"; '
                "a path looks like header.stamp, position[0] or position[name=elbow_joint]"
            )
        at = match.end()
        if match["name"] is not None:
            yield FieldStep(match["name"])
        elif match["index"] is not None:
            yield Index(int(match["index"]))
        elif match["each"] is not None:
            yield Each()
        else:
            yield Where(match["key"], match["wanted"])
        after_dot = text[at : at + 1] == "."
        if after_dot:
            at += 1
            if at == len(text):
                raise InvalidPath(
                    f'the path "{text}" ends with a dot; add the name of a field, or remove the dot'
                )


def getter(path: Path) -> Getter:
    """Return the function that reads the value at `path` from a message or element; it raises `MissingValue`.

    Paths with `[]` must be split first.
    """
    if not path.steps:
        return lambda message: message
    names = [step.name for step in path.steps if isinstance(step, FieldStep)]
    if len(names) == len(path.steps):
        return _through_fields(names, str(path))
    steps = [_stepper(path, place) for place in range(len(path.steps))]
    return lambda message: reduce(_take, steps, (message, None))[0]


def _through_fields(names: list[str], written: str) -> Getter:
    if len(names) == 1:
        (only,) = names

        def at_field(message: Any) -> Any:
            try:
                return message[only]
            except (KeyError, TypeError, IndexError):
                raise MissingValue(f"the message has no {written}") from None

        return at_field

    def at_fields(message: Any) -> Any:
        try:
            for name in names:
                message = message[name]
        except (KeyError, TypeError, IndexError):
            raise MissingValue(f"the message has no {written}") from None
        return message

    return at_fields


_Place: TypeAlias = tuple[Any, Any]
"""A value, and the message whose field it is."""


def _take(place: _Place, step: Callable[[_Place], _Place]) -> _Place:
    return step(place)


def _stepper(path: Path, place: int) -> Callable[[_Place], _Place]:
    step, written = path.steps[place], str(Path(path.steps[: place + 1]))
    if isinstance(step, FieldStep):

        def field(at: _Place) -> _Place:
            message = at[0]
            if not isinstance(message, Mapping) or step.name not in message:
                raise MissingValue(f"the message has no {written}")
            return message[step.name], message

        return field
    if isinstance(step, Index):

        def index(at: _Place) -> _Place:
            array = at[0]
            try:
                return array[step.place], None
            except (IndexError, TypeError, KeyError):
                raise MissingValue(f"the message has no {written}: {_length(array)}") from None

        return index
    if isinstance(step, Where):
        return lambda at: (_where(step, at, written), None)
    raise TypeError("a path with [] must be split")


def _where(step: Where, at: _Place, written: str) -> Any:
    array, beside = at
    if len(array) and isinstance(array[0], Mapping):
        for element in array:
            if str(element.get(step.key)) == step.wanted:
                return element
    elif isinstance(beside, Mapping) and step.key in beside:
        for place, name in enumerate(beside[step.key]):
            if str(name) == step.wanted and place < len(array):
                return array[place]
    raise MissingValue(f"the message has no {written}: no element has {step.key} {step.wanted}")


def _length(array: Any) -> str:
    try:
        return f"its length is {len(array)}"
    except TypeError:
        return "it is not an array"
