"""Commands of a Corsano bracelet, and the activity records of its file 2 (developer.corsano.com).

A record has 38 bytes: time of the device in s since 1970, heart rate and its quality, steps, activity, speed,
SpO2, energy, four times the breathing rate, …, wearing state, and a CRC-8. Qualities are 0 (bad) to 4 (good).
"""

import struct
from dataclasses import dataclass
from typing import Final

from handover_body.drivers.base import PacketError

SERVICE: Final = "6e400001-b5a3-f393-e0a9-e50e24dcca3e"
WRITE: Final = "6e400002-b5a3-f393-e0a9-e50e24dcca3e"
FILE: Final = "6e400003-b5a3-f393-e0a9-e50e24dcca3e"
ANSWER: Final = "6e400004-b5a3-f393-e0a9-e50e24dcca3e"
ACTIVITY_FILE: Final = 2
RECORD_BYTES: Final = 38
MAX_BUFFER: Final = 64 * RECORD_BYTES
GET_SIZE: Final = 46
STREAM_FROM: Final = 68
_RECORD: Final = struct.Struct("<IBBHBBBHBBBBBBHBH7xhhxB")
_POLYNOMIAL: Final = 0x07  # 0x107 with its leading bit


@dataclass(frozen=True, slots=True)
class ActivityRecord:
    """One record; None is what the bracelet did not measure (it sends 0)."""

    device_s: int
    heart_rate_bpm: int | None
    heart_rate_quality: float
    steps: int
    spo2_percent: int | None
    spo2_quality: float
    breathing_rate: float | None
    breathing_quality: float
    battery: float | None
    skin_temperature_c: float | None
    is_worn: bool


def crc8(data: bytes) -> int:
    """Return the CRC-8 with the polynomial 0x107, initial value 0xFF, not reflected."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ _POLYNOMIAL if crc & 0x80 else crc << 1) & 0xFF
    return crc


def parse_record(data: bytes) -> ActivityRecord:
    """Return the record; raise `PacketError` if its length or checksum is wrong."""
    if len(data) != RECORD_BYTES:
        raise PacketError(f"an activity record of {len(data)} bytes; it has {RECORD_BYTES}")
    if crc8(data[:-1]) != data[-1]:
        raise PacketError("the checksum of an activity record is wrong")
    (
        at_s, rate, rate_quality, steps, _, _, spo2, _, breath, breath_quality, battery, _, _, spo2_quality,
        _, _, _, _, skin, worn,
    ) = _RECORD.unpack(data[:-1])  # fmt: skip
    return ActivityRecord(
        device_s=at_s,
        heart_rate_bpm=rate or None,
        heart_rate_quality=min(rate_quality, 4) / 4,
        steps=steps,
        spo2_percent=spo2 if 0 < spo2 <= 100 else None,
        spo2_quality=min(spo2_quality, 4) / 4,
        breathing_rate=breath / 4 if breath else None,
        breathing_quality=min(breath_quality, 4) / 4,
        battery=battery / 100 if battery <= 100 else None,
        skin_temperature_c=skin / 100 if skin > 0 else None,
        is_worn=worn == 4,
    )


def build_record(record: ActivityRecord) -> bytes:
    """Return the bytes of a record: what a simulated bracelet sends."""
    data = _RECORD.pack(
        record.device_s, record.heart_rate_bpm or 0, round(record.heart_rate_quality * 4), record.steps, 0, 0,
        record.spo2_percent or 0, 0, round((record.breathing_rate or 0) * 4),
        round(record.breathing_quality * 4), 255 if record.battery is None else round(record.battery * 100),
        record.heart_rate_bpm or 0, 0, round(record.spo2_quality * 4), 0, 0, 0, 0,
        round((record.skin_temperature_c or 0) * 100), 4 if record.is_worn else 0,
    )  # fmt: skip
    return data + bytes([crc8(data)])


class RecordStream:
    """Cuts the bytes of the file into records; after damage it finds the next whole one."""

    def __init__(self) -> None:
        self._buffer = b""
        self.skipped = 0
        """Bytes that belonged to no record."""

    def feed(self, data: bytes) -> list[ActivityRecord]:
        """Take the next bytes; return the records that they complete."""
        records = []
        for first in range(0, len(data), MAX_BUFFER):
            buffer = self._buffer + data[first : first + MAX_BUFFER]
            at = 0
            while len(buffer) - at >= RECORD_BYTES:
                try:
                    records.append(parse_record(buffer[at : at + RECORD_BYTES]))
                    at += RECORD_BYTES
                except PacketError:
                    self.skipped += 1
                    at += 1
            self._buffer = buffer[at:]
        return records


def size_command() -> bytes:
    """Return what asks for the size of the activity file."""
    return bytes([GET_SIZE, ACTIVITY_FILE])


def stream_command(offset: int, size: int) -> bytes:
    """Return what asks for `size` bytes of the activity file from `offset`."""
    return struct.pack("<BBII", STREAM_FROM, ACTIVITY_FILE, size, offset)


def parse_size(data: bytes) -> int | None:
    """Return the size of the activity file from an answer, None for other answers; raise `PacketError`."""
    if len(data) < 2 or crc8(data[:-1]) != data[-1]:
        raise PacketError("the checksum of an answer is wrong")
    if data[0] != GET_SIZE or len(data) < 7 or data[1] != ACTIVITY_FILE:
        return None
    return int.from_bytes(data[2:6], "little")
