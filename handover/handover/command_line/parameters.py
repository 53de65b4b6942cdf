"""Parameters on the command line, as `name=value`."""

from typing import Any

import orjson

from handover.errors import UsageError


def parse_parameter(text: str) -> tuple[str, Any]:
    """Return name and value of `name=value`; raise `UsageError`."""
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise UsageError(f'a parameter is given as name=value, not "{text}"')
    try:
        return name, orjson.loads(value)
    except orjson.JSONDecodeError:
        return name, value
