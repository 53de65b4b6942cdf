"""The statistics of one rule: counts and rates of messages, and the last error."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import orjson

from handover.telemetry import get_logger
from handover_datamodels.times import iso
from handover_ros.metrics import CONFLATED, DROPPED, ERRORS, FORWARDED, RECEIVED

log = get_logger(__name__)

RATE_TIME_CONSTANT_S = 5.0
LOG_INTERVAL_S = 10.0
MAX_SHOWN_CHARACTERS = 500
MAX_VALUE_BYTES = 4096
"""In bytes of JSON: the page reads it every few seconds."""


@dataclass(slots=True)
class Rate:
    """An exponentially weighted rate of events, in 1/s."""

    _weight: float = 0.0
    _at_s: float = 0.0

    def count(self, now_s: float) -> None:
        """Count one event."""
        self._weight = self._weight * math.exp((self._at_s - now_s) / RATE_TIME_CONSTANT_S) + 1.0
        self._at_s = now_s

    def per_s(self, now_s: float) -> float:
        """Return the present rate."""
        return self._weight * math.exp((self._at_s - now_s) / RATE_TIME_CONSTANT_S) / RATE_TIME_CONSTANT_S


@dataclass(slots=True)
class RuleStats:
    """The statistics of the rule `name`; `enabled` is whether the rule runs."""

    name: str
    section: str
    enabled: bool = True
    received: int = 0
    forwarded: int = 0
    conflated: int = 0
    dropped_by_cause: dict[str, int] = field(default_factory=dict)
    """See `CAUSES`."""
    errors: int = 0
    last_value: Any = None
    last_error: str | None = None
    last_error_at: str | None = None
    received_rate: Rate = field(default_factory=Rate)
    forwarded_rate: Rate = field(default_factory=Rate)
    _logged: tuple[str, float] = ("", -math.inf)
    _counters: tuple[Any, Any, Any, Any] = field(init=False)

    def __post_init__(self) -> None:
        self._counters = tuple(
            metric.labels(self.name) for metric in (RECEIVED, FORWARDED, CONFLATED, ERRORS)
        )  # type: ignore[assignment]  # four of them

    def count_received(self, now_s: float) -> None:
        """Count a message, a change or a request."""
        self.received += 1
        self.received_rate.count(now_s)
        self._counters[0].inc()

    def count_forwarded(self, now_s: float, value: Any) -> None:
        """Count a message that the other side has accepted; `value` is displayed as the last one."""
        self.forwarded += 1
        self.forwarded_rate.count(now_s)
        self.last_value = value
        self._counters[1].inc()

    @property
    def dropped(self) -> int:
        """The number of dropped messages."""
        return sum(self.dropped_by_cause.values())

    def count_dropped(self, cause: str, number: int = 1) -> None:
        """Count messages that were lost against the mapping."""
        if number:
            self.dropped_by_cause[cause] = self.dropped_by_cause.get(cause, 0) + number
            DROPPED.labels(self.name, cause).inc(number)

    def count_conflated(self, number: int) -> None:
        """Count messages that newer ones replaced, as the mapping asks."""
        if number:
            self.conflated += number
            self._counters[2].inc(number)

    def record_error(self, why: str, now_s: float) -> None:
        """Count a message that could not be forwarded; a repeated reason is logged at intervals."""
        self.errors += 1
        self._counters[3].inc()
        self.last_error = why[:MAX_SHOWN_CHARACTERS]
        self.last_error_at = iso(datetime.now(UTC), "milliseconds")
        kind, logged_at_s = self._logged
        if now_s - logged_at_s >= LOG_INTERVAL_S or kind != why[:60]:
            self._logged = (why[:60], now_s)
            log.warning("forwarding failed", rule=self.name, reason=why[:MAX_SHOWN_CHARACTERS])

    def view(self, now_s: float) -> Mapping[str, Any]:
        """Return the statistics as JSON."""
        return {
            "name": self.name,
            "section": self.section,
            "enabled": self.enabled,
            "received": self.received,
            "receivedPerS": round(self.received_rate.per_s(now_s), 2),
            "forwarded": self.forwarded,
            "forwardedPerS": round(self.forwarded_rate.per_s(now_s), 2),
            "dropped": self.dropped,
            "droppedByCause": dict(self.dropped_by_cause),
            "conflated": self.conflated,
            "errors": self.errors,
            "lastValue": _shown(self.last_value),
            "lastError": self.last_error,
            "lastErrorAt": self.last_error_at,
        }


def _shown(value: Any) -> Any:
    """Return `value`; of a long one its beginning."""
    written = orjson.dumps(value, option=orjson.OPT_NON_STR_KEYS, default=str)
    if len(written) <= MAX_VALUE_BYTES:
        return value
    return f"{written[:MAX_SHOWN_CHARACTERS].decode(errors='ignore')}… ({len(written)} bytes)"


REPORT_INTERVAL_S = 10.0
"""Minimum time between two writes of one Alert."""
CAUSES: Mapping[str, str] = {
    "reader_overflow": "came faster than the bridge read them; raise `buffer: {keep: …}` or `qos: "
    "{depth: …}`, or thin them out with `every_ms`",
    "unreadable": "could not be read or were too large ({why}); name the robot's definition in type_paths, "
    "or raise HANDOVER_ROS_MAX_MESSAGE_BYTES",
    "broker_away": "were replaced by newer ones while the broker was unavailable; raise `buffer: {keep: …}`",
    "broker_slow": "were replaced by newer ones because the broker accepts them too slowly; raise "
    "`buffer: {keep: …}`, thin them out with `every_ms`, or give the broker more resources",
    "refused": "were refused by the broker ({why}); change the rule or the entity",
    "queue_full": "were replaced by newer ones while a slow call was pending; check the service",
}


@dataclass(slots=True)
class _Report:
    number: int
    at_s: float


class DropReporter:
    """Publishes an Alert for each rule and cause with drops: `publish(rule, key, description)`."""

    def __init__(self, stats: Iterable[RuleStats], publish: Callable[[str, str, str], None]) -> None:
        self._stats = tuple(stats)
        self._publish = publish
        self._reported: dict[tuple[str, str], _Report] = {}

    def report(self, now_s: float) -> None:
        """Publish the Alerts for drops since the last call."""
        for stats in self._stats:
            for cause, number in stats.dropped_by_cause.items():
                key = stats.name, cause
                reported_s = self._reported.get(key)
                if reported_s is not None and (
                    number == reported_s.number or now_s - reported_s.at_s < REPORT_INTERVAL_S
                ):
                    continue
                self._reported[key] = _Report(number, now_s)
                words = CAUSES[cause].replace("{why}", stats.last_error or "see the log")
                self._publish(stats.name, f"dropped {cause}", f"{stats.name}: {number} messages {words}")
