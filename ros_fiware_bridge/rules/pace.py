"""Pace: how often an entity is written, and whether what is heard of it is worth writing.

Pure: the time (seconds, any clock that only goes forward) is given to it.
"""

import math
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ros_fiware_bridge.mapping.values import DeadBand


@dataclass(slots=True)
class _Told:
    at_s: float
    values: Mapping[str, Any]


class Pace:
    """What one rule has last told of each of its entities; it remembers `most_entities` of them.

    `dead_bands` are by attribute; with `on_change`, or as soon as there is one, an entity is only written
    when something has changed, by more than its dead band if it has one.
    """

    def __init__(
        self,
        *,
        every_s: float = 0.0,
        on_change: bool = False,
        dead_bands: Mapping[str, DeadBand] | None = None,
        at_least_every_s: float | None = None,
        most_entities: int = 1000,
    ) -> None:
        self._every_s = every_s
        self._dead_bands = dict(dead_bands or {})
        self._only_changes = on_change or bool(self._dead_bands)
        self._at_least_every_s = math.inf if at_least_every_s is None else at_least_every_s
        self._most = most_entities
        self._told: OrderedDict[str, _Told] = OrderedDict()

    def waits_s(self, entity_id: str, now_s: float) -> float:
        """Return how long the entity must not be written yet; 0 if it may be now."""
        told = self._told.get(entity_id)
        return 0.0 if told is None else max(told.at_s + self._every_s - now_s, 0.0)

    def is_news(self, entity_id: str, values: Mapping[str, Any], now_s: float) -> bool:
        """Say whether `values` are worth writing, as far as what has been told goes."""
        told = self._told.get(entity_id)
        if told is None or not self._only_changes or now_s - told.at_s >= self._at_least_every_s:
            return True
        if values.keys() != told.values.keys():
            return True
        return any(
            differs(told.values[name], value, self._dead_bands.get(name)) for name, value in values.items()
        )

    def told(self, entity_id: str, values: Mapping[str, Any], now_s: float) -> None:
        """Take notice that `values` are on their way to the broker."""
        self._told[entity_id] = _Told(now_s, values)
        self._told.move_to_end(entity_id)
        while len(self._told) > self._most:
            self._told.popitem(last=False)

    def forget(self, entity_id: str) -> None:
        """Take notice that the broker does not have what was told."""
        self._told.pop(entity_id, None)


def differs(before: Any, now: Any, band: DeadBand | None = None) -> bool:
    """Say whether `now` is another value than `before`: for numbers, by more than `band`."""
    if isinstance(before, list) and isinstance(now, list):
        return before != now and (band is None or _lists_differ(before, now, band))
    if isinstance(before, dict) and isinstance(now, dict):
        return before.keys() != now.keys() or any(differs(before[key], now[key], band) for key in now)
    if band is None or not (_is_number(before) and _is_number(now)):
        return bool(before != now) or isinstance(before, bool) is not isinstance(now, bool)
    distance = abs(now - before)
    beyond_absolute = band.absolute is not None and distance > band.absolute
    beyond_relative = band.relative is not None and distance > band.relative * abs(before)
    if band.absolute is not None and band.relative is not None:
        return beyond_absolute and beyond_relative
    return beyond_absolute or beyond_relative


def _lists_differ(before: list[Any], now: list[Any], band: DeadBand) -> bool:
    if len(before) != len(now):
        return True
    if band.relative is None and {*map(type, before), *map(type, now)} == {float}:
        limit = band.absolute or 0.0  # the common case, of joints a thousand times a second
        return any(abs(new - old) > limit for old, new in zip(before, now, strict=True))
    return any(differs(old, new, band) for old, new in zip(before, now, strict=True))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
