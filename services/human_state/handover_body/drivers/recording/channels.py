"""What a channel of a file is: its kind by its name, its unit, and at which rates such a signal is recorded.

Nothing is guessed by a factor: a name or a unit that is not clear leaves its channel out, with the reason.
"""

import re
from dataclasses import dataclass
from typing import Final

from handover.errors import UsageError
from handover.messages import message
from handover_body.model.signals import SignalKind


class RecordingError(UsageError):
    """A recording that cannot be replayed; the text names the file, the rule and the way out."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A channel of a file that is no track, and why."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a channel of a file is: its kind, and its unit where the file does not say or is wrong."""

    kind: SignalKind
    unit: str | None = None


_EXACT_UNITS: Final = {
    "S": ("D80", 1e6), "mS": ("D80", 1e3), "uS": ("D80", 1.0), "µS": ("D80", 1.0), "μS": ("D80", 1.0),
    "nS": ("D80", 1e-3), "s": ("SEC", 1.0), "ms": ("C26", 1.0), "us": ("C26", 1e-3), "µs": ("C26", 1e-3),
    "μs": ("C26", 1e-3), "g": ("MSK", 9.80665), "mg": ("MSK", 9.80665e-3),
}  # fmt: skip
"""Units in which a capital letter is another unit: siemens and seconds."""
_UNITS: Final = {
    "v": ("D82", 1e6), "mv": ("D82", 1e3), "uv": ("D82", 1.0), "µv": ("D82", 1.0), "μv": ("D82", 1.0),
    "microvolts": ("D82", 1.0), "microvolt": ("D82", 1.0), "millivolts": ("D82", 1e3),
    "nv": ("D82", 1e-3), "bpm": ("BPM", 1.0), "beats/min": ("BPM", 1.0), "microsiemens": ("D80", 1.0),
    "sec": ("SEC", 1.0), "%": ("P1", 1.0), "m/s2": ("MSK", 1.0), "m/s^2": ("MSK", 1.0), "m/s²": ("MSK", 1.0),
    "degc": ("CEL", 1.0), "°c": ("CEL", 1.0), "1/min": ("C94", 1.0), "breaths/min": ("C94", 1.0),
    "cm": ("CMT", 1.0),
}  # fmt: skip
"""Units as files write them: the code of UN/CEFACT Recommendation 20, and the factor."""
CODES: Final = frozenset({"C62", *(code for code, _ in (*_UNITS.values(), *_EXACT_UNITS.values()))})
_NO_UNIT: Final = frozenset({"", "nu", "n/a", "a.u.", "au", "-", "1"})

_LEAD: Final = re.compile(
    r"(lead)?(d?i{1,3}|av[rlf]|m?l(i{1,3}|\d)|m?v\d?|v\dr|v[7-9]|mcl\d?|v[xyz]|c[cmbrs]\d|d[1-4]|modv\d)\+?"
)
"""Leads of an ECG: of the limbs, the chest, monitors and exercise tests (MLII, MCL1, CM5), and of Frank."""
_KINDS: Final = {
    "ecg": SignalKind.ECG, "ekg": SignalKind.ECG,
    "pleth": SignalKind.PPG, "ppg": SignalKind.PPG, "bvp": SignalKind.PPG, "resp": SignalKind.RESPIRATION,
    "rsp": SignalKind.RESPIRATION, "emg": SignalKind.EMG, "eda": SignalKind.EDA, "gsr": SignalKind.EDA,
    "eeg": SignalKind.EEG, "eog": SignalKind.EOG, "acc": SignalKind.ACCELERATION,
    "accelerometer": SignalKind.ACCELERATION, "spo2": SignalKind.SPO2, "hr": SignalKind.HEART_RATE,
    "rr": SignalKind.INTER_BEAT_INTERVAL, "temp": SignalKind.SKIN_TEMPERATURE,
    **{kind.value.lower(): kind for kind in SignalKind},
}  # fmt: skip
_PLACES: Final = frozenset(
    {
        "x", "y", "z", "i", "ii", "iii", "left", "right", "chest", "thorax", "thoracic", "nasal",
        "airflow", "wrist", "finger", "ear", "raw", "signal", "lead", "channel", "ch", "rest", "skin",
        "abdominal", "belt", "filtered", "r", "l", "red", "ir", "green", "impedance",
    }
)  # fmt: skip
"""Words beside a kind that do not change it, as `rate` and `variability` do."""


def kind_of(name: str) -> SignalKind | None:
    """Return what a channel of this name usually is, None if that is not clear."""
    text = name.strip().lower()
    if _LEAD.fullmatch(re.sub(r"[\s._-]", "", text)):
        return SignalKind.ECG
    words = re.findall(r"[^\W\d_]+2?\d*", text)
    if not words:
        return None
    kind = _KINDS.get(words[0]) or _KINDS.get(words[0].rstrip("0123456789"))
    if kind in _WAVES:
        # The electrodes of an EEG and the muscles of an EMG have any name; a rate is another signal.
        return None if _DERIVED.intersection(words[1:]) else kind
    return kind if kind is not None and _PLACES.issuperset(words[1:]) else None


_WAVES: Final = frozenset(
    {
        SignalKind.ECG,
        SignalKind.PPG,
        SignalKind.RESPIRATION,
        SignalKind.EMG,
        SignalKind.EDA,
        SignalKind.EEG,
        SignalKind.EOG,
        SignalKind.ACCELERATION,
    }
)
_DERIVED: Final = frozenset(
    {
        "rate", "rates", "hr", "bpm", "quality", "amplitude", "amp", "peak", "peaks", "hrv",
        "variability", "interval", "index", "status",
    }
)  # fmt: skip
_RATES_HZ: Final = {
    SignalKind.ECG: (10.0, 8000.0),
    SignalKind.EMG: (10.0, 8000.0),
    SignalKind.EEG: (30.0, 20_000.0),
}
_WAVE_RATES_HZ, _VALUE_RATES_HZ = (1.0, 900.0), (1 / 60, 10.0)


def plausible_rates_hz(kind: SignalKind) -> tuple[float, float]:
    """Return the least and the highest rate at which a kind of signal is recorded.

    The highest is less than 1,000 times the least, so times in ms are never plausible as s, and the reverse.
    """
    return _RATES_HZ.get(kind, _WAVE_RATES_HZ if kind in _WAVES else _VALUE_RATES_HZ)


class UnknownUnit(RecordingError):
    """A unit that no code is known for."""


def unit_of(text: str, name: str, kind: SignalKind) -> tuple[str, float]:
    """Return the code of a unit, and what to multiply values with; raise `UnknownUnit`."""
    plain = text.strip()
    if plain in CODES:
        return plain, 1.0
    if kind is SignalKind.EDA and plain in {"us", "µs", "μs"}:  # siemens: no conductance has a time
        return "D80", 1.0
    if plain in _EXACT_UNITS:
        return _EXACT_UNITS[plain]
    small = plain.lower().replace(" ", "")
    if small in _UNITS:
        return _UNITS[small]
    if small in _NO_UNIT:
        return "C62", 1.0
    raise UnknownUnit(
        message(
            "health.channel.unit_unknown",
            'the unit "{unit}" of "{channel}" is not known; name its kind, and its unit as one of {codes}',
            unit=plain,
            channel=name,
            codes=", ".join(sorted(CODES)),
        )
    )


_TIME_UNITS_S: Final = {
    "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0,
    "ms": 1e-3, "msec": 1e-3, "millis": 1e-3, "millisecond": 1e-3, "milliseconds": 1e-3,
    "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "usec": 1e-6, "microseconds": 1e-6,
    "ns": 1e-9, "nanoseconds": 1e-9, "min": 60.0, "minutes": 60.0,
}  # fmt: skip
_TIME_NAMES: Final = frozenset({"time", "times", "t", "timestamp", "timestamps", "elapsed"})


def time_unit_s(cell: str, file: str) -> float | None:
    """Return the unit of a column of times in s, by its header; None if that names none.

    Raises `RecordingError` for a column that is no time, or in a unit that is not known.
    """
    words = re.findall(r"[^\W_]+", cell.lower())
    if not words or not (words[0] in _TIME_NAMES or (len(words) == 1 and words[0] in _TIME_UNITS_S)):
        raise RecordingError(
            f"the first column of {file} is no time; the header must be like `time [s],ecg [mV]`"
        )
    units = [word for word in words if word in _TIME_UNITS_S]
    if len(units) == 1:
        return _TIME_UNITS_S[units[0]]
    if units or "[" in cell or "(" in cell:
        raise RecordingError(
            f'the unit of the times "{cell.strip()}" in {file} is not known; write `time [s]` or `time [ms]`'
        )
    return None
