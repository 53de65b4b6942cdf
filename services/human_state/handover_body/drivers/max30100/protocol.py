"""The datagrams of the M5StickC: one JSON object with what was measured.

    {"id": "m5-1", "seq": 17, "ms": 123456, "ir": 51234, "red": 49872, "hr": 71.5, "spo2": 97, "battery": 0.8}

`ms` is the time since the stick was switched on. Each field may be absent; 0 in `hr` and `spo2` means that
nothing was measured yet. `heart_rate`, `heartRate` and `SpO2` are read, too.
"""

import json
import math
from dataclasses import dataclass
from typing import Any, Final

from handover_body.drivers.base import PacketError

MAX_BYTES: Final = 2048
FINGER_COUNTS: Final = 5_000
"""Less infrared light than this comes back only when there is no finger."""


@dataclass(frozen=True, slots=True)
class PulseReading:
    """One datagram. None: not in it, or not measured."""

    device_id: str | None = None
    sequence: int | None = None
    device_s: float | None = None
    infrared: float | None = None
    red: float | None = None
    heart_rate_bpm: float | None = None
    spo2_percent: float | None = None
    battery: float | None = None

    @property
    def has_contact(self) -> bool | None:
        """Return whether a finger is on the sensor; None without infrared."""
        return None if self.infrared is None else self.infrared >= FINGER_COUNTS


def parse(data: bytes) -> PulseReading:
    """Return the reading; raise `PacketError` for what is no object with numbers in range."""
    if len(data) > MAX_BYTES:
        raise PacketError(f"a datagram of {len(data)} bytes; at most {MAX_BYTES} are read")
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        raise PacketError("the datagram is no JSON") from None
    if not isinstance(content, dict):
        raise PacketError("the datagram is no JSON object")
    device_id = content.get("id")
    sequence, ms = _number(content, ("seq",), 0, 2**53), _number(content, ("ms",), 0, 2**53)
    return PulseReading(
        device_id=device_id[:64] if isinstance(device_id, str) else None,
        sequence=None if sequence is None else int(sequence),
        device_s=None if ms is None else ms / 1000,
        infrared=_number(content, ("ir",), 0, 65_535),
        red=_number(content, ("red",), 0, 65_535),
        heart_rate_bpm=_number(content, ("hr", "heart_rate", "heartRate"), 0, 1000) or None,
        spo2_percent=_number(content, ("spo2", "SpO2"), 0, 100) or None,
        battery=_number(content, ("battery",), 0, 1),
    )


def _number(content: dict[str, Any], names: tuple[str, ...], lower: float, upper: float) -> float | None:
    value = next((content[name] for name in names if name in content), None)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise PacketError(f"{names[0]} is no number")
    if not (math.isfinite(value) if isinstance(value, float) else True) or not lower <= value <= upper:
        raise PacketError(f"{names[0]} is not in {lower:g} to {upper:g}")
    return float(value)
