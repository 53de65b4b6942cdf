"""Polar measurement data (PMD): the ECG and the acceleration of an H10 (documents of the Polar BLE SDK).

A data notification: type (0 ECG, 2 acceleration), the time of its last sample in ns since 2000 as uint64,
frame type, samples. The control point answers `F0 operation type status …`.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover_body.drivers.base import PacketError

PMD_SERVICE: Final = "fb005c80-02e7-f387-1cad-8acd2d8df0c8"
PMD_CONTROL: Final = "fb005c81-02e7-f387-1cad-8acd2d8df0c8"
PMD_DATA: Final = "fb005c82-02e7-f387-1cad-8acd2d8df0c8"
ECG_RATE_HZ: Final = 130.0
GRAVITY: Final = 9.80665
ALREADY_STARTED: Final = 6
_HEADER: Final = struct.Struct("<BQB")
_STATUS: Final = {
    0: "success", 1: "invalid operation code", 2: "invalid measurement type", 3: "not supported",
    4: "invalid length", 5: "invalid parameter", 6: "already started", 7: "invalid resolution",
    8: "invalid sample rate", 9: "invalid range", 10: "invalid MTU", 11: "invalid number of channels",
    12: "invalid state", 13: "the device is charging",
}  # fmt: skip


class Measurement(IntEnum):
    """The measurements that are used."""

    ECG = 0
    ACCELERATION = 2


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One data notification: `values` in microvolt (n, 1) or m/s² (n, 3); `end_s` of the last sample."""

    measurement: Measurement
    end_s: float
    values: NDArray[np.float64]


def parse(data: bytes) -> Frame:
    """Return the frame; raise `PacketError` for what is no whole frame of a known type."""
    if len(data) <= _HEADER.size:
        raise PacketError(f"a frame of {len(data)} bytes has no samples")
    kind, end_ns, frame_type = _HEADER.unpack_from(data)
    body = data[_HEADER.size :]
    if kind == Measurement.ECG and frame_type == 0:
        return Frame(Measurement.ECG, end_ns * 1e-9, _int24(body)[:, None])
    if kind == Measurement.ACCELERATION and frame_type == 1:
        if len(body) % 6:
            raise PacketError("a sample of the acceleration is cut")
        raw = np.frombuffer(body, dtype="<i2").reshape(-1, 3)
        return Frame(Measurement.ACCELERATION, end_ns * 1e-9, raw * (GRAVITY / 1000))
    raise PacketError(f"a frame of type {kind}, {frame_type}, which an H10 does not send")


def start_command(measurement: Measurement, rate_hz: int = 130, range_g: int = 8) -> bytes:
    """Return what starts a measurement: rate, resolution, and for the acceleration the range."""
    if measurement is Measurement.ECG:
        return bytes([2, 0]) + _setting(0, rate_hz) + _setting(1, 14)
    return bytes([2, 2]) + _setting(0, rate_hz) + _setting(1, 16) + _setting(2, range_g)


def check_answer(data: bytes, measurement: Measurement) -> None:
    """Accept the answer to a start command; raise `PacketError` that says why there is no measurement."""
    if len(data) < 4 or data[0] != 0xF0:
        raise PacketError("the control point sent no answer")
    if data[1] == 2 and data[2] == measurement and data[3] not in {0, ALREADY_STARTED}:
        why = _STATUS.get(data[3], f"status {data[3]}")
        raise PacketError(f"the device refuses to measure {measurement.name.lower()}: {why}")


def build(frame: Frame) -> bytes:
    """Return the notification of a frame: what a simulated H10 sends."""
    is_ecg = frame.measurement is Measurement.ECG
    header = _HEADER.pack(frame.measurement, round(frame.end_s * 1e9), 0 if is_ecg else 1)
    if not is_ecg:
        return header + np.round(frame.values * 1000 / GRAVITY).astype("<i2").tobytes()
    return header + b"".join(int(number).to_bytes(3, "little", signed=True) for number in frame.values[:, 0])


def _int24(body: bytes) -> NDArray[np.float64]:
    if len(body) % 3:
        raise PacketError("a sample of the ECG is cut")
    parts = np.frombuffer(body, dtype=np.uint8).reshape(-1, 3).astype(np.int32)
    raw = parts[:, 0] | parts[:, 1] << 8 | parts[:, 2] << 16
    return np.where(raw & 0x800000, raw - 0x1000000, raw).astype(np.float64)


def _setting(kind: int, value: int) -> bytes:
    return struct.pack("<BBH", kind, 1, value)
