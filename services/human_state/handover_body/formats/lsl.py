"""The description and the clock of a stream of the Lab Streaming Layer."""

import time
from collections.abc import Callable
from typing import Any, Final

from handover_body.formats.errors import ExchangeError
from handover_body.formats.extra import required
from handover_body.model.signals import SignalInfo, SignalKind

CONTENT_TYPES: Final = {
    SignalKind.ECG: "ECG",
    SignalKind.PPG: "PPG",
    SignalKind.EDA: "GSR",
    SignalKind.EMG: "EMG",
    SignalKind.EEG: "EEG",
    SignalKind.EOG: "EOG",
    SignalKind.RESPIRATION: "Respiration",
    SignalKind.ACCELERATION: "Accelerometer",
    SignalKind.ANGULAR_VELOCITY: "Gyroscope",
    SignalKind.MAGNETIC_FIELD: "Magnetometer",
}
"""Content types that LSL recommends; others have the name of the kind."""
_KIND_OF: Final = {name.lower(): kind for kind, name in CONTENT_TYPES.items()} | {
    kind.value.lower(): kind for kind in SignalKind
}
_UNITS: Final = {
    "microvolts": "D82",
    "uv": "D82",
    "microsiemens": "D80",
    "us": "D80",
    "bpm": "BPM",
    "celsius": "CEL",
    "percent": "P1",
    "%": "P1",
    "ms": "C26",
    "s": "SEC",
    "g": "K40",
    "m/s^2": "MSK",
}
"""Codes of UN/CEFACT of the units that streams of others use; a code itself is taken as it is."""


class LslClock:
    """The offset between the clock of LSL and s since 1970, measured once: both run alike on one machine."""

    def __init__(self) -> None:
        local: Callable[[], float] = required("pylsl").local_clock
        before_s = time.time()
        self.offset_s = (before_s + time.time()) / 2 - local()

    def to_lsl(self, at_s: float) -> float:
        """Return a time since 1970 as a time stamp of LSL."""
        return at_s - self.offset_s


def signal_info(info: Any) -> tuple[SignalInfo, str]:
    """Return signal and subject of the full description (`StreamInfo`) of a numeric stream, ours or not.

    Raises `ExchangeError` for a type that is not known and for texts.
    """
    kind = _KIND_OF.get(info.type().lower())
    if kind is None:
        types = ", ".join(
            sorted({*CONTENT_TYPES.values(), *(signal_kind.value for signal_kind in SignalKind)})
        )
        raise ExchangeError(f'the stream "{info.name()}" has the type {info.type()}; known are {types}')
    if info.channel_format() == required("pylsl").cf_string:
        raise ExchangeError(f'the stream "{info.name()}" has texts; it is no signal')
    labels: list[str] = []
    units: list[str] = []
    channel = info.desc().child("channels").child("channel")
    while not channel.empty() and len(labels) < info.channel_count():
        labels.append(channel.child_value("label"))
        units.append(channel.child_value("unit"))
        channel = channel.next_sibling("channel")
    if len(labels) < info.channel_count():
        labels = [str(number) for number in range(info.channel_count())]
    unit = units[0] if units else ""
    signal = SignalInfo(
        kind,
        _UNITS.get(unit.lower(), unit),
        info.nominal_srate() or None,
        ("",) if labels == [kind.value] else tuple(labels),
        method=info.desc().child("acquisition").child_value("method"),
    )
    return signal, info.desc().child("subject").child_value("id")
