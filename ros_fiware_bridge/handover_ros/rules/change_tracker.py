"""Detects changes of entities in the broker, from notifications and from polling alike.

Notifications may be late, duplicated or lost. Older states are ignored, and a known state is not a change.
A value that the bridge itself wrote from the ROS graph is not sent back to the graph. Pure.
"""

import math
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from handover_datamodels.times import parse
from handover_ros.mapping.values import OBSERVED_AT
from handover_ros.rules import origin
from handover_ros.rules.message_builder import Scope

MAX_TRACKED_ENTITIES = 10_000
ECHO_WINDOW_S = 5.0
"""A value that returns from the graph later than this is not treated as an echo."""
MISSED_AFTER_S = 10.0
"""A polled state that was not notified within this time counts as missed."""
NULL = "urn:ngsi-ld:null"
_MEMBERS = ("value", "object", "languageMap", "json")


@dataclass(slots=True)
class _Known:
    digests: dict[str, str] = field(default_factory=dict)
    observed: dict[str, str] = field(default_factory=dict)
    foreign: dict[str, tuple[str, float]] = field(default_factory=dict)
    """Digest and time of the values that other clients wrote, until a value of the graph replaces them."""
    taken_s: float = -math.inf
    unnotified: tuple[dict[str, tuple[str, str]], float] | None = None
    """A polled state that differs from the known one, and when it was first polled."""


class ChangeTracker:
    """The last known state of the `attributes` of entities; of all attributes if none is named."""

    def __init__(self, attributes: Iterable[str]) -> None:
        self._attributes = frozenset(attributes)
        self._known: OrderedDict[str, _Known] = OrderedDict()

    def take(self, entity: Mapping[str, Any], now_s: float) -> bool:
        """Record the state of an entity (normalized); return whether it has changed for the ROS graph."""
        entity_id = str(entity.get("id"))
        entity_state = self._known.setdefault(entity_id, _Known())
        entity_state.taken_s, entity_state.unnotified = now_s, None
        changed = False
        for name, attribute in self._watched(entity).items():
            at = str(attribute.get("observedAt", ""))
            if _is_older(at, entity_state.observed.get(name, "")):
                continue
            now = origin.digest(attribute)
            if entity_state.digests.get(name) != now or entity_state.observed.get(name, "") != at:
                entity_state.foreign.pop(name, None)
                if not origin.is_ours(attribute):
                    changed, entity_state.foreign[name] = (
                        True,
                        (origin.coarse_digest(_value_of(attribute)), now_s),
                    )
            entity_state.digests[name], entity_state.observed[name] = now, at
        self._trim(entity_id)
        return changed

    def was_taken_since(self, entity_id: str, read_s: float) -> bool:
        """Return whether a state was recorded since `read_s`; what was read then may be older."""
        return (entity := self._known.get(entity_id)) is not None and entity.taken_s >= read_s

    def is_missed(self, entity: Mapping[str, Any], now_s: float) -> bool:
        """Return whether a polled state was never notified.

        A poll overtakes notifications that are still on their way. A state counts as missed if polls have
        returned it for `MISSED_AFTER_S`, and no notification of the entity has arrived in that time.
        """
        entity_id = str(entity.get("id"))
        entity_state = self._known.setdefault(entity_id, _Known())
        self._trim(entity_id)
        state = {
            name: (origin.digest(attribute), str(attribute.get("observedAt", "")))
            for name, attribute in self._watched(entity).items()
        }
        if all(
            (entity_state.digests.get(name), entity_state.observed.get(name)) == digests
            for name, digests in state.items()
        ):
            entity_state.unnotified = None
            return False
        if entity_state.unnotified is None or entity_state.unnotified[0] != state:
            entity_state.unnotified = state, now_s
        return now_s - entity_state.unnotified[1] >= MISSED_AFTER_S

    def is_echo(self, entity_id: str, attribute: str, value: Any, now_s: float) -> bool:
        """Return whether this value is what another client has just written."""
        entity = self._known.get(entity_id)
        written, at_s = entity.foreign.get(attribute, ("", 0.0)) if entity is not None else ("", 0.0)
        return now_s - at_s <= ECHO_WINDOW_S and written == origin.coarse_digest(value)

    def wrote(self, entity_id: str, attribute: str) -> None:
        """Record that a value of the ROS graph replaces what other clients wrote."""
        if (entity := self._known.get(entity_id)) is not None:
            entity.foreign.pop(attribute, None)

    def _watched(self, entity: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
        return {
            name: attribute
            for name, attribute in entity.items()
            if (not self._attributes or name in self._attributes) and _has_value(attribute)
        }

    def _trim(self, latest: str) -> None:
        self._known.move_to_end(latest)
        while len(self._known) > MAX_TRACKED_ENTITIES:
            self._known.popitem(last=False)


def scope_of(entity: Mapping[str, Any], now_s: float) -> Scope:
    """Return the values for messages: the attributes of `entity`, and `id`, the last part of its id."""
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


def _has_value(attribute: Any) -> bool:
    """Return whether `attribute` has a value; a deleted one has none, or NGSI-LD's null."""
    if not isinstance(attribute, Mapping):
        return False
    values = (attribute[member] for member in _MEMBERS if member in attribute)
    return any(value is not None and value != NULL for value in values)


def _plain(value: Any) -> Any:
    """Return the time of `{"@type": "DateTime", "@value": …}`; any other value unchanged."""
    return value["@value"] if isinstance(value, Mapping) and "@value" in value else value


def _is_older(at: str, latest: str) -> bool:
    if not at or not latest or at == latest:
        return False
    try:
        return parse(at) < parse(latest)
    except ValueError:
        return False
