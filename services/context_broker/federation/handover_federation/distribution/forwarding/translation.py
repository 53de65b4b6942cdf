"""Translates documents to the names of another @context or to an older version of NGSI-LD.

Names are translated for jsonldContext (clause 4.3.6.6). For ngsildConformance, parts that an older source
does not know are rewritten or left out (clause 4.3.6.8).
"""

from collections.abc import Mapping
from typing import Any, Final

from handover_broker.model.entity import VALUE_MEMBER, Terms
from handover_broker.model.negotiation import Version, version_of
from handover_broker.model.representation import conformance
from handover_broker.query.parameters import SINCE

_NAMES_NOTHING: Final = frozenset(
    {"id", "@id", "@context", "scope", "expiresAt", "createdAt", "modifiedAt", "deletedAt", "observedAt",
     "unitCode", "datasetId", "instanceId", "valueType", "lang", *VALUE_MEMBER.values()}
)  # fmt: skip
"""Members with the same name in every @context, whose content is not translated."""
_OF_TERMS: Final = frozenset({"type", "@type", "vocab", "objectType"})
"""Members whose content is a term or a list of terms."""
_KINDS: Final = frozenset(VALUE_MEMBER)


def translated(document: Mapping[str, Any], before: Terms, after: Terms) -> dict[str, Any]:
    """Return an entity, a part of one or an attribute (normalized or concise) with translated names."""
    result: dict[str, Any] = {}
    for name, value in document.items():
        if name in _OF_TERMS:
            result[name] = _terms(value, before, after)
        elif name in _NAMES_NOTHING:
            result[name] = value
        else:
            result[after.compact(before.expand(name))] = _attribute(value, before, after)
    return result


def older(document: Any, version: str) -> Any:
    """Return an entity, a part of one, an attribute or a list of them as `version` (such as "1.6") has it."""
    at = version_of(version.removeprefix("v"))
    if at is None or at >= conformance.OURS:
        return document
    if isinstance(document, list):
        return [older(part, version) for part in document]
    if not isinstance(document, dict) or document.get("type") in {"Query", "Subscription"}:
        return _older_question(document, at) if isinstance(document, dict) else document
    if "id" in document and "type" in document:
        return conformance.conformed(document, at)
    if not _KEYS.isdisjoint(document):
        return conformance.conformed({**_ANYTHING, _PART: document}, at)[_PART]
    whole = conformance.conformed({**_ANYTHING, **document}, at)
    return {name: value for name, value in whole.items() if name in document}


def _older_question(document: dict[str, Any], at: Version) -> dict[str, Any]:
    """Return a query or a subscription without later members: an older source would refuse all of it."""
    members = {name: value for name, value in document.items() if at >= _LATE_MEMBERS.get(name, at)}
    notification = document.get("notification")
    if isinstance(notification, dict):
        late = {name for name, since in _LATE_IN_NOTIFICATION.items() if at < since}
        members["notification"] = {name: value for name, value in notification.items() if name not in late}
    return members


_LATE_MEMBERS: Final = SINCE | {"notificationTrigger": (1, 6), "jsonldContext": (1, 7)}
"""Members of a query or a subscription with the version that introduced them."""
_LATE_IN_NOTIFICATION: Final = {"showChanges": (1, 6), "sysAttrs": (1, 6)}
_ANYTHING: Final = {"id": "urn:ngsi-ld:Part:1", "type": "Part"}
_PART: Final = "part"


def _terms(value: Any, before: Terms, after: Terms) -> Any:
    if isinstance(value, list):
        return [_terms(part, before, after) for part in value]
    if not isinstance(value, str) or value in _KINDS:
        return value
    return after.compact(before.expand(value))


def _attribute(value: Any, before: Terms, after: Terms) -> Any:
    if isinstance(value, list) and all(
        isinstance(instance, dict) and instance.get("type") in _KINDS for instance in value
    ):
        return [_attribute(instance, before, after) for instance in value]
    if isinstance(value, dict) and (value.get("type") in _KINDS or not _KEYS.isdisjoint(value)):
        return translated(value, before, after)
    return value


_KEYS: Final = frozenset(VALUE_MEMBER.values())
