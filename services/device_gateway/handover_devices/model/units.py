"""Units of values: codes of UN/CEFACT Recommendation 20, as NGSI-LD's `unitCode` has them.

The table has the codes that devices use most, with the symbols that people read. Other codes are accepted by
their form, since the recommendation has some two thousand.
"""

import re
from collections.abc import Mapping
from typing import Final

SYMBOLS: Final[Mapping[str, str]] = {
    "2A": "rad/s",
    "59": "ppm",
    "A97": "hPa",
    "AMP": "A",
    "BAR": "bar",
    "BPM": "1/min",
    "C26": "ms",
    "C62": "",
    "C81": "rad",
    "C94": "1/min",
    "CEL": "°C",
    "CMT": "cm",
    "DD": "°",
    "GRM": "g",
    "HTZ": "Hz",
    "HUR": "h",
    "JOU": "J",
    "KEL": "K",
    "KGM": "kg",
    "KMH": "km/h",
    "KPA": "kPa",
    "KWH": "kWh",
    "KWT": "kW",
    "LTR": "l",
    "LUX": "lx",
    "MIN": "min",
    "MMT": "mm",
    "MSK": "m/s²",
    "MTK": "m²",
    "MTQ": "m³",
    "MTR": "m",
    "MTS": "m/s",
    "NEW": "N",
    "NU": "N m",
    "OHM": "Ω",
    "P1": "%",
    "PAL": "Pa",
    "RPM": "1/min",
    "SEC": "s",
    "VLT": "V",
    "WTT": "W",
}

_CODE = re.compile(r"[A-Z0-9]{2,3}")


def is_unit_code(code: str) -> bool:
    """Return whether `code` has the form of a code."""
    return _CODE.fullmatch(code) is not None
