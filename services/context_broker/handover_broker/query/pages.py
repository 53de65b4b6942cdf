"""Pages of results, and the links to the previous and the next page (clauses 5.5.9, 6.3.10).

The links contain a position in the order beside the offset. Entities that are created or deleted between two
requests shift offsets but not positions. So following the links neither repeats nor misses an entity that
exists all the time.
"""

import binascii
from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final
from zlib import crc32

import orjson

from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import shown

DEFAULT_LIMIT: Final = 20
MAX_LIMIT: Final = 1000
MAX_PLACE_LENGTH: Final = 32 * 1024
"""Maximum length of a position: ten texts of sort keys fit, in any script."""

PLACE: Final = "place"
"""The query parameter with a position in the order, which only the broker writes."""


@dataclass(frozen=True, slots=True)
class PagePosition:
    """A position between two entities: a page starts after it, or ends before it when read backwards.

    It is given by the entity before (or after) it: its `seq`, and its sort key.
    """

    seq: int
    sort_key: Sequence[Any] = ()
    is_end: bool = False

    def written(self, mark: int) -> str:
        """Return the position as text for a URL; `mark` identifies the order."""
        text = orjson.dumps([self.is_end, self.seq, mark, self.sort_key])
        return urlsafe_b64encode(text).rstrip(b"=").decode()


@dataclass(frozen=True, slots=True)
class Window:
    """The requested page: after a position, or from an offset on."""

    offset: int
    limit: int
    count: bool
    place: PagePosition | None = None


def mark_of(*parts: str | bytes) -> int:
    """Return a number that identifies an order."""
    mark = 0
    for part in parts:
        mark = crc32(part.encode() if isinstance(part, str) else part, mark)
    return mark


def place_of(text: str, mark: int) -> PagePosition:
    """Return the position that `Place.written` wrote; raise a problem (400) for any other, or of another
    order."""
    place, of_order = _read(text)
    if place is None:
        raise bad_request_data(
            f"{PLACE}={shown(text)} is not from a Link header of this broker; leave it out to start again"
        )
    if of_order != mark:
        raise bad_request_data(
            f"{PLACE} belongs to a query with another order or @context; use the links as they are, or leave "
            f"{PLACE} out to start again"
        )
    return place


def _read(text: str) -> tuple[PagePosition | None, Any]:
    if len(text) > MAX_PLACE_LENGTH:
        return None, None
    try:
        is_end, seq, mark, sort_key = orjson.loads(urlsafe_b64decode(text + "=" * (-len(text) % 4)))
    except (binascii.Error, orjson.JSONDecodeError, ValueError, TypeError):
        return None, None
    is_place = isinstance(is_end, bool) and isinstance(seq, int) and isinstance(sort_key, list)
    return PagePosition(seq, sort_key, is_end) if is_place else None, mark
