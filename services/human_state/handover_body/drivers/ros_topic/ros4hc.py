"""The messages of the eye tracker in ROS4HC (`ros2_hc_msgs`): their DDS types, and their `Samples`.

They have no person, unit or quality. A gaze is in pixels of the camera, and so is the velocity of an event;
the quality is 1 while the glasses are worn, 0 otherwise. An event is stamped by its end.
"""

import math
from collections.abc import Mapping
from functools import cache
from typing import Any, Final

import numpy as np

from handover.formats.ros_dds import struct_of
from handover.messages import number_text
from handover_body.formats.errors import ExchangeError
from handover_body.model.signals import ClockKind, Samples, SignalInfo, SignalKind

PACKAGE: Final = "ros2_hc_msgs"
_XYZ: Final = ("x", "y", "z")
_SIDES: Final = ("left", "right")
_EVENT: Final = (("duration", "float64"), ("start_time_ns", "int64"), ("end_time_ns", "int64"))
_MOVEMENT: Final = (
    *_EVENT,
    *(
        (name, "float64")
        for name in (
            "start_gaze_x", "start_gaze_y", "end_gaze_x", "end_gaze_y", "mean_gaze_x", "mean_gaze_y",
            "amplitude_pixels", "amplitude_angle_deg", "mean_velocity", "max_velocity",
        )
    ),
)  # fmt: skip
_GAZE: Final = (
    ("gaze_x", "float64"), ("gaze_y", "float64"), ("worn", "bool"),
    ("pupil_diameter_left", "float64"), ("pupil_diameter_right", "float64"),
    *(
        (f"{what}_{side}_{axis}", "float64")
        for side in _SIDES for what in ("eyeball_center", "optical_axis") for axis in _XYZ
    ),
    *(
        (f"{what}_{side}", "float64")
        for side in _SIDES for what in ("eyelid_angle_top", "eyelid_angle_bottom", "eyelid_aperture")
    ),
)  # fmt: skip
FIELDS: Final[Mapping[SignalKind, tuple[str, tuple[tuple[str, str], ...]]]] = {
    SignalKind.BLINK: ("Blink", _EVENT),
    SignalKind.FIXATION: ("Fixation", _MOVEMENT),
    SignalKind.SACCADE: ("Saccade", _MOVEMENT),
    SignalKind.GAZE: ("PupilGaze", _GAZE),
    SignalKind.EYE_STATE: ("PupilGaze", _GAZE),
}
"""Type and fields after the header, by the signal that is read from them."""
SIGNALS: Final[Mapping[SignalKind, tuple[str, tuple[str, ...]]]] = {
    SignalKind.BLINK: ("SEC", ("duration_s",)),
    SignalKind.FIXATION: ("C62", ("duration_s", "gaze_x", "gaze_y", "amplitude_deg", "peak_velocity")),
    SignalKind.SACCADE: ("C62", ("duration_s", "gaze_x", "gaze_y", "amplitude_deg", "peak_velocity")),
    SignalKind.GAZE: ("C62", ("gaze_x", "gaze_y")),
    SignalKind.EYE_STATE: (
        "MMT", ("pupil_left_mm", "pupil_right_mm", "eyelid_left_mm", "eyelid_right_mm"),
    ),
}  # fmt: skip
"""Unit and channels."""
GAZE: Final = SignalInfo(SignalKind.GAZE, SIGNALS[SignalKind.GAZE][0], None, SIGNALS[SignalKind.GAZE][1])


@cache
def type_of(kind: SignalKind) -> Any:
    """Return the DDS type of the message from which a signal is read."""
    stamp = struct_of("builtin_interfaces/msg/Time", (("sec", "int32"), ("nanosec", "uint32")))
    header = struct_of("std_msgs/msg/Header", (("stamp", stamp), ("frame_id", "str")))
    name, fields = FIELDS[kind]
    return struct_of(f"{PACKAGE}/msg/{name}", (("header", header), *fields))


def samples_of(info: SignalInfo, source: str, message: Mapping[str, Any]) -> Samples:
    """Return the sample in a message. Raises `ExchangeError`."""
    try:
        row, at_s, is_worn = _row(info.kind, message)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ExchangeError(f"a message of {PACKAGE} cannot be read: {error}") from None
    return Samples(
        source,
        info,
        at_s,
        np.array([row], np.float64),
        None if info.rate_hz else np.array([at_s]),
        ClockKind.DEVICE,
        quality=1.0 if is_worn else 0.0,
        has_contact=is_worn if info.kind in (SignalKind.GAZE, SignalKind.EYE_STATE) else None,
    )


def _row(kind: SignalKind, message: Mapping[str, Any]) -> tuple[list[float], float, bool]:
    stamp = message["header"]["stamp"]
    at_s = float(stamp["sec"]) + float(stamp["nanosec"]) * 1e-9
    if kind is SignalKind.GAZE:
        return [float(message["gaze_x"]), float(message["gaze_y"])], at_s, bool(message["worn"])
    if kind is SignalKind.EYE_STATE:
        names = [f"{what}_{side}" for what in ("pupil_diameter", "eyelid_aperture") for side in _SIDES]
        return [float(message[name]) for name in names], at_s, bool(message["worn"])
    duration_s = float(message["duration"])
    if not (math.isfinite(duration_s) and duration_s >= 0):
        raise ValueError(f"a duration of {number_text(duration_s)} s")
    begin_ns, end_ns = int(message["start_time_ns"]), int(message["end_time_ns"])
    if end_ns > begin_ns > 0:
        at_s = end_ns * 1e-9
    if kind is SignalKind.BLINK:
        return [duration_s], at_s, True
    which = "mean_gaze" if kind is SignalKind.FIXATION else "end_gaze"
    names = [f"{which}_x", f"{which}_y", "amplitude_angle_deg", "max_velocity"]
    return [duration_s, *(float(message[name]) for name in names)], at_s, True
