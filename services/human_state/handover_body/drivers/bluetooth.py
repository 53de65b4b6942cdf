"""What drivers of Bluetooth LE sensors share: search, connection, notifications, battery, loss of the link.

    class BeltDriver(BluetoothDriver):
        service_uuid = "0000180d-0000-1000-8000-00805f9b34fb"

        async def serve(self, client, sink): ...   # subscribe; return, or work until cancelled

The transport is `bleak`. `client_backend` and `scanner_backend` replace that of the platform: tests put a
peripheral there.
"""

import asyncio
from abc import abstractmethod
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import Field

from handover.distribution import install_command
from handover.errors import UsageError
from handover.messages import message, text_of
from handover_body.drivers.base import (
    DriverSettings,
    FoundDevice,
    LinkLost,
    PacketError,
    SensorDriver,
    Sink,
    now_s,
)
from handover_body.model.signals import LinkState, SensorReport

if TYPE_CHECKING:
    from bleak import BleakClient

BATTERY_LEVEL = "00002a19-0000-1000-8000-00805f9b34fb"
BATTERY_PERIOD_S = 60.0


class BluetoothSettings(DriverSettings):
    """Which device. Without an address or a name it is the first that offers the service."""

    address: str | None = None
    """Its Bluetooth address (on macOS its UUID); `handover` lists what it finds."""
    name: str | None = None
    """The beginning of its name, where there is no address."""
    adapter: str | None = None
    """The adapter on Linux: `hci0`."""
    pair: bool = False
    search_s: float = Field(20.0, gt=0, le=120)
    connect_s: float = Field(20.0, gt=0, le=120)


class BluetoothDriver(SensorDriver):
    """A sensor over Bluetooth LE."""

    settings_model: ClassVar[type[DriverSettings]] = BluetoothSettings
    service_uuid: ClassVar[str]
    """The service that such devices advertise."""
    name_prefixes: ClassVar[tuple[str, ...]] = ()
    """How names of such devices begin; empty: any."""
    max_latency_s = 0.15  # connection intervals of wearables reach 100 ms
    client_backend: ClassVar[Any] = None
    scanner_backend: ClassVar[Any] = None

    @abstractmethod
    async def serve(self, client: "BleakClient", sink: Sink) -> None:
        """Subscribe on a connected `client`. It may return; the link stays open then."""

    async def run(self, sink: Sink) -> None:
        bleak = _bleak()
        lost = asyncio.Event()
        try:
            device = await self._find(bleak)
            sink(SensorReport(self.source, now_s(), link=LinkState.PAIRING))
            client = bleak.BleakClient(
                device,
                lambda _: lost.set(),
                timeout=self.settings.connect_s,
                pair=self.settings.pair,
                backend=self.client_backend,
            )
            async with client:
                sink(SensorReport(self.source, now_s(), link=LinkState.CONNECTED))
                await self._serve(client, sink, lost)
        except (bleak.exc.BleakError, TimeoutError, OSError) as error:
            raise LinkLost(f"Bluetooth: {error or type(error).__name__}") from error
        raise LinkLost(
            message("health.sensor.out_of_reach", "the device closed the connection, or is out of reach")
        )

    async def _serve(self, client: "BleakClient", sink: Sink, lost: asyncio.Event) -> None:
        """Serve and read the battery until the link is lost; what `serve` raises ends the connection."""
        try:
            async with asyncio.TaskGroup() as tasks:
                serving = [
                    tasks.create_task(self.serve(client, sink)),
                    tasks.create_task(self._watch_battery(client, sink)),
                ]
                await lost.wait()
                for task in serving:
                    task.cancel()
        except* LinkLost as group:
            raise LinkLost(text_of(group.exceptions[0])) from group
        except* (_bleak().exc.BleakError, TimeoutError, OSError) as group:
            raise LinkLost(f"Bluetooth: {group.exceptions[0]}") from group

    async def _find(self, bleak: Any) -> Any:
        settings: BluetoothSettings = self.settings
        device = await bleak.BleakScanner.find_device_by_filter(
            self._is_wanted,
            timeout=settings.search_s,
            backend=self.scanner_backend,
            bluez={"adapter": settings.adapter} if settings.adapter else {},
        )
        if device is None:
            wanted = settings.address or settings.name or f"device with the service {self.service_uuid}"
            raise LinkLost(
                message(
                    "health.sensor.not_found",
                    "no {wanted} within {seconds} s; is it worn, charged and near?",
                    wanted=wanted,
                    seconds=settings.search_s,
                )
            )
        return device

    def _is_wanted(self, device: Any, advertised: Any) -> bool:
        settings: BluetoothSettings = self.settings
        if settings.address is not None:
            return bool(device.address.lower() == settings.address.lower())
        name = advertised.local_name or device.name or ""
        if settings.name is not None:
            return bool(name.startswith(settings.name))
        return self._is_kind(name, advertised.service_uuids)

    @classmethod
    def _is_kind(cls, name: str, uuids: list[str]) -> bool:
        if cls.name_prefixes:
            return name.startswith(cls.name_prefixes)
        return cls.service_uuid in uuids

    @classmethod
    async def discover(cls, timeout_s: float) -> list[FoundDevice]:
        bleak = _bleak()
        try:
            seen = await bleak.BleakScanner.discover(timeout_s, return_adv=True, backend=cls.scanner_backend)
        except (bleak.exc.BleakError, OSError) as error:
            raise UsageError(
                f"Bluetooth cannot search: {error}; is there an adapter, and is it on?"
            ) from error
        return [
            FoundDevice(device.address, advertised.local_name or device.name or "", advertised.rssi)
            for device, advertised in seen.values()
            if cls._is_kind(advertised.local_name or device.name or "", advertised.service_uuids)
        ]

    async def subscribe(
        self, client: "BleakClient", uuid: str, take: Callable[[bytes], None], sink: Sink
    ) -> None:
        """Pass what the characteristic notifies to `take`; packets that it refuses are reported."""
        await client.start_notify(uuid, partial(self._notified, take, sink))

    def _notified(self, take: Callable[[bytes], None], sink: Sink, _: Any, data: bytearray) -> None:
        try:
            take(bytes(data))
        except PacketError as error:
            self.reject(sink, error)

    async def _watch_battery(self, client: "BleakClient", sink: Sink) -> None:
        """Read the battery once a minute where there is one; a link that is dead is noticed by it, too."""
        if client.services.get_characteristic(BATTERY_LEVEL) is None:
            return
        while True:
            with suppress(IndexError):
                level = bytes(await client.read_gatt_char(BATTERY_LEVEL))[0]
                if level <= 100:
                    sink(SensorReport(self.source, now_s(), battery=level / 100))
            await asyncio.sleep(BATTERY_PERIOD_S)


def _bleak() -> Any:
    try:
        import bleak  # noqa: PLC0415 - of the extra
    except ImportError:
        raise UsageError(f"sensors over Bluetooth need the extra: {install_command('body')}") from None
    return bleak
