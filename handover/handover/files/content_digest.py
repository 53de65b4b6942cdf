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
    content = {name: _plain(each) for name, each in entity.items() if name not in _NO_CONTENT}
    written = orjson.dumps(content, option=orjson.OPT_SORT_KEYS)
    return hashlib.sha256(written).hexdigest()[:LENGTH]


def with_digest(entity: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entity with its digest."""
    return {**entity, ATTRIBUTE: {"type": "Property", "value": digest_of(entity)}}


def is_ours(entity: Mapping[str, Any]) -> bool:
    """Return whether an entity is as a component of ours has written it."""
    given = entity.get(ATTRIBUTE)
    return isinstance(given, Mapping) and given.get("value") == digest_of(entity)


def _plain(given: Any) -> Any:
    """Return an attribute without metadata; whole numbers are equal however they are written."""
    if isinstance(given, Mapping):
        named = [name for name in ("value", "object", "languageMap", "json") if name in given]
        if "type" in given and named:
            return _plain(given[named[0]])
        return {name: _plain(each) for name, each in given.items()}
    if isinstance(given, list):
        return [_plain(each) for each in given]
    return int(given) if isinstance(given, float) and given.is_integer() else given
