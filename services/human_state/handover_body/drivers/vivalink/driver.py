"""Vivalink patches as an example of a vendor: heart rate, breathing rate and skin temperature.

The form of the answer is an assumption from the vendor's overview (the reference needs an account); it was
never tried with their service:

    {"data": [{"time": 1700000000000, "hr": 71, "rr": 14, "temperature": 33.1, "leadOn": true}, …]}

`time` is in ms since 1970. What is absent or negative was not measured.
"""

import math
from collections.abc import Iterable
from typing import Any, Final
from urllib.parse import quote

from handover_body.drivers.base import PacketError
from handover_body.drivers.cloud.driver import CloudDriver, CloudValue
from handover_body.model.signals import SignalInfo, SignalKind

HEART_RATE: Final = SignalInfo(SignalKind.HEART_RATE, "BPM", None, ("",), 0, 300, 1.0, "ECG patch")
BREATHING: Final = SignalInfo(SignalKind.BREATHING_RATE, "C94", None, ("",), 0, 100, 1.0, "ECG patch")
TEMPERATURE: Final = SignalInfo(SignalKind.SKIN_TEMPERATURE, "CEL", None, ("",), 0, 60, 0.1, "patch")
FIELDS: Final = {"hr": HEART_RATE, "rr": BREATHING, "temperature": TEMPERATURE}


class VivalinkDriver(CloudDriver):
    """One patch."""

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        return tuple(FIELDS.values())

    def url(self, since_s: float) -> str:
        device = quote(self.settings.device_id, safe="")
        return f"/devices/{device}/vitals?startTime={int(since_s * 1000)}"

    def read(self, content: Any) -> Iterable[CloudValue]:
        rows = content["data"]
        if not isinstance(rows, list):
            raise PacketError("`data` is no list")
        for row in rows:
            at_s = float(row["time"]) / 1000
            if not math.isfinite(at_s):
                raise PacketError("a time that is no number")
            quality = 0.0 if row.get("leadOn") is False else 1.0
            for name, info in FIELDS.items():
                value = row.get(name)
                if isinstance(value, int | float) and not isinstance(value, bool) and value > 0:
                    yield CloudValue(info, at_s, float(value), quality)
