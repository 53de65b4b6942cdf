"""Latest: which news of the broker is news, whether it comes by notification or by asking.

Notifications may be late, doubled or lost. What is older than what is known is let pass; what is known is
not said again; and what a bridge itself wrote from the ROS graph is not sent back there. Pure.
"""

from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from datamodels.times import parse
from ros_fiware_bridge.rules import origin
from ros_fiware_bridge.rules.inward import Scope

MOST_REMEMBERED = 10_000
_MEMBERS = ("value", "object", "languageMap", "json")


@dataclass(slots=True)
class _Known:
    digests: Mapping[str, str]
    observed: Mapping[str, str]


class Latest:
    """What is known of the `attributes` of entities; of every one of an entity if none is named."""

    def __init__(self, attributes: Iterable[str]) -> None:
        self._attributes = frozenset(attributes)
        self._known: OrderedDict[str, _Known] = OrderedDict()

    def take(self, entity: Mapping[str, Any]) -> bool:
        """Take notice of an entity (normalized); say whether it has news for the ROS graph."""
        entity_id = str(entity.get("id"))
        seen = {
            name: attribute
            for name, attribute in entity.items()
            if isinstance(attribute, Mapping) and (not self._attributes or name in self._attributes)
        }
        known = self._known.get(entity_id, _Known({}, {}))
        digests, observed, news = dict(known.digests), dict(known.observed), False
        for name, attribute in seen.items():
            at = str(attribute.get("observedAt", ""))
            if _is_older(at, observed.get(name, "")):
                continue
            now = origin.digest(attribute)
            if digests.get(name) != now or observed.get(name, "") != at:
                news = news or not origin.is_ours(attribute)
            digests[name], observed[name] = now, at
        self._known[entity_id] = _Known(digests, observed)
        self._known.move_to_end(entity_id)
        while len(self._known) > MOST_REMEMBERED:
            self._known.popitem(last=False)
        return news

    def knows(self, entity_id: str, attribute: str, value: Any) -> bool:
        """Say whether the broker is known to hold this very value; then it need not be written again."""
        known = self._known.get(entity_id)
        return known is not None and known.digests.get(attribute) == origin.digest({"value": value})


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
    values["entityId"] = str(entity.get("id"))
    values["id"] = str(entity.get("id")).rsplit(":", 1)[-1]
    values["type"] = entity.get("type")
    return Scope(values, observed, now_s)


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
