"""The cells that share a tenant of a broker: what belongs to which.

The orchestrator of each cell writes one `Cell`, whose id has the name of the cell. An entity whose id has the
name of another cell is of that cell; every other one, as those of FIWARE components with other ids, is for
all.
"""

import re
from collections.abc import Collection, Iterable, Iterator
from typing import Any, Final

from handover.broker import BrokerClient, NotFound
from handover.settings import Settings
from handover_datamodels.entities import Cell

_PREFIX: Final = "urn:ngsi-ld:"
_NAME: Final = re.compile(r"[A-Za-z0-9_.-]{1,63}")
MAX_PATTERN_LENGTH: Final = 500
"""Longest `idPattern` in characters: our broker accepts 512."""
MAX_PATTERNS: Final = 32
"""Patterns in a subscription. With more names, a broker sends notifications of all cells."""


def cell_of(entity_id: str) -> str | None:
    """Return the name of a cell in an id `urn:ngsi-ld:<Type>:<cell>:<name>`; None in any other id."""
    if not entity_id.startswith(_PREFIX):
        return None
    parts = entity_id.split(":", 4)
    return parts[3] if len(parts) == 5 else None


class OtherCells:
    """The other cells of the tenant, as they were when `read` was awaited last."""

    def __init__(self, settings: Settings, broker: BrokerClient) -> None:
        self._own = settings.factory
        self._broker = broker
        self._others: frozenset[str] = frozenset()

    async def read(self) -> None:
        """Read which cells there are. Raises `BrokerError`."""
        try:
            cells = await self._broker.query(type=Cell.ngsi_type(), attrs=["cellState"])
        except NotFound:  # no tenant yet: the first subscription makes it
            cells = []
        names = {cell_of(str(entity.get("id"))) for entity in cells}
        self._others = frozenset(name for name in names if name is not None) - {self._own}

    def has(self, entity_id: object) -> bool:
        """Return whether an entity is of another cell."""
        return bool(self._others) and cell_of(str(entity_id)) in self._others

    def selectors(self, *types: str, acts_for: Iterable[str] = ()) -> list[dict[str, Any]]:
        """Return the entities of some types that are not of another cell, as a subscription names them.

        The cells of the resources in `acts_for` count as one's own. Without it, a broker of N cells would
        send each notification to all N.
        """
        others = {name for name in self._others.difference(map(cell_of, acts_for)) if _NAME.fullmatch(name)}
        patterns = ids_without(others)
        selected = [{"idPattern": pattern} for pattern in patterns] or [{}]
        return [{"type": type_, **by_id} for type_ in types for by_id in selected]


def ids_without(cells: Collection[str]) -> list[str]:
    """Return regular expressions, one of which matches an id if it is of none of `cells`.

    The list is empty if that is every id, or if it would be too long. Brokers have different dialects of
    regular expressions, and most have no negative lookahead.
    """
    if not cells:
        return []
    foreign = ""
    for letter in reversed(_PREFIX):
        foreign = f"([^{letter}].*|{letter}{foreign})?" if foreign else f"([^{letter}].*)?"
    patterns = [f"^({_PREFIX}[^:]*(:[^:]*|::.*)?|{foreign})$"]
    start, end = f"^{_PREFIX}[^:]*:(", "):"
    branches: list[str] = []
    for branch in _branches(cells, MAX_PATTERN_LENGTH - len(start + end)):
        if branches and len(start + "|".join((*branches, branch)) + end) > MAX_PATTERN_LENGTH:
            patterns.append(start + "|".join(branches) + end)
            branches = []
        branches.append(branch)
    patterns.append(start + "|".join(branches) + end)
    return patterns if len(patterns) <= MAX_PATTERNS else []


def _branches(texts: Collection[str], max_length: int, start: str = "") -> Iterator[str]:
    """Return regular expressions, one of which matches a text that has no colon and is none of `texts`."""
    whole = start + _texts_without(texts)
    if len(whole) <= max_length:
        yield whole
        return
    rests = _by_first_letter(texts)
    for letter, rest in rests.items():
        yield from _branches(rest, max_length, start + _literal(letter))
    yield start + _other_letter(rests)
    if start and "" not in texts:
        yield start


def _texts_without(texts: Collection[str]) -> str:
    """Return a regular expression of the texts without a colon that are none of `texts`.

    For {"a", "ab"} it is `(a(b([^:][^:]*)|[^:b][^:]*)|[^:a][^:]*)?`: what may follow each first letter, or
    another first letter; the question mark is there because the empty text is none of them.
    """
    rests = _by_first_letter(texts)
    branches = [f"{_literal(letter)}{_texts_without(rest)}" for letter, rest in rests.items()]
    return f"({'|'.join((*branches, _other_letter(rests)))}){'' if '' in texts else '?'}"


def _by_first_letter(texts: Collection[str]) -> dict[str, set[str]]:
    rests: dict[str, set[str]] = {}
    for text in sorted(filter(None, texts)):
        rests.setdefault(text[0], set()).add(text[1:])
    return rests


def _other_letter(letters: Iterable[str]) -> str:
    hyphen_last = sorted(letters, key=lambda letter: (letter == "-", letter))  # elsewhere it makes a range
    return f"[^:{''.join(hyphen_last)}][^:]*"


def _literal(letter: str) -> str:
    return f"[{letter}]" if letter == "." else letter
