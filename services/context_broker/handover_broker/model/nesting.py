"""The maximum nesting of JSON: less than what can be written inside an entity, its history or a page."""

from typing import Any, Final

import orjson

from handover.errors import Problem
from handover_broker.model.problems import bad_request_data

MAX_NESTING: Final = 200
"""Maximum levels of objects and lists in a body, or in the value of an attribute."""
_WRITTEN: Final = 254
"""Levels that orjson writes; it reads 1024."""


def is_too_deep(document: Any) -> bool:
    """Return whether a parsed document has more than `MAX_NESTING` levels.

    orjson checks it, at a third of the cost of parsing; Python would take ten times as long.
    """
    for _ in range(_WRITTEN - MAX_NESTING):
        document = [document]
    try:
        orjson.dumps(document)
    except orjson.JSONEncodeError:
        return True
    return False


def too_deep() -> Problem:
    """The body, or a value in it, has too many levels."""
    return bad_request_data(
        f"the body is nested deeper than {MAX_NESTING} levels of objects and lists; send it flatter"
    )
