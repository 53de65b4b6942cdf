"""Decides which states of entities are written: limits the rate, and suppresses unchanged values.

Pure: the caller passes the time (seconds, any monotonic clock).
"""

import math
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from handover_ros.mapping.values import DeadBand


@dataclass(slots=True)
class _Written:
    at_s: float
    values: Mapping[str, Any]


class UpdateFilter:
    """The last written values of each entity of one rule, for at most `max_entities` entities.

    `dead_bands` are by attribute. With `on_change`, or with any dead band, an entity is written only after a
    change, which must exceed the dead band of its attribute.
    """

    def __init__(
        self,
        *,
        every_s: float = 0.0,
        on_change: bool = False,
        dead_bands: Mapping[str, DeadBand] | None = None,
        at_least_every_s: float | None = None,
        max_entities: int = 1000,
    ) -> None:
        self._every_s = every_s
        self._dead_bands = dict(dead_bands or {})
        self._only_changes = on_change or bool(self._dead_bands)
        self._at_least_every_s = math.inf if at_least_every_s is None else at_least_every_s
        self._max_entities = max_entities
        self._written: OrderedDict[str, _Written] = OrderedDict()

    def wait_s(self, entity_id: str, now_s: float) -> float:
        """Return how long the entity must not be written yet; 0 if it may be written now."""
        last = self._written.get(entity_id)
        return 0.0 if last is None else max(last.at_s + self._every_s - now_s, 0.0)

    def is_change(self, entity_id: str, values: Mapping[str, Any], now_s: float) -> bool:
        """Return whether `values` must be written, given the last written ones."""
        last = self._written.get(entity_id)
        if last is None or not self._only_changes or now_s - last.at_s >= self._at_least_every_s:
            return True
        if values.keys() != last.values.keys():
            return True
        return any(
            differs(last.values[name], value, self._dead_bands.get(name)) for name, value in values.items()
        )

    def record(self, entity_id: str, values: Mapping[str, Any], now_s: float) -> None:
        """Record that `values` are being written."""
        self._written[entity_id] = _Written(now_s, values)
        self._written.move_to_end(entity_id)
        while len(self._written) > self._max_entities:
            self._written.popitem(last=False)

    def forget(self, entity_id: str) -> None:
        """Forget the last written values: the broker does not have them."""
        self._written.pop(entity_id, None)


def differs(before: Any, now: Any, band: DeadBand | None = None) -> bool:
    """Return whether the values differ: for numbers, by more than `band`."""
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
        limit = band.absolute or 0.0  # the common case: joints, a thousand times a second
        return any(abs(new - old) > limit for old, new in zip(before, now, strict=True))
    return any(differs(old, new, band) for old, new in zip(before, now, strict=True))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
