"""The mat is read ten times a second: it answers with the newest cells, and notifies of nothing."""

import asyncio
from typing import TYPE_CHECKING, ClassVar

from pydantic import Field

from handover_body.drivers.base import DriverSettings, PacketError, Sink, now_s
from handover_body.drivers.bluetooth import BluetoothDriver, BluetoothSettings
from handover_body.drivers.sensomative.protocol import CELLS_UUID, CHANNELS, SERVICE, parse
from handover_body.model.signals import ClockKind, Samples, SignalInfo, SignalKind

if TYPE_CHECKING:
    from bleak import BleakClient


class SensomativeSettings(BluetoothSettings):
    """How often the mat is read."""

    rate_hz: float = Field(10.0, gt=0, le=25)


class SensomativeDriver(BluetoothDriver):
    """One mat."""

    settings_model: ClassVar[type[DriverSettings]] = SensomativeSettings
    service_uuid = SERVICE

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        rate_hz = self.settings.rate_hz
        method = "seat mat, uncalibrated"
        return (SignalInfo(SignalKind.PRESSURE_MAP, "C62", rate_hz, CHANNELS, -1, 256, 1.0, method),)

    async def serve(self, client: "BleakClient", sink: Sink) -> None:
        loop = asyncio.get_running_loop()
        (info,) = self.signals
        period_s = 1 / (info.rate_hz or 10.0)
        due = loop.time()
        while True:
            try:
                cells = parse(bytes(await client.read_gatt_char(CELLS_UUID)))
                sink(Samples(self.source, info, now_s(), cells, clock=ClockKind.ARRIVAL))
            except PacketError as error:
                self.reject(sink, error)
            due = max(due + period_s, loop.time())
            await asyncio.sleep(due - loop.time())
