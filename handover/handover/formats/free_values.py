"""Values that users choose, on brokers that change them: JSON text travels beside the readable value.

Orion-LD 1.6 keeps 32 bits of an integer and reads a list of one element back as the element. So what it would
change is written as text, too, into the sub-attribute `asText` of the same attribute: both are replaced
together. The text counts as long as the readable value is what became of it; another one, which somebody else
has written, counts itself.
"""

from collections.abc import Mapping
from typing import Any, Final

import orjson

FREE_VALUES: Final = ("workParameters", "outputParameters")
AS_TEXT: Final = "asText"
_BITS: Final = 32


def with_texts(entity: Mapping[str, Any], *, prefix: str = "") -> Mapping[str, Any]:
    """Return a normalized entity or its attributes, with the texts of values that a broker may change.

    The names of attributes in it begin with `prefix`.
    """
    added = {}
    for name in (f"{prefix}{member}" for member in FREE_VALUES):
        attribute = entity.get(name)
        if isinstance(attribute, Mapping) and not _is_same(value := attribute.get("value"), reduced(value)):
            text = {"type": "Property", "value": orjson.dumps(value).decode()}
            added[name] = {**attribute, f"{prefix}{AS_TEXT}": text}
    return {**entity, **added} if added else entity


def without_texts(entity: dict[str, Any], *, prefix: str = "") -> dict[str, Any]:
    """Return a normalized entity that was read with the values of its texts, and without these."""
    for name in (f"{prefix}{member}" for member in FREE_VALUES):
        attribute = entity.get(name)
        if not isinstance(attribute, dict) or f"{prefix}{AS_TEXT}" not in attribute:
            continue
        text = attribute.pop(f"{prefix}{AS_TEXT}")
        try:
            value = orjson.loads(text["value"])
        except (orjson.JSONDecodeError, TypeError, KeyError):
            continue
        if _is_same(reduced(value), reduced(attribute.get("value"))):
            attribute["value"] = value
    return entity


def reduced(value: Any) -> Any:
    """Return what such a broker makes of a value: integers of 32 bits, and no list of one element."""
    if isinstance(value, list):
        return reduced(value[0]) if len(value) == 1 else [reduced(part) for part in value]
    if isinstance(value, dict):
        return {name: reduced(part) for name, part in value.items()}
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if isinstance(value, int) and not isinstance(value, bool):
        half = 1 << (_BITS - 1)
        return (value + half) % (1 << _BITS) - half
    return value


def _is_same(value: Any, other: Any) -> bool:
    """Compare as JSON does: true is not 1, 1.0 is 1."""
    if isinstance(value, bool) or isinstance(other, bool):
        return value is other
    if isinstance(value, list) and isinstance(other, list):
        return len(value) == len(other) and all(map(_is_same, value, other))
    if isinstance(value, dict) and isinstance(other, dict):
        return value.keys() == other.keys() and all(_is_same(value[name], other[name]) for name in value)
    return bool(value == other)
