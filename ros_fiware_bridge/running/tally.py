"""The tally of one rule: how much it has heard and told, how fast, and what went wrong last."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import orjson

from datamodels.times import iso
from handover.telemetry import get_logger
from ros_fiware_bridge.metrics import CONFLATED, DROPPED, FAULTS, HEARD, TOLD

log = get_logger(__name__)

SETTLES_S = 5.0
LOG_EVERY_S = 10.0
LONGEST_SHOWN = 500
LONGEST_VALUE = 4096
"""In bytes of JSON; what is shown every few seconds must stay small."""


@dataclass(slots=True)
class Rate:
    """How often something happens, in 1/s, over some seconds."""

    _weight: float = 0.0
    _at_s: float = 0.0

    def count(self, now_s: float) -> None:
        """Take notice that it has happened."""
        self._weight = self._weight * math.exp((self._at_s - now_s) / SETTLES_S) + 1.0
        self._at_s = now_s

    def per_s(self, now_s: float) -> float:
        """Return how often it happens at this moment."""
        return self._weight * math.exp((self._at_s - now_s) / SETTLES_S) / SETTLES_S


@dataclass(slots=True)
class Tally:
    """What is counted of the rule `name`; `enabled` is whether it is at work."""

    name: str
    section: str
    enabled: bool = True
    heard: int = 0
    told: int = 0
    conflated: int = 0
    losses: dict[str, int] = field(default_factory=dict)
    """How many messages were lost, by cause (see `losses.py`)."""
    faults: int = 0
    last_value: Any = None
    last_fault: str | None = None
    last_fault_at: str | None = None
    hearing: Rate = field(default_factory=Rate)
    telling: Rate = field(default_factory=Rate)
    _logged: tuple[str, float] = ("", -math.inf)
    _counters: tuple[Any, Any, Any, Any] = field(init=False)

    def __post_init__(self) -> None:
        self._counters = tuple(metric.labels(self.name) for metric in (HEARD, TOLD, CONFLATED, FAULTS))  # type: ignore[assignment]  # four of them

    def hear(self, now_s: float) -> None:
        """Count something that came."""
        self.heard += 1
        self.hearing.count(now_s)
        self._counters[0].inc()

    def tell(self, now_s: float, value: Any) -> None:
        """Count something that the other side has taken; `value` is shown as the last."""
        self.told += 1
        self.telling.count(now_s)
        self.last_value = value
        self._counters[1].inc()

    @property
    def dropped(self) -> int:
        """How many messages were lost."""
        return sum(self.losses.values())

    def lose(self, cause: str, number: int = 1) -> None:
        """Count messages that were lost."""
        if number:
            self.losses[cause] = self.losses.get(cause, 0) + number
            DROPPED.labels(self.name, cause).inc(number)

    def conflate(self, number: int) -> None:
        """Count messages that gave way to newer ones on purpose."""
        if number:
            self.conflated += number
            self._counters[2].inc(number)

    def fault(self, why: str, now_s: float) -> None:
        """Count what could not be passed on; the log has it once in a while, however often it happens."""
        self.faults += 1
        self._counters[3].inc()
        self.last_fault = why[:LONGEST_SHOWN]
        self.last_fault_at = iso(datetime.now(UTC), "milliseconds")
        kind, logged_at_s = self._logged
        if now_s - logged_at_s >= LOG_EVERY_S or kind != why[:60]:
            self._logged = (why[:60], now_s)
            log.warning("a rule could not pass something on", rule=self.name, why=why[:LONGEST_SHOWN])

    def view(self, now_s: float) -> Mapping[str, Any]:
        """Return it as it is shown."""
        return {
            "name": self.name,
            "section": self.section,
            "enabled": self.enabled,
            "heard": self.heard,
            "heardPerS": round(self.hearing.per_s(now_s), 2),
            "told": self.told,
            "toldPerS": round(self.telling.per_s(now_s), 2),
            "dropped": self.dropped,
            "losses": dict(self.losses),
            "conflated": self.conflated,
            "faults": self.faults,
            "lastValue": _shown(self.last_value),
            "lastError": self.last_fault,
            "lastErrorAt": self.last_fault_at,
        }


def _shown(value: Any) -> Any:
    """Return `value`, or of a long one its beginning."""
    written = orjson.dumps(value, option=orjson.OPT_NON_STR_KEYS, default=str)
    if len(written) <= LONGEST_VALUE:
        return value
    return f"{written[:LONGEST_SHOWN].decode(errors='ignore')}… ({len(written)} bytes)"
