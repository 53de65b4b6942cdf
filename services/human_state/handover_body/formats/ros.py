"""Samples and features as messages of the ROS 2 package `handover_human_msgs`, and back.

A message is a dictionary, as the bridge's graph and its type store take them; this module needs neither ROS
nor the bridge. A waveform becomes one message with all samples, and a value that a device computes becomes
one message a sample, in the unit that its field names. Signals in other units, and those without a message of
their own, become an `OtherSignal`.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from handover_body.formats.errors import ExchangeError
from handover_body.formats.ros_tables import (
    BY_CHANNEL,
    CLOCK_OF,
    CLOCKS,
    CONTACT,
    CONTACT_OF,
    DURATION,
    EYE_OF,
    EYES,
    GAZE,
    INTERVALS,
    KIND_OF,
    OF_MOVEMENTS,
    SCALARS,
    SERIES,
    STATUS_OF,
    TYPED,
    UNKNOWN_FIELDS,
    VALIDITY,
)
from handover_body.model.features import UNITS, Feature, FeatureName, Status
from handover_body.model.signals import ClockKind, Samples, SensorReport, SignalInfo, SignalKind

PACKAGE: Final = "handover_human_msgs/msg/"
Message = dict[str, Any]


def messages_of(samples: Samples, subject: str = "") -> list[tuple[str, Message]]:
    """Return type and message of `samples`, oldest first; `subject` is the pseudonym of the person."""
    kind, info = samples.info.kind, samples.info
    if kind in SERIES:
        return [(PACKAGE + SERIES[kind], _series(samples, subject))]
    if kind in SCALARS and len(info.channels) == 1 and info.unit == SCALARS[kind][2]:
        name, field, _ = SCALARS[kind]
        return [
            (PACKAGE + name, {**_head(samples, subject, at_s), field: float(value)})
            for at_s, value in zip(samples.sample_times_s(), samples.values[:, 0], strict=True)
        ]
    if kind in BY_CHANNEL and set(info.channels) <= set(BY_CHANNEL[kind][1]):
        name, fields = BY_CHANNEL[kind]
        unknown = dict.fromkeys(fields, math.nan)
        return [
            (
                PACKAGE + name,
                {
                    **_head(samples, subject, at_s),
                    **unknown,
                    **dict(zip(info.channels, row.tolist(), strict=True)),
                },
            )
            for at_s, row in zip(samples.sample_times_s(), samples.values, strict=True)
        ]
    if kind is SignalKind.INTER_BEAT_INTERVAL and len(info.channels) == 1 and info.unit in INTERVALS:
        message = _head(samples, subject, samples.end_s)
        message["intervals_s"] = samples.values[:, 0] * INTERVALS[info.unit]
        message["times_s"] = np.array(samples.sample_times_s(), np.float64)
        return [(PACKAGE + "InterBeatIntervals", message)]
    if kind is SignalKind.PRESSURE_MAP or (kind in EYES and info.channels in _eye_channels(kind)):
        name, made = ("EyeEvent", _eye_event) if kind in EYES else ("PressureMap", _pressures)
        return [
            (PACKAGE + name, made(samples, subject, at_s, row))
            for at_s, row in zip(samples.sample_times_s(), samples.values, strict=True)
        ]
    return [(PACKAGE + "OtherSignal", {**_series(samples, subject), "kind": kind.value})]


def samples_of(type_name: str, message: Mapping[str, Any]) -> Samples:
    """Return the samples of a message of a signal. Raises `ExchangeError` for other and faulty messages."""
    name = type_name.removeprefix(PACKAGE)
    try:
        if name == "OtherSignal":
            return _from_series(SignalKind(message["kind"]), message)
        kind = KIND_OF.get(name)
        if kind is not None and kind in SERIES:
            return _from_series(kind, message)
        if kind is not None:
            field = SCALARS[kind][1]
            return _single(kind, message, [message[field]], ("",))
        if name in ("InterBeatIntervals", "EyeEvent"):
            return _intervals(message) if name == "InterBeatIntervals" else _from_eye_event(message)
        for of_kind, (of_name, fields) in BY_CHANNEL.items():
            if name == of_name:
                channels = tuple(field for field in fields if not math.isnan(message[field])) or fields[:1]
                return _single(of_kind, message, [message[field] for field in channels], channels)
        if name == "PressureMap":
            cells = tuple(message["cells"]) or tuple(f"cell{n}" for n in range(len(message["pressures"])))
            return _single(SignalKind.PRESSURE_MAP, message, message["pressures"], cells)
    except (KeyError, TypeError, ValueError) as error:
        raise ExchangeError(f"a message of {type_name} cannot be read: {error}") from None
    raise ExchangeError(f"{type_name} is no signal; use feature_of, or another type of {PACKAGE[:-1]}")


def feature_message(feature: Feature, subject: str = "") -> tuple[str, Message]:
    """Return type and message of any feature."""
    is_text = isinstance(feature.value, str)
    return PACKAGE + "Feature", {
        **_feature_head(feature, subject),
        "name": feature.name.value,
        "is_text": is_text,
        "value": math.nan if is_text else float(feature.value),
        "text": feature.value if is_text else "",
        "window_s": feature.window_s,
        "period_s": feature.period_s,
    }


def typed_message(feature: Feature, subject: str = "") -> tuple[str, Message] | None:
    """Return the message of its own that a feature has, such as `HeartRate`; None if it has none."""
    if feature.name not in TYPED:
        return None
    name, field = TYPED[feature.name]
    message = _feature_head(feature, subject) | dict.fromkeys(UNKNOWN_FIELDS.get(name, ()), math.nan)
    message[field] = feature.value
    if name == "HeartRateVariability":
        message["window_s"] = feature.window_s
    return PACKAGE + name, message


def feature_of(message: Mapping[str, Any]) -> Feature:
    """Return the feature of a message of the type `Feature`. Raises `ExchangeError`."""
    try:
        info = message["info"]
        return Feature(
            name=FeatureName(message["name"]),
            source=info["source"],
            value=message["text"] if message["is_text"] else float(message["value"]),
            at_s=_seconds(message["header"]["stamp"]),
            quality=_fraction(info["quality"]),
            status=STATUS_OF.get(info["validity"], Status.IMPLAUSIBLE),
            method=info["method"],
            window_s=float(message["window_s"]),
            period_s=float(message["period_s"]),
            is_calibrated=bool(info["calibrated"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ExchangeError(f"a Feature message cannot be read: {error}") from None


def state_message(features: Sequence[Feature], subject: str, at_s: float) -> tuple[str, Message]:
    """Return the message of all fused values of a person."""
    return PACKAGE + "HumanState", {
        "header": {"stamp": _stamp(at_s), "frame_id": ""},
        "subject": subject,
        "features": [feature_message(feature, subject)[1] for feature in features],
    }


def fault_message(report: SensorReport, subject: str = "") -> tuple[str, Message] | None:
    """Return the message of a fault of a sensor; None if the report has none."""
    if report.fault is None:
        return None
    return PACKAGE + "SensorFault", {
        "header": {"stamp": _stamp(report.at_s), "frame_id": ""},
        "source": report.source,
        "subject": subject,
        "fault": report.fault.value,
        "text": report.text,
        "detail_names": list(report.details),
        "detail_values": np.array(list(report.details.values()), np.float64),
    }


def marker_message(name: str, text: str, at_s: float, subject: str = "") -> tuple[str, Message]:
    """Return the message of an event: a Task, a gesture, a note."""
    header = {"stamp": _stamp(at_s), "frame_id": ""}
    return PACKAGE + "Marker", {"header": header, "subject": subject, "name": name, "text": text}


def _head(samples: Samples, subject: str, at_s: float) -> Message:
    info = samples.info
    return {
        "header": {"stamp": _stamp(float(at_s)), "frame_id": ""},
        "info": {
            "subject": subject,
            "source": samples.source,
            "method": info.method,
            "unit": info.unit,
            "sampling_rate_hz": info.rate_hz or 0.0,
            "resolution": info.resolution or 0.0,
            "min_value": info.min_value,
            "max_value": info.max_value,
            "quality": samples.quality,
            "validity": 0,
            "clock": CLOCKS[samples.clock],
            "clock_uncertainty_s": samples.uncertainty_s,
            "contact": CONTACT[samples.has_contact],
            "calibrated": True,
        },
    }


def _feature_head(feature: Feature, subject: str) -> Message:
    return {
        "header": {"stamp": _stamp(feature.at_s), "frame_id": ""},
        "info": {
            "subject": subject,
            "source": feature.source,
            "method": feature.method,
            "unit": UNITS.get(feature.name, ""),
            "sampling_rate_hz": 0.0,
            "resolution": 0.0,
            "min_value": -math.inf,
            "max_value": math.inf,
            "quality": feature.quality,
            "validity": VALIDITY[feature.status],
            "clock": 0,
            "clock_uncertainty_s": 0.0,
            "contact": 0,
            "calibrated": feature.is_calibrated,
        },
    }


def _series(samples: Samples, subject: str) -> Message:
    times_s = np.empty(0) if samples.times_s is None else samples.times_s
    return {
        **_head(samples, subject, samples.end_s),
        "samples": {
            "channels": list(samples.info.channels),
            "values": np.ascontiguousarray(samples.values, np.float64).reshape(-1),
            "start_s": samples.start_s,
            "times_s": np.array(times_s, np.float64),
        },
    }


def _pressures(samples: Samples, subject: str, at_s: float, row: Any) -> Message:
    return {
        **_head(samples, subject, at_s),
        "rows": 0,
        "columns": 0,
        "cells": list(samples.info.channels),
        "pressures": np.array(row, np.float64),
        "centre_x_mm": math.nan,
        "centre_y_mm": math.nan,
        "load": math.nan,
    }


def _eye_channels(kind: SignalKind) -> tuple[tuple[str, ...], ...]:
    """Return the channels that an `EyeEvent` can carry: a gaze lasts no time, events have a duration."""
    if kind is SignalKind.GAZE:
        return (GAZE,)
    rest = ((), OF_MOVEMENTS[:1], OF_MOVEMENTS[1:], OF_MOVEMENTS)
    return tuple(DURATION + gaze + of for gaze in ((), GAZE) for of in rest)


def _eye_event(samples: Samples, subject: str, at_s: float, row: Any) -> Message:
    fields = dict(zip(samples.info.channels, row.tolist(), strict=True))
    return {
        **_head(samples, subject, at_s),
        "kind": EYES[samples.info.kind],
        **{name: fields.get(name, math.nan) for name in DURATION + OF_MOVEMENTS},
        "gaze": np.array([fields[name] for name in GAZE if name in fields], np.float64),
    }


def _from_eye_event(message: Mapping[str, Any]) -> Samples:
    kind = EYE_OF.get(message["kind"])
    if kind is None:
        raise ValueError(f"{message['kind']} is no kind of eye event")
    gaze = dict(zip(GAZE, map(float, message["gaze"]), strict=False))
    if len(message["gaze"]) not in (0, 2):
        raise ValueError(f"a gaze has two values, not {len(message['gaze'])}")
    if kind is SignalKind.GAZE:
        return _single(kind, message, list(gaze.values()), GAZE)
    of_movements = {name: message[name] for name in OF_MOVEMENTS if not math.isnan(message[name])}
    fields = {**{name: message[name] for name in DURATION}, **gaze, **of_movements}
    return _single(kind, message, list(fields.values()), tuple(fields))


def _from_series(kind: SignalKind, message: Mapping[str, Any]) -> Samples:
    series = message["samples"]
    channels = tuple(series["channels"])
    values = np.asarray(series["values"], np.float64)
    times_s = np.asarray(series["times_s"], np.float64)
    if not channels or len(values) % len(channels):
        raise ValueError(f"{len(values)} values are no rows of {len(channels)} channels")
    rows = values.reshape(-1, len(channels))
    if len(times_s) not in (0, len(rows)):
        raise ValueError(f"there are {len(times_s)} times for {len(rows)} samples")
    info = _signal_info(kind, message, channels, message["info"]["method"])
    irregular = len(times_s) > 0 or info.rate_hz is None
    return _samples(info, message, float(series["start_s"]), rows, times_s if irregular else None)


def _intervals(message: Mapping[str, Any]) -> Samples:
    values = np.asarray(message["intervals_s"], np.float64).reshape(-1, 1)
    times_s = np.asarray(message["times_s"], np.float64)
    if len(values) != len(times_s):
        raise ValueError(f"there are {len(times_s)} times for {len(values)} intervals")
    info = _signal_info(SignalKind.INTER_BEAT_INTERVAL, message, ("",), message["info"]["method"], "SEC")
    start_s = float(times_s[0]) if len(times_s) else _seconds(message["header"]["stamp"])
    return _samples(info, message, start_s, values, times_s)


def _single(kind: SignalKind, message: Mapping[str, Any], row: Any, channels: tuple[str, ...]) -> Samples:
    values = np.asarray(row, np.float64).reshape(1, -1)
    if values.shape[1] != len(channels):
        raise ValueError(f"there are {values.shape[1]} values for {len(channels)} channels")
    info = _signal_info(kind, message, channels, message["info"]["method"])
    at_s = _seconds(message["header"]["stamp"])
    return _samples(info, message, at_s, values, None if info.rate_hz else np.array([at_s]))


def _signal_info(
    kind: SignalKind,
    message: Mapping[str, Any],
    channels: tuple[str, ...],
    method: str,
    unit: str | None = None,
) -> SignalInfo:
    info = message["info"]
    is_scaled = unit is not None and unit != info["unit"]
    factor = INTERVALS.get(info["unit"], 1.0) if is_scaled else 1.0
    return SignalInfo(
        kind=kind,
        unit=info["unit"] if unit is None else unit,
        rate_hz=float(info["sampling_rate_hz"]) or None,
        channels=channels,
        min_value=float(info["min_value"]) * factor,
        max_value=float(info["max_value"]) * factor,
        resolution=float(info["resolution"]) * factor or None,
        method=method,
    )


def _samples(
    info: SignalInfo, message: Mapping[str, Any], start_s: float, values: Any, times_s: Any
) -> Samples:
    head = message["info"]
    return Samples(
        source=head["source"],
        info=info,
        start_s=start_s,
        values=values,
        times_s=times_s,
        clock=CLOCK_OF.get(head["clock"], ClockKind.ARRIVAL),
        uncertainty_s=float(head["clock_uncertainty_s"]),
        quality=_fraction(head["quality"]),
        has_contact=CONTACT_OF.get(head["contact"]),
    )


def _fraction(quality: Any) -> float:
    """Return the quality; what is no number from 0 to 1 counts as the worst."""
    value = float(quality)
    return value if 0 <= value <= 1 else 0.0


def _stamp(at_s: float) -> dict[str, int]:
    nanoseconds = round(at_s * 1_000_000_000)
    return {"sec": nanoseconds // 1_000_000_000, "nanosec": nanoseconds % 1_000_000_000}


def _seconds(stamp: Mapping[str, Any]) -> float:
    return float(stamp["sec"]) + float(stamp["nanosec"]) * 1e-9
