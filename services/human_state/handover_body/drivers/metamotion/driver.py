"""Acceleration of a MetaMotionS in m/s². It sends no times, so samples are stamped when they arrive."""

from typing import TYPE_CHECKING, ClassVar, Literal

from handover_body.drivers.base import DriverSettings, Sink, now_s
from handover_body.drivers.bluetooth import BluetoothDriver, BluetoothSettings
from handover_body.drivers.metamotion.protocol import (
    COMMAND,
    GRAVITY,
    NOTIFY,
    SERVICE,
    parse,
    start_commands,
)
from handover_body.model.signals import ClockKind, Samples, SignalInfo, SignalKind

if TYPE_CHECKING:
    from bleak import BleakClient


class MetaMotionSettings(BluetoothSettings):
    """Rate and range of the accelerometer."""

    rate_hz: Literal[25, 50, 100, 200] = 50
    range_g: Literal[2, 4, 8, 16] = 4


class MetaMotionDriver(BluetoothDriver):
    """One MetaMotionS."""

    settings_model: ClassVar[type[DriverSettings]] = MetaMotionSettings
    service_uuid = SERVICE

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        settings: MetaMotionSettings = self.settings
        bound = settings.range_g * GRAVITY * 32767 / 32768
        resolution = settings.range_g * GRAVITY / 32768
        axes = ("x", "y", "z")
        rate_hz = float(settings.rate_hz)
        return (
            SignalInfo(SignalKind.ACCELERATION, "MSK", rate_hz, axes, -bound, bound, resolution, "wrist"),
        )

    async def serve(self, client: "BleakClient", sink: Sink) -> None:
        settings: MetaMotionSettings = self.settings
        (info,) = self.signals

        def take(data: bytes) -> None:
            values = parse(data, settings.range_g)
            if values is not None:
                start_s = now_s() - (len(values) - 1) / settings.rate_hz
                sink(Samples(self.source, info, start_s, values, clock=ClockKind.ARRIVAL))

        await self.subscribe(client, NOTIFY, take, sink)
        for command in start_commands(settings.rate_hz, settings.range_g):
            await client.write_gatt_char(COMMAND, command, response=True)
