"""The radar on a serial port. Its rates come about every 3 s, and are those of the nearest person."""

import asyncio
from typing import ClassVar, Final

import numpy as np
from pydantic import Field

from handover.errors import UsageError
from handover.messages import message
from handover_body.drivers.base import (
    DriverSettings,
    FoundDevice,
    LinkLost,
    PacketError,
    SensorDriver,
    Sink,
    now_s,
)
from handover_body.drivers.seeed_radar.protocol import FrameReader, read
from handover_body.model.signals import ClockKind, LinkState, Samples, SensorReport, SignalInfo, SignalKind

METHOD: Final = "radar 60 GHz"
SIGNALS: Final = {
    "presence": SignalInfo(SignalKind.PRESENCE, "C62", None, ("",), -1, 2, 1.0, METHOD),
    "movement": SignalInfo(SignalKind.MOVEMENT, "C62", None, ("",), -1, 101, 1.0, METHOD),
    "distance": SignalInfo(SignalKind.DISTANCE, "CMT", None, ("",), -1, 1_000, 1.0, METHOD),
    "breathing": SignalInfo(SignalKind.BREATHING_RATE, "C94", None, ("",), 0, 61, 1.0, METHOD),
    "heart": SignalInfo(SignalKind.HEART_RATE, "BPM", None, ("",), 0, 255, 1.0, METHOD),
    "breathingWave": SignalInfo(SignalKind.RESPIRATION, "C62", None, ("",), -129, 128, 1.0, METHOD),
    "heartWave": SignalInfo(SignalKind.BCG, "C62", None, ("",), -129, 128, 1.0, METHOD),
}
WAVE_PERIOD_S: Final = 0.2
"""A wave frame holds the points of a second."""
READ_BYTES: Final = 4096
USB_IDS: Final = ((0x1A86, 0x7523), (0x10C4, 0xEA60), (0x0403, 0x6001))
"""Serial adapters that such modules come with."""


class RadarSettings(DriverSettings):
    """The serial port, such as `/dev/ttyUSB0` or `COM3`."""

    port: str = Field(min_length=1)
    baud: int = 115_200


class RadarDriver(SensorDriver):
    """One radar. It measures no contact: presence says whether there is a person."""

    settings_model: ClassVar[type[DriverSettings]] = RadarSettings
    max_latency_s = 0.5
    silence_limits_s = {SignalKind.HEART_RATE: 6.0, SignalKind.BREATHING_RATE: 6.0}  # noqa: RUF012

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        return tuple(SIGNALS.values())

    async def run(self, sink: Sink) -> None:
        import serial  # noqa: PLC0415 - slow to import

        settings: RadarSettings = self.settings
        try:
            port = serial.serial_for_url(settings.port, settings.baud, timeout=0.2, exclusive=True)
        except (OSError, ValueError) as error:
            raise LinkLost(
                message(
                    "health.sensor.port",
                    "{port} cannot be opened: {error}",
                    port=str(settings.port),
                    error=str(error),
                )
            ) from error
        sink(SensorReport(self.source, now_s(), link=LinkState.CONNECTED))
        reader = FrameReader()
        try:
            while True:
                data = await asyncio.to_thread(_read, port)
                skipped = reader.skipped
                for frame in reader.feed(data):
                    try:
                        reading = read(frame)
                    except PacketError as error:
                        self.reject(sink, error)
                        continue
                    if reading is not None:
                        sink(self._samples(SIGNALS[reading.kind], reading.values))
                if reader.skipped > skipped:
                    self.reject(sink, PacketError(f"{reader.skipped - skipped} bytes belong to no frame"))
        finally:
            port.close()

    def _samples(self, info: SignalInfo, values: tuple[float, ...]) -> Samples:
        times_s = now_s() - WAVE_PERIOD_S * np.arange(len(values) - 1, -1, -1.0)
        column = np.array(values)[:, None]
        return Samples(self.source, info, float(times_s[0]), column, times_s, ClockKind.ARRIVAL, 0.5)

    @classmethod
    async def discover(cls, timeout_s: float) -> list[FoundDevice]:
        """Return the serial ports with an adapter of such modules; nothing is sent to them."""
        try:
            from serial.tools.list_ports import comports  # noqa: PLC0415 - slow to import
        except ImportError as error:  # a platform without a list of ports
            raise UsageError(f"serial ports cannot be listed here: {error}") from error
        ports = await asyncio.to_thread(comports)
        return [
            FoundDevice(port.device, port.description) for port in ports if (port.vid, port.pid) in USB_IDS
        ]


def _read(port: "object") -> bytes:
    import serial  # noqa: PLC0415 - slow to import

    assert isinstance(port, serial.Serial)  # noqa: S101 - for the type
    try:
        return bytes(port.read(max(1, min(port.in_waiting, READ_BYTES))))
    except (OSError, TypeError) as error:  # TypeError: the port was closed meanwhile
        raise LinkLost(f"the serial port failed: {error}") from error
