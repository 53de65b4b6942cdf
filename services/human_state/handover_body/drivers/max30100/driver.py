"""Listens on a UDP port for one stick. Datagrams of others are ignored, and counted in the report."""

import asyncio
from contextlib import suppress
from typing import ClassVar, Final, cast

import numpy as np
from pydantic import Field

from handover_body.drivers.base import (
    DriverSettings,
    FoundDevice,
    LinkLost,
    PacketError,
    SensorDriver,
    Sink,
    now_s,
)
from handover_body.drivers.max30100.protocol import PulseReading, parse
from handover_body.model.signals import (
    ClockKind,
    LinkState,
    Samples,
    SensorReport,
    SignalInfo,
    SignalKind,
)

METHOD: Final = "MAX30100, uncalibrated"
PPG: Final = SignalInfo(SignalKind.PPG, "C62", None, ("ir", "red"), -1, 65_536, 1.0, METHOD)
HEART_RATE: Final = SignalInfo(SignalKind.HEART_RATE, "BPM", None, ("",), 0, 1000, None, METHOD)
SPO2: Final = SignalInfo(SignalKind.SPO2, "P1", None, ("",), 0, 101, None, METHOD)
SEARCH_HOST: Final = "0.0.0.0"  # noqa: S104 - sticks are in the network, and a search only listens
MAX_FOUND: Final = 64
RESTART_S: Final = 1.0
"""A stick whose clock runs back by more was switched on again."""


class Max30100Settings(DriverSettings):
    """Where to listen. `device_id` and `sender` accept one stick; UDP has no proof of who sends."""

    host: str = "127.0.0.1"
    port: int = Field(1234, ge=0, le=65_535)
    device_id: str | None = None
    sender: str | None = None


class Max30100Driver(SensorDriver):
    """One stick. SpO2 of such a sensor is not calibrated: it is shown, and never feeds a limit."""

    settings_model: ClassVar[type[DriverSettings]] = Max30100Settings
    max_latency_s = 0.2
    silence_limits_s = {SignalKind.HEART_RATE: 2.5, SignalKind.PPG: 0.85}  # noqa: RUF012

    def __init__(self, source: str, settings: Max30100Settings) -> None:
        super().__init__(source, settings)
        self.port = settings.port
        """The port it listens on, also where the setting is 0."""
        self._last_s: float | None = None

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        return (PPG, HEART_RATE, SPO2)

    @classmethod
    async def discover(cls, timeout_s: float, port: int = 1234) -> list[FoundDevice]:
        """Return the sticks that send to the usual port within `timeout_s`, with their ids.

        Returns nothing while a driver listens on that port.
        """
        search = _Search()
        try:
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: search, local_addr=(SEARCH_HOST, port)
            )
        except OSError:
            return []
        try:
            await asyncio.sleep(timeout_s)
        finally:
            transport.close()
        return list(search.found.values())

    async def run(self, sink: Sink) -> None:
        settings: Max30100Settings = self.settings
        loop = asyncio.get_running_loop()
        self._last_s = None
        protocol = _Datagrams(self, sink)
        try:
            transport, _ = await loop.create_datagram_endpoint(
                lambda: protocol, local_addr=(settings.host, settings.port)
            )
        except OSError as error:
            where = f"UDP port {settings.port} of {settings.host}"
            raise LinkLost(f"{where} cannot be used: {error.strerror}; is another driver on it?") from error
        try:
            self.port = transport.get_extra_info("sockname")[1]
            sink(SensorReport(self.source, now_s(), link=LinkState.SEARCHING, text=f"listens on {self.port}"))
            raise LinkLost(await protocol.failed)
        finally:
            transport.close()

    def take(self, data: bytes, sender: str, sink: Sink) -> None:
        """Take one datagram."""
        settings: Max30100Settings = self.settings
        if settings.sender is not None and sender != settings.sender:
            return
        try:
            reading = parse(data)
        except PacketError as error:
            self.reject(sink, error)
            return
        if settings.device_id is not None and reading.device_id != settings.device_id:
            return
        at_s, last_s = reading.device_s, self._last_s
        if at_s is not None and last_s is not None and last_s - RESTART_S < at_s <= last_s:
            return  # late or repeated: UDP keeps no order
        self._last_s = reading.device_s
        for samples in self._samples(reading):
            sink(samples)
        if reading.battery is not None or reading.has_contact is not None:
            report = SensorReport(
                self.source, now_s(), battery=reading.battery, has_contact=reading.has_contact
            )
            sink(report)

    def _samples(self, reading: PulseReading) -> list[Samples]:
        infrared = np.nan if reading.infrared is None else reading.infrared
        red = np.nan if reading.red is None else reading.red
        is_device = reading.device_s is not None
        at_s = cast("float", reading.device_s) if is_device else now_s()
        has_light = reading.infrared is not None or reading.red is not None
        return [
            Samples(
                self.source,
                info,
                at_s,
                np.array([values]),
                np.array([at_s]),
                ClockKind.DEVICE if is_device else ClockKind.ARRIVAL,
                has_contact=reading.has_contact,
            )
            for info, values, is_there in (
                (PPG, [infrared, red], has_light),
                (HEART_RATE, [reading.heart_rate_bpm], reading.heart_rate_bpm is not None),
                (SPO2, [reading.spo2_percent], reading.spo2_percent is not None),
            )
            if is_there
        ]


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, driver: Max30100Driver, sink: Sink) -> None:
        self._driver, self._sink = driver, sink
        self.failed: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self._driver.take(data, addr[0], self._sink)

    def connection_lost(self, exc: Exception | None) -> None:
        if not self.failed.done():
            self.failed.set_result(f"the socket failed: {exc}")


class _Search(asyncio.DatagramProtocol):
    def __init__(self) -> None:
        self.found: dict[tuple[str, str | None], FoundDevice] = {}

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        with suppress(PacketError):
            device_id = parse(data).device_id
            if len(self.found) < MAX_FOUND:
                self.found[addr[0], device_id] = FoundDevice(addr[0], device_id or "MAX30100")
