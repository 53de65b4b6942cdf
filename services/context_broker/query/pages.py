"""Pages: a piece of the hits at a time, and the way to the piece before and after (clauses 5.5.9, 6.3.10).

The links carry a place in the order beside the offset. What comes or goes between two requests moves what an
offset counts, but not the place; so a walk along the links neither repeats nor misses what was there all the
time.
"""

import binascii
from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final
from zlib import crc32

import orjson

from services.context_broker.model.problems import bad_request_data
from services.context_broker.model.validation import shown

DEFAULT_LIMIT: Final = 20
MAX_LIMIT: Final = 1000
MAX_PLACE_LENGTH: Final = 32 * 1024
"""Characters of a place: ten texts by which entities are ordered fit in, of any script."""

PLACE: Final = "place"
"""The query parameter that carries a place in the order, written by the broker for the broker."""


@dataclass(frozen=True, slots=True)
class Place:
    """Between which two entities a page starts, or ends if it is read backwards.

    It is told by the entity before (or after) it: its `seq`, and what it was ordered by.
    """

    seq: int
    told: Sequence[Any] = ()
    is_end: bool = False

    def written(self, mark: int) -> str:
        """Return the place as text for a URL; `mark` tells the order that it is a place in."""
        text = orjson.dumps([self.is_end, self.seq, mark, self.told])
        return urlsafe_b64encode(text).rstrip(b"=").decode()


@dataclass(frozen=True, slots=True)
class Window:
    """Which piece of the hits is wanted: from a place on, or without one from an offset on."""

    offset: int
    limit: int
    count: bool
    place: Place | None = None


def mark_of(*parts: str | bytes) -> int:
    """Return a number that tells one order from another."""
    mark = 0
    for part in parts:
        mark = crc32(part.encode() if isinstance(part, str) else part, mark)
    return mark


def place_of(text: str, mark: int) -> Place:
    """Return a place that `Place.written` wrote; raise a problem (400) for any other, or of another order."""
    place, of_order = _read(text)
    if place is None:
        raise bad_request_data(
            f"{PLACE}={shown(text)} is not from a Link header of this broker; leave it out to start anew"
        )
    if of_order != mark:
        raise bad_request_data(
            f"{PLACE} belongs to a query with another order or @context; use the links as they are, or leave "
            f"{PLACE} out to start anew"
        )
    return place


def _read(text: str) -> tuple[Place | None, Any]:
    if len(text) > MAX_PLACE_LENGTH:
        return None, None
    try:
        is_end, seq, mark, told = orjson.loads(urlsafe_b64decode(text + "=" * (-len(text) % 4)))
    except (binascii.Error, orjson.JSONDecodeError, ValueError, TypeError):
        return None, None
    is_place = isinstance(is_end, bool) and isinstance(seq, int) and isinstance(told, list)
    return Place(seq, told, is_end) if is_place else None, mark
