"""Origin: what came from the ROS graph carries a mark, so that it is not sent back there.

The mark is an attribute of the attribute, `origin`, with who wrote it and a digest of what was written. A
change made by somebody else either takes the mark away or no longer fits the digest, and is news then.
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
    """Say whether `attribute`, as the broker tells it, still is what a bridge wrote from the ROS graph."""
    if not isinstance(attribute, Mapping) or not isinstance(attribute.get(MARK), Mapping):
        return False
    written = attribute[MARK].get("value")
    return isinstance(written, str) and written.rpartition("#")[2] == digest(attribute)


def digest(attribute: Mapping[str, Any]) -> str:
    """Return a short text that is the same for the same value, whichever broker tells it."""
    value = next(
        (attribute[member] for member in ("value", "object", "languageMap", "json") if member in attribute),
        None,
    )
    written = orjson.dumps(_plain(value), option=orjson.OPT_SORT_KEYS | orjson.OPT_NON_STR_KEYS)
    return f"{zlib.crc32(written):08x}"


def coarse_digest(value: Any) -> str:
    """Return a digest that is the same for numbers that a `float32` cannot tell apart."""
    return digest({"value": _rounded(value)})


def _rounded(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(f"{value:.6g}")
    if isinstance(value, Mapping):
        return {key: _rounded(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(one) for one in value]
    return value


def _plain(value: Any) -> Any:
    """Return `value` with numbers as every broker would tell them: 1.0 is 1."""
    if isinstance(value, float):
        return int(value) if value.is_integer() and abs(value) < 2**53 else value
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return value
