"""Latest: which news of the broker is news, whether it comes by notification or by asking.

Notifications may be late, doubled or lost. What is older than what is known is let pass; what is known is
not said again; and what a bridge itself wrote from the ROS graph is not sent back there. Pure.
"""

from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from datamodels.times import parse
from ros_fiware_bridge.mapping.values import OBSERVED_AT
from ros_fiware_bridge.rules import origin
from ros_fiware_bridge.rules.inward import Scope

MOST_REMEMBERED = 10_000
ECHO_WITHIN_S = 5.0
"""What comes back from the graph later than this is said by somebody, not an echo."""
NULL = "urn:ngsi-ld:null"
_MEMBERS = ("value", "object", "languageMap", "json")


@dataclass(slots=True)
class _Known:
    digests: dict[str, str] = field(default_factory=dict)
    observed: dict[str, str] = field(default_factory=dict)
    foreign: dict[str, tuple[str, float]] = field(default_factory=dict)
    """Digests of what others wrote, and when, as long as nothing of the graph has been written over it."""


class Latest:
    """What is known of the `attributes` of entities; of every one of an entity if none is named."""

    def __init__(self, attributes: Iterable[str]) -> None:
        self._attributes = frozenset(attributes)
        self._known: OrderedDict[str, _Known] = OrderedDict()

    def take(self, entity: Mapping[str, Any], now_s: float) -> bool:
        """Take notice of an entity (normalized); say whether it has news for the ROS graph."""
        entity_id = str(entity.get("id"))
        seen = {
            name: attribute
            for name, attribute in entity.items()
            if (not self._attributes or name in self._attributes) and _says_something(attribute)
        }
        known = self._known.setdefault(entity_id, _Known())
        news = False
        for name, attribute in seen.items():
            at = str(attribute.get("observedAt", ""))
            if _is_older(at, known.observed.get(name, "")):
                continue
            now = origin.digest(attribute)
            if known.digests.get(name) != now or known.observed.get(name, "") != at:
                known.foreign.pop(name, None)
                if not origin.is_ours(attribute):
                    news, known.foreign[name] = True, (origin.coarse_digest(_value_of(attribute)), now_s)
            known.digests[name], known.observed[name] = now, at
        self._known.move_to_end(entity_id)
        while len(self._known) > MOST_REMEMBERED:
            self._known.popitem(last=False)
        return news

    def is_echo(self, entity_id: str, attribute: str, value: Any, now_s: float) -> bool:
        """Say whether this value is what somebody else wrote just now, which need not be written again."""
        known = self._known.get(entity_id)
        written, at_s = known.foreign.get(attribute, ("", 0.0)) if known is not None else ("", 0.0)
        return now_s - at_s <= ECHO_WITHIN_S and written == origin.coarse_digest(value)

    def wrote(self, entity_id: str, attribute: str) -> None:
        """Take notice that something from the ROS graph is being written over what others wrote."""
        if (known := self._known.get(entity_id)) is not None:
            known.foreign.pop(attribute, None)


def scope_of(entity: Mapping[str, Any], now_s: float) -> Scope:
    """Return what messages are filled from: the attributes of `entity` by name, and `id`, its last part."""
    values: dict[str, Any] = {}
    observed: dict[str, str] = {}
    for name, attribute in entity.items():
        if not isinstance(attribute, Mapping):
            continue
        for member in _MEMBERS:
            if member in attribute:
                values[name] = _plain(attribute[member])
        if isinstance(at := attribute.get("observedAt"), str):
            observed[name] = at
    values[OBSERVED_AT] = observed
    values["entityId"] = str(entity.get("id"))
    values["id"] = str(entity.get("id")).rsplit(":", 1)[-1]
    values["type"] = entity.get("type")
    return Scope(values, observed, now_s)


def _value_of(attribute: Mapping[str, Any]) -> Any:
    return next((attribute[member] for member in _MEMBERS if member in attribute), None)


def _says_something(attribute: Any) -> bool:
    """Say whether `attribute` has a value; one that was deleted has none, or NGSI-LD's null."""
    if not isinstance(attribute, Mapping):
        return False
    values = (attribute[member] for member in _MEMBERS if member in attribute)
    return any(value is not None and value != NULL for value in values)


def _plain(value: Any) -> Any:
    """Return the moment in `{"@type": "DateTime", "@value": …}`; any other value as it is."""
    return value["@value"] if isinstance(value, Mapping) and "@value" in value else value


def _is_older(at: str, known: str) -> bool:
    if not at or not known or at == known:
        return False
    try:
        return parse(at) < parse(known)
    except ValueError:
        return False
