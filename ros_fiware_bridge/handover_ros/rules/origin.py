"""Marks attributes that came from the ROS graph, so that they are not sent back to it.

The mark is a sub-attribute, `origin`, with the name of the writer and a digest of the value. A change by
another client either removes the mark or no longer matches the digest, so it counts as a change.
"""

import zlib
from collections.abc import Mapping
from typing import Any

import orjson

MARK = "origin"


def marked(attribute: dict[str, Any], who: str) -> dict[str, Any]:
    """Return `attribute` (normalized) with the mark of `who`."""
    return {**attribute, MARK: {"type": "Property", "value": f"{who}#{digest(attribute)}"}}


def is_ours(attribute: Any) -> bool:
    """Return whether `attribute` of the broker is still what a bridge wrote from the ROS graph."""
    if not isinstance(attribute, Mapping) or not isinstance(attribute.get(MARK), Mapping):
        return False
    written = attribute[MARK].get("value")
    return isinstance(written, str) and written.rpartition("#")[2] == digest(attribute)


def digest(attribute: Mapping[str, Any]) -> str:
    """Return a short text that is the same for the same value, whichever broker returns it."""
    value = next(
        (attribute[member] for member in ("value", "object", "languageMap", "json") if member in attribute),
        None,
    )
    written = orjson.dumps(_plain(value), option=orjson.OPT_SORT_KEYS | orjson.OPT_NON_STR_KEYS)
    return f"{zlib.crc32(written):08x}"


def coarse_digest(value: Any) -> str:
    """Return a digest that is the same for numbers that are equal as `float32`."""
    return digest({"value": _rounded(value)})


def _rounded(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(f"{value:.6g}")
    if isinstance(value, Mapping):
        return {key: _rounded(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(element) for element in value]
    return value


def _plain(value: Any) -> Any:
    """Return `value` with numbers in the form that all brokers agree on: 1.0 is 1."""
    if isinstance(value, float):
        return int(value) if value.is_integer() and abs(value) < 2**53 else value
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(element) for element in value]
    return value
