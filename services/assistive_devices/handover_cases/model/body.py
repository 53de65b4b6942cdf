"""What a controller knows of the body of a person: values with age, quality and status."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

VALID: Final = "valid"
OF_SENSOR: Final = "@"
MIN_QUALITY: Final = 0.5
FREE_BPM: Final = 90.0
STRAINED_BPM: Final = 125.0
"""The heart rates of ROS4HC between which a machine slows down."""


@dataclass(frozen=True, slots=True)
class Reading:
    """One value; `at_s` is when it was measured, on the monotonic clock of this process."""

    value: float | str
    at_s: float
    quality: float = 1.0
    status: str = VALID
    disagree: bool = False
    is_calibrated: bool = True


@dataclass(frozen=True, slots=True)
class Body:
    """The values of one person by name, as received last. Frozen; a pure controller ages them itself."""

    readings: Mapping[str, Reading] = field(default_factory=dict)

    def number(self, name: str, now_s: float, max_age_s: float) -> float | None:
        """Return a value that may be used: valid, of quality 0.5 at least, not older than `max_age_s`."""
        reading = self.readings.get(name)
        if reading is None or reading.status != VALID or reading.quality < MIN_QUALITY:
            return None
        if now_s - reading.at_s > max_age_s or isinstance(reading.value, str):
            return None
        return None if math.isnan(reading.value) else reading.value

    def text(self, name: str, now_s: float, max_age_s: float) -> str | None:
        """Return a word (posture, position) that may be used."""
        reading = self.readings.get(name)
        if reading is None or reading.status != VALID or now_s - reading.at_s > max_age_s:
            return None
        return reading.value if isinstance(reading.value, str) else None

    def shown(self, now_s: float) -> list[dict[str, Any]]:
        """Return all values for people, with their age."""
        return [
            {
                "name": name,
                "value": reading.value
                if isinstance(reading.value, str) or not math.isnan(reading.value)
                else None,
                "quality": reading.quality,
                "status": reading.status,
                "age_s": max(now_s - reading.at_s, 0.0),
                "is_calibrated": reading.is_calibrated,
            }
            for name, reading in self.readings.items()
            if OF_SENSOR not in name
        ]


def read_body(values: list[Mapping[str, Any]], received_s: float) -> Body:
    """Return the values of a message of human state that arrived at `received_s`.

    A value without a number is implausible. The values of single sensors have names like `movement@radar`.
    """
    readings = {}
    for item in values:
        name = str(item["name"])
        readings[name] = _reading(item, received_s)
        for sensor in item.get("sensors", ()):
            readings[f"{name}{OF_SENSOR}{sensor['sensor']}"] = _reading(sensor, received_s)
    return Body(readings)


def _reading(item: Mapping[str, Any], received_s: float) -> Reading:
    value, age_s = item["value"], float(item["ageS"])
    return Reading(
        float("nan") if value is None else value if isinstance(value, str) else float(value),
        received_s - max(age_s, 0.0),
        float(item["quality"] or 0.0),
        "implausible" if value is None else str(item["status"]),
        bool(item.get("disagree", False)),
        bool(item.get("isCalibrated", True)),
    )
