"""Content digest: shows whether an entity is still as a component of ours has written it.

Any client may change any entity in the broker, and the broker does not say which one did. A component writes
the digest of its entity as an attribute of it. An entity whose digest fits its content is ours; one without a
digest, or changed since, is of another system. This is no protection: any client can compute the digest.
"""

import hashlib
from collections.abc import Mapping
from typing import Any

import orjson

ATTRIBUTE = "contentDigest"
LENGTH = 32
"""Characters of a digest."""

_NO_CONTENT = frozenset({ATTRIBUTE, "@context", "createdAt", "modifiedAt"})


def digest_of(entity: Mapping[str, Any]) -> str:
    """Return the digest of a normalized entity: id, type, values and objects, without metadata and times."""
    content = {name: _plain(value) for name, value in entity.items() if name not in _NO_CONTENT}
    written = orjson.dumps(content, option=orjson.OPT_SORT_KEYS)
    return hashlib.sha256(written).hexdigest()[:LENGTH]


def with_digest(entity: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entity with its digest."""
    return {**entity, ATTRIBUTE: {"type": "Property", "value": digest_of(entity)}}


def is_ours(entity: Mapping[str, Any]) -> bool:
    """Return whether an entity is as a component of ours has written it."""
    attribute = entity.get(ATTRIBUTE)
    return isinstance(attribute, Mapping) and attribute.get("value") == digest_of(entity)


def _plain(value: Any) -> Any:
    """Return an attribute without metadata; whole numbers are equal however they are written."""
    if isinstance(value, Mapping):
        named = [name for name in ("value", "object", "languageMap", "json") if name in value]
        if "type" in value and named:
            return _plain(value[named[0]])
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_plain(part) for part in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value
