"""A template: text with places that are filled from a message, such as `Device:{header.frame_id}`."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from handover.errors import HandoverError
from ros_fiware_bridge.mapping import paths
from ros_fiware_bridge.mapping.paths import Path, WrongPath

LONGEST_FILLING = 200
_NOT_IN_IDS = re.compile(r"[^A-Za-z0-9_.:-]+")


class NoId(HandoverError):
    """A message does not say which entity it belongs to."""


@dataclass(frozen=True, slots=True)
class Template:
    """Text and paths in turn; `parts` are str or Path."""

    parts: tuple[str | Path, ...]

    def __str__(self) -> str:
        return "".join(part if isinstance(part, str) else f"{{{part}}}" for part in self.parts)

    @property
    def paths(self) -> tuple[Path, ...]:
        """Return the paths that it is filled from."""
        return tuple(part for part in self.parts if isinstance(part, Path))

    @property
    def constant(self) -> str | None:
        """Return the text if nothing of it depends on a message."""
        return None if self.paths else "".join(part for part in self.parts if isinstance(part, str))

    def with_settings(self, given: Mapping[str, str]) -> "Template":
        """Return it with places such as `{factory}` filled."""
        filled = (given.get(str(part), part) if isinstance(part, Path) else part for part in self.parts)
        return Template(tuple(filled))

    def filler(self, getter: Callable[[Path], Callable[[Any], Any]]) -> Callable[[Any], str]:
        """Return the function that fills it; `getter` makes the functions that find the values."""
        if self.constant is not None:
            text = self.constant
            return lambda _: text
        found = [part if isinstance(part, str) else getter(part) for part in self.parts]
        return lambda message: "".join(
            part if isinstance(part, str) else str(part(message)) for part in found
        )


def parse(text: str) -> Template:
    """Return the template that `text` writes. Raises `WrongPath`."""
    return Template(tuple(_parts(text)))


def _parts(text: str) -> Iterator[str | Path]:
    rest = text
    while rest:
        before, opened, rest = rest.partition("{")
        if "}" in before:
            raise WrongPath(f'"{text}" has a }} without a {{; write {{header.frame_id}}')
        if before:
            yield before
        if opened:
            inside, closed, rest = rest.partition("}")
            if not closed:
                raise WrongPath(f'"{text}" has a {{ without a }}; write {{header.frame_id}}')
            yield paths.parse(inside)


def in_id(value: Any, path: Path) -> str:
    """Return `value` as it may stand in an entity id: what an id cannot hold becomes a hyphen."""
    text = _NOT_IN_IDS.sub("-", str(value)).strip("-")
    if not text:
        raise NoId(f"{path} is empty, so there is no telling which entity the message is about")
    if len(text) > LONGEST_FILLING:
        raise NoId(f"{path} has {len(text)} characters, and an id takes at most {LONGEST_FILLING} of a field")
    return text
