"""The DDS types of the messages of signals in `handover_human_msgs`.

The bridge knows all types of the package; these are the ones that carry a signal. The fields are those of
`ros_fiware_bridge/handover_ros/messages/handover_human_msgs/msg`, in their order, which a test checks.
"""

from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from typing import Any, Final

from handover.formats.ros_dds import struct_of
from handover_body.model.signals import GAIT_CHANNELS, SignalKind

PACKAGE: Final = "handover_human_msgs"
OTHER: Final = "OtherSignal"
"""The message of every kind without one of its own; its field `kind` names the kind."""
_SERIES: Final = (("samples", f"{PACKAGE}/msg/Samples"),)
SIGNALS: Final[Mapping[SignalKind, tuple[str, tuple[tuple[str, str], ...]]]] = {
    **{
        kind: (name, _SERIES)
        for kind, name in {
            SignalKind.ECG: "Ecg", SignalKind.PPG: "Ppg", SignalKind.EDA: "Eda", SignalKind.EMG: "Emg",
            SignalKind.EEG: "Eeg", SignalKind.EOG: "Eog", SignalKind.ICG: "Icg", SignalKind.BCG: "Bcg",
            SignalKind.RESPIRATION: "Respiration", SignalKind.ACCELERATION: "Acceleration",
            SignalKind.ANGULAR_VELOCITY: "AngularVelocity", SignalKind.MAGNETIC_FIELD: "MagneticField",
            SignalKind.JOINT_ANGLES: "JointAngles", SignalKind.JOINT_MOMENTS: "JointMoments",
        }.items()
    },
    **{
        kind: (name, ((field, "float64"),))
        for kind, (name, field) in {
            SignalKind.HEART_RATE: ("HeartRate", "rate_bpm"),
            SignalKind.BREATHING_RATE: ("BreathingRate", "rate_per_min"),
            SignalKind.SPO2: ("Spo2", "percent"),
            SignalKind.SKIN_TEMPERATURE: ("SkinTemperature", "celsius"),
            SignalKind.STROKE_VOLUME: ("StrokeVolume", "millilitres"),
            SignalKind.CARDIAC_OUTPUT: ("CardiacOutput", "litres_per_min"),
            SignalKind.DISTANCE: ("Distance", "metres"),
            SignalKind.MOVEMENT: ("Movement", "movement"),
        }.items()
    },
    SignalKind.INTER_BEAT_INTERVAL: (
        "InterBeatIntervals", (("intervals_s", "float64[]"), ("times_s", "float64[]")),
    ),
    SignalKind.PRESSURE_MAP: (
        "PressureMap",
        (("rows", "uint16"), ("columns", "uint16"), ("cells", "str[]"), ("pitch_x_mm", "float64"),
         ("pitch_y_mm", "float64"), ("cells_x_mm", "float64[]"), ("cells_y_mm", "float64[]"),
         ("pressures", "float64[]"), ("centre_x_mm", "float64"), ("centre_y_mm", "float64"),
         ("load", "float64"), ("active_cells", "uint16")),
    ),
    SignalKind.GAIT: ("Gait", tuple((name, "float64") for name in GAIT_CHANNELS)),
    SignalKind.MOOD: (
        "Mood",
        (("mood", "str"), ("valence", "float64"), ("arousal", "float64"), ("self_reported", "bool")),
    ),
    **dict.fromkeys(
        (SignalKind.BLINK, SignalKind.FIXATION, SignalKind.SACCADE, SignalKind.GAZE),
        ("EyeEvent", (("kind", "uint8"), ("duration_s", "float64"), ("gaze", "float64[]"),
                      ("amplitude_deg", "float64"), ("peak_velocity", "float64"))),
    ),
    SignalKind.EYE_STATE: (
        "EyeState",
        tuple((name, "float64") for name in (
            "pupil_left_mm", "pupil_right_mm", "eyelid_left_mm", "eyelid_right_mm", "eyelid_top_left_rad",
            "eyelid_bottom_left_rad", "eyelid_top_right_rad", "eyelid_bottom_right_rad", "eyeball_left_x_mm",
            "eyeball_left_y_mm", "eyeball_left_z_mm", "eyeball_right_x_mm", "eyeball_right_y_mm",
            "eyeball_right_z_mm", "axis_left_x", "axis_left_y", "axis_left_z", "axis_right_x",
            "axis_right_y", "axis_right_z")),
    ),
}  # fmt: skip
"""Type and fields after header and info."""
INFO: Final = (
    ("subject", "str"), ("source", "str"), ("method", "str"), ("unit", "str"), ("sampling_rate_hz", "float64"),
    ("resolution", "float64"), ("min_value", "float64"), ("max_value", "float64"), ("quality", "float64"),
    ("validity", "uint8"), ("clock", "uint8"), ("clock_uncertainty_s", "float64"), ("contact", "uint8"),
    ("calibrated", "bool"),
)  # fmt: skip
SAMPLES: Final = (
    ("channels", "str[]"),
    ("values", "float64[]"),
    ("start_s", "float64"),
    ("times_s", "float64[]"),
)


def fields_of(kind: SignalKind) -> tuple[str, tuple[tuple[str, str], ...]]:
    """Return the name of the message of a signal, and its fields after header and info."""
    return SIGNALS.get(kind) or (OTHER, (("kind", "str"), *_SERIES))


@cache
def type_of(kind: SignalKind) -> Any:
    """Return the DDS type of the message of a signal."""
    stamp = struct_of("builtin_interfaces/msg/Time", (("sec", "int32"), ("nanosec", "uint32")))
    header = struct_of("std_msgs/msg/Header", (("stamp", stamp), ("frame_id", "str")))
    info = struct_of(f"{PACKAGE}/msg/SignalInfo", INFO)
    samples = struct_of(f"{PACKAGE}/msg/Samples", SAMPLES)
    name, fields = fields_of(kind)
    own = [(field, samples if "/" in of else of) for field, of in fields]
    return struct_of(f"{PACKAGE}/msg/{name}", (("header", header), ("info", info), *own))


def as_message(sample: Any) -> dict[str, Any]:
    """Return a received sample as the dictionary that `formats.ros` reads."""
    return asdict(sample)
