"""Samples, features, reports and markers as JSON messages: in MCAP files and on the live stream for Foxglove.

NaN is null. Times are s since 1970.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from handover_body.formats.errors import ExchangeError
from handover_body.model.features import UNITS, Feature, FeatureName, Status
from handover_body.model.signals import (
    ClockKind,
    LinkState,
    Samples,
    SensorFault,
    SensorReport,
    SignalInfo,
    SignalKind,
)


@dataclass(frozen=True, slots=True)
class Marker:
    """An event on the time line of a recording: a Task, a gesture, a note."""

    at_s: float
    name: str
    text: str = ""


Recorded = Samples | Feature | SensorReport | Marker

_NUMBER: Final = {"type": ["number", "null"]}
_TEXT: Final = {"type": "string"}
SCHEMAS: Final[Mapping[str, dict[str, Any]]] = {
    "handover.Samples": {
        "type": "object",
        "properties": {
            "kind": {"type": "string", "enum": [kind.value for kind in SignalKind]},
            "subject": _TEXT,
            "source": _TEXT,
            "unit": _TEXT,
            "rate_hz": _NUMBER,
            "channels": {"type": "array", "items": _TEXT},
            "start_s": {"type": "number"},
            "times_s": {"type": "array", "items": {"type": "number"}},
            "values": {"type": "array", "items": {"type": "array", "items": _NUMBER}},
            "clock": {"type": "string", "enum": [clock.value for clock in ClockKind]},
            "uncertainty_s": {"type": "number"},
            "quality": {"type": "number", "minimum": 0, "maximum": 1},
            "has_contact": {"type": ["boolean", "null"]},
            "method": _TEXT,
            "min_value": _NUMBER,
            "max_value": _NUMBER,
            "resolution": _NUMBER,
        },
        "required": ["kind", "source", "unit", "channels", "start_s", "values"],
    },
    "handover.Feature": {
        "type": "object",
        "properties": {
            "name": {"type": "string", "enum": [name.value for name in FeatureName]},
            "subject": _TEXT,
            "source": _TEXT,
            "value": {"type": ["number", "string", "null"]},
            "unit": _TEXT,
            "at_s": {"type": "number"},
            "quality": {"type": "number", "minimum": 0, "maximum": 1},
            "status": {"type": "string", "enum": [status.value for status in Status]},
            "method": _TEXT,
            "window_s": {"type": "number"},
            "period_s": {"type": "number"},
            "is_calibrated": {"type": "boolean"},
        },
        "required": ["name", "source", "value", "at_s", "quality", "status"],
    },
    "handover.SensorReport": {
        "type": "object",
        "properties": {
            "subject": _TEXT,
            "source": _TEXT,
            "at_s": {"type": "number"},
            "link": {"type": ["string", "null"]},
            "battery": _NUMBER,
            "has_contact": {"type": ["boolean", "null"]},
            "fault": {"type": ["string", "null"]},
            "text": _TEXT,
            "details": {"type": "object", "additionalProperties": _NUMBER},
        },
        "required": ["source", "at_s"],
    },
    "handover.Marker": {
        "type": "object",
        "properties": {"subject": _TEXT, "at_s": {"type": "number"}, "name": _TEXT, "text": _TEXT},
        "required": ["at_s", "name"],
    },
}
"""JSON Schemas by name."""


def schema_name(item: Recorded) -> str:
    """Return the name of the schema of an item."""
    return f"handover.{type(item).__name__}"


def topic_of(item: Recorded) -> str:
    """Return `/signal/SOURCE/KIND`, `/feature/NAME/SOURCE`, `/sensor/SOURCE` or `/marker`."""
    if isinstance(item, Samples):
        return f"/signal/{item.source}/{item.info.kind.value}"
    if isinstance(item, Feature):
        return f"/feature/{item.name.value}/{item.source}"
    return f"/sensor/{item.source}" if isinstance(item, SensorReport) else "/marker"


def time_of(item: Recorded) -> float:
    """Return the time of an item in s since 1970; of samples that of the newest."""
    return item.end_s if isinstance(item, Samples) else item.at_s


def to_json(item: Recorded, subject: str = "") -> dict[str, Any]:
    """Return the message of an item; `subject` is the pseudonym of the person."""
    if isinstance(item, Samples):
        return _samples(item, subject)
    if isinstance(item, Feature):
        return {
            "name": item.name.value,
            "subject": subject,
            "source": item.source,
            "value": item.value if isinstance(item.value, str) else _number(item.value),
            "unit": UNITS.get(item.name, ""),
            "at_s": item.at_s,
            "quality": item.quality,
            "status": item.status.value,
            "method": item.method,
            "window_s": item.window_s,
            "period_s": item.period_s,
            "is_calibrated": item.is_calibrated,
        }
    if isinstance(item, SensorReport):
        return {
            "subject": subject,
            "source": item.source,
            "at_s": item.at_s,
            "link": item.link and item.link.value,
            "battery": None if item.battery is None else _number(item.battery),
            "has_contact": item.has_contact,
            "fault": item.fault and item.fault.value,
            "text": item.text,
            "details": {name: _number(value) for name, value in item.details.items()},
        }
    return {"subject": subject, "at_s": item.at_s, "name": item.name, "text": item.text}


def from_json(name: str, message: Any) -> Recorded:
    """Return the item of a message with the schema `name`. Raises `ExchangeError`."""
    reader = _READERS.get(name)
    if reader is None:
        raise ExchangeError(f"{name} is no schema of ours; known are {', '.join(sorted(_READERS))}")
    if not isinstance(message, Mapping):
        raise ExchangeError(f"a message of {name} is a JSON object, not {type(message).__name__}")
    try:
        return reader(message)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ExchangeError(f"a message of {name} cannot be read: {error!r}") from None


def _samples(item: Samples, subject: str) -> dict[str, Any]:
    info = item.info
    return {
        "kind": info.kind.value,
        "subject": subject,
        "source": item.source,
        "unit": info.unit,
        "rate_hz": info.rate_hz,
        "channels": list(info.channels),
        "start_s": item.start_s,
        **({} if item.times_s is None else {"times_s": item.times_s.tolist()}),
        "values": [[_number(value) for value in row] for row in item.values.tolist()],
        "clock": item.clock.value,
        "uncertainty_s": item.uncertainty_s,
        "quality": item.quality,
        "has_contact": item.has_contact,
        "method": info.method,
        "min_value": _number(info.min_value),
        "max_value": _number(info.max_value),
        "resolution": info.resolution,
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _fraction(value: Any) -> float:
    number = float(value)
    if not 0 <= number <= 1:
        raise ValueError(f"quality {number} is not in 0..1")
    return number


def _time(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{number} is no time")
    return number


def _read_samples(message: Any) -> Samples:
    minimum, maximum = message.get("min_value"), message.get("max_value")
    info = SignalInfo(
        kind=SignalKind(message["kind"]),
        unit=str(message["unit"]),
        rate_hz=message.get("rate_hz"),
        channels=tuple(map(str, message["channels"])),
        min_value=-math.inf if minimum is None else float(minimum),
        max_value=math.inf if maximum is None else float(maximum),
        resolution=message.get("resolution"),
        method=str(message.get("method", "")),
    )
    times = message.get("times_s")
    times_s = None if times is None else np.array(times, np.float64)
    if times_s is not None and not np.all(np.isfinite(times_s)):
        raise ValueError("times_s has values that are no times")
    return Samples(
        source=str(message["source"]),
        info=info,
        start_s=_time(message["start_s"]),
        values=np.array(message["values"], np.float64).reshape(len(message["values"]), len(info.channels)),
        times_s=times_s,
        clock=ClockKind(message.get("clock", ClockKind.RECORDING)),
        uncertainty_s=float(message.get("uncertainty_s", 0.0)),
        quality=_fraction(message.get("quality", 1.0)),
        has_contact=message.get("has_contact"),
    )


def _read_feature(message: Any) -> Feature:
    value = message["value"]
    return Feature(
        name=FeatureName(message["name"]),
        source=str(message["source"]),
        value=value if isinstance(value, str) else math.nan if value is None else float(value),
        at_s=_time(message["at_s"]),
        quality=_fraction(message["quality"]),
        status=Status(message["status"]),
        method=str(message.get("method", "")),
        window_s=float(message.get("window_s", 0.0)),
        period_s=float(message.get("period_s", 1.0)),
        is_calibrated=bool(message.get("is_calibrated", True)),
    )


def _read_report(message: Any) -> SensorReport:
    link, fault, battery = message.get("link"), message.get("fault"), message.get("battery")
    return SensorReport(
        source=str(message["source"]),
        at_s=_time(message["at_s"]),
        link=None if link is None else LinkState(link),
        battery=None if battery is None else float(battery),
        has_contact=message.get("has_contact"),
        fault=None if fault is None else SensorFault(fault),
        text=str(message.get("text", "")),
        details={
            str(name): math.nan if value is None else float(value)
            for name, value in message.get("details", {}).items()
        },
    )


def _read_marker(message: Any) -> Marker:
    return Marker(_time(message["at_s"]), str(message["name"]), str(message.get("text", "")))


_READERS: Final[Mapping[str, Callable[[Any], Recorded]]] = {
    "handover.Samples": _read_samples,
    "handover.Feature": _read_feature,
    "handover.SensorReport": _read_report,
    "handover.Marker": _read_marker,
}
