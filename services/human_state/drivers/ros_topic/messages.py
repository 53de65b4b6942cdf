"""The DDS types of the messages that this driver reads, as rosidl names them: final structs, XCDR1.

Only the messages of signals that a person's sensors send are here; the bridge knows all types. The fields
are those of `ros_fiware_bridge/messages/handover_human_msgs/msg`, in their order, which a test checks.
"""

from dataclasses import asdict
from functools import cache
from typing import Any, Final

from services.human_state.model.signals import SignalKind

PACKAGE: Final = "handover_human_msgs"
SERIES: Final = {
    SignalKind.ECG: "Ecg", SignalKind.PPG: "Ppg", SignalKind.EDA: "Eda", SignalKind.EMG: "Emg",
    SignalKind.EEG: "Eeg", SignalKind.EOG: "Eog", SignalKind.BCG: "Bcg", SignalKind.RESPIRATION: "Respiration",
    SignalKind.ACCELERATION: "Acceleration",
}  # fmt: skip
SCALARS: Final = {
    SignalKind.HEART_RATE: ("HeartRate", "rate_bpm"),
    SignalKind.BREATHING_RATE: ("BreathingRate", "rate_per_min"),
    SignalKind.SPO2: ("Spo2", "percent"),
    SignalKind.SKIN_TEMPERATURE: ("SkinTemperature", "celsius"),
}
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


def name_of(kind: SignalKind) -> str | None:
    """Return the name of the message of a signal, None if this driver does not read it."""
    return SERIES.get(kind) or SCALARS.get(kind, (None,))[0]


@cache
def type_of(kind: SignalKind) -> Any:
    """Return the DDS type of the message of a signal."""
    header = _struct(
        "std_msgs::msg::dds_::Header_",
        (("stamp", _struct("builtin_interfaces::msg::dds_::Time_", (("sec", "int32"), ("nanosec", "uint32")))),
         ("frame_id", "str")),
    )  # fmt: skip
    info = _struct(f"{PACKAGE}::msg::dds_::SignalInfo_", INFO)
    fields: tuple[tuple[str, Any], ...] = (("header", header), ("info", info))
    if kind in SERIES:
        fields += (("samples", _struct(f"{PACKAGE}::msg::dds_::Samples_", SAMPLES)),)
    else:
        fields += ((SCALARS[kind][1], "float64"),)
    return _struct(f"{PACKAGE}::msg::dds_::{name_of(kind)}_", fields)


def as_message(sample: Any) -> dict[str, Any]:
    """Return a received sample as the dictionary that `formats.ros` reads."""
    return asdict(sample)


def _struct(type_name: str, fields: tuple[tuple[str, Any], ...]) -> Any:
    from cyclonedds.idl import make_idl_struct  # noqa: PLC0415 - of the extra

    kinds = {name: _kind(kind) for name, kind in fields}
    made = make_idl_struct(type_name.replace("::", "_"), type_name, kinds)
    made.__idl_annotations__["extensibility"] = "final"
    return made


def _kind(kind: Any) -> Any:
    import cyclonedds.idl.types as described  # noqa: PLC0415 - of the extra

    types: Any = described
    if not isinstance(kind, str):
        return kind
    if kind.endswith("[]"):
        return types.sequence[_kind(kind.removesuffix("[]"))]
    return {"str": str, "bool": bool}.get(kind) or getattr(types, kind)
