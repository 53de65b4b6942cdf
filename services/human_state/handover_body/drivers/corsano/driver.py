"""The bracelet writes a record a second (or as its plan says) into a file, which is read as it grows."""

import asyncio
from collections.abc import Iterator
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np
from pydantic import Field

from handover_body.drivers.base import DriverSettings, Sink, now_s
from handover_body.drivers.bluetooth import BluetoothDriver, BluetoothSettings
from handover_body.drivers.corsano.protocol import (
    ANSWER,
    FILE,
    RECORD_BYTES,
    SERVICE,
    WRITE,
    ActivityRecord,
    RecordStream,
    parse_size,
    size_command,
    stream_command,
)
from handover_body.model.signals import ClockKind, Samples, SensorReport, SignalInfo, SignalKind

if TYPE_CHECKING:
    from bleak import BleakClient

HEART_RATE: Final = SignalInfo(SignalKind.HEART_RATE, "BPM", None, ("",), 0, 254, 1.0, "PPG at the wrist")
SPO2: Final = SignalInfo(SignalKind.SPO2, "P1", None, ("",), 0, 101, 1.0, "PPG at the wrist")
BREATHING: Final = SignalInfo(SignalKind.BREATHING_RATE, "C94", None, ("",), 0, 63, 0.25, "PPG at the wrist")
TEMPERATURE: Final = SignalInfo(SignalKind.SKIN_TEMPERATURE, "CEL", None, ("",), 0, 60, 0.01, "wrist")
STEPS: Final = SignalInfo(SignalKind.STEPS, "C62", None, ("",), -1, 65_536, 1.0, "wrist, steps of the period")
MAX_OLD_RECORDS: Final = 10
"""Records that were written before the connection are history; only the newest are read."""


class CorsanoSettings(BluetoothSettings):
    """How often the file is asked for its size."""

    poll_s: float = Field(1.0, gt=0, le=60)


class CorsanoDriver(BluetoothDriver):
    """One bracelet. Its SpO2 is that of the vendor's algorithm and labelled uncalibrated downstream."""

    settings_model: ClassVar[type[DriverSettings]] = CorsanoSettings
    service_uuid = SERVICE
    max_latency_s = 2.0  # times have a resolution of 1 s, and records wait until the file is read
    max_silence_s = 60.0

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        return (HEART_RATE, SPO2, BREATHING, TEMPERATURE, STEPS)

    async def serve(self, client: "BleakClient", sink: Sink) -> None:
        stream, sizes = RecordStream(), asyncio.Queue[int]()

        def take_answer(data: bytes) -> None:
            if (size := parse_size(data)) is not None:
                sizes.put_nowait(size)

        def take_file(data: bytes) -> None:
            for record in stream.feed(data):
                for item in self._items(record):
                    sink(item)

        await self.subscribe(client, ANSWER, take_answer, sink)
        await self.subscribe(client, FILE, take_file, sink)
        read: int | None = None
        while True:
            await client.write_gatt_char(WRITE, size_command())
            size = await sizes.get()
            if read is None or read > size:  # at first, or the file was erased
                read = max(0, size - size % RECORD_BYTES - MAX_OLD_RECORDS * RECORD_BYTES)
            if size > read:
                await client.write_gatt_char(WRITE, stream_command(read, size - read))
                read = size
            await asyncio.sleep(self.settings.poll_s)

    def _items(self, record: ActivityRecord) -> Iterator[Samples | SensorReport]:
        yield SensorReport(self.source, now_s(), battery=record.battery, has_contact=record.is_worn)
        for info, value, quality in (
            (HEART_RATE, record.heart_rate_bpm, record.heart_rate_quality),
            (SPO2, record.spo2_percent, record.spo2_quality),
            (BREATHING, record.breathing_rate, record.breathing_quality),
            (TEMPERATURE, record.skin_temperature_c, 1.0),
            (STEPS, record.steps, 1.0),
        ):
            if value is not None:
                yield Samples(
                    self.source,
                    info,
                    float(record.device_s),
                    np.array([[float(value)]]),
                    np.array([float(record.device_s)]),
                    ClockKind.DEVICE,
                    0.5,
                    quality,
                    record.is_worn,
                )
