"""Templates: text with placeholders that are filled from a message, such as `Device:{header.frame_id}`."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from handover.errors import HandoverError
from handover_ros.mapping import paths
from handover_ros.mapping.paths import InvalidPath, Path

MAX_ID_PART_LENGTH = 200
_NOT_IN_IDS = re.compile(r"[^A-Za-z0-9_.:-]+")


class UnknownEntity(HandoverError):
    """A message does not determine its entity."""


@dataclass(frozen=True, slots=True)
class Template:
    """Text and paths in order; `parts` are str or Path."""

    parts: tuple[str | Path, ...]

    def __str__(self) -> str:
        return "".join(part if isinstance(part, str) else f"{{{part}}}" for part in self.parts)

    @property
    def paths(self) -> tuple[Path, ...]:
        """Return the paths of its placeholders."""
        return tuple(part for part in self.parts if isinstance(part, Path))

    @property
    def constant(self) -> str | None:
        """Return the text if it does not depend on a message."""
        return None if self.paths else "".join(part for part in self.parts if isinstance(part, str))

    def with_settings(self, settings: Mapping[str, str]) -> "Template":
        """Return the template with placeholders such as `{factory}` filled."""
        filled = (settings.get(str(part), part) if isinstance(part, Path) else part for part in self.parts)
        return Template(tuple(filled))

    def filler(self, getter: Callable[[Path], Callable[[Any], Any]]) -> Callable[[Any], str]:
        """Return the function that fills the template; `getter` makes the functions that read the values."""
        if self.constant is not None:
            text = self.constant
            return lambda _: text
        pieces = [part if isinstance(part, str) else getter(part) for part in self.parts]
        return lambda message: "".join(
            part if isinstance(part, str) else str(part(message)) for part in pieces
        )


def parse(text: str) -> Template:
    """Return the template in `text`. Raises `InvalidPath`."""
    return Template(tuple(_parts(text)))


def _parts(text: str) -> Iterator[str | Path]:
    rest = text
    while rest:
        before, opened, rest = rest.partition("{")
        if "}" in before:
            raise InvalidPath(f'"{text}" has a }} without a {{; write {{header.frame_id}}')
        if before:
            yield before
        if opened:
            inside, closed, rest = rest.partition("}")
            if not closed:
                raise InvalidPath(f'"{text}" has a {{ without a }}; write {{header.frame_id}}')
            yield paths.parse(inside)


def in_id(value: Any, path: Path) -> str:
    """Return `value` as a part of an entity id; characters that ids do not allow become hyphens."""
    text = _NOT_IN_IDS.sub("-", str(value)).strip("-")
    if not text:
        raise UnknownEntity(f"{path} is empty, so the entity of the message is unknown")
    if len(text) > MAX_ID_PART_LENGTH:
        raise UnknownEntity(
            f"{path} has {len(text)} characters; an id accepts at most {MAX_ID_PART_LENGTH} of a field"
        )
    return text
