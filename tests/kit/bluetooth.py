"""A Bluetooth LE peripheral in this process, behind the backend interface of bleak.

The drivers run unchanged on `BleakClient` and `BleakScanner`; only what talks to the operating system is
replaced.
"""

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from bleak.backends.characteristic import BleakGATTCharacteristic
from bleak.backends.client import BaseBleakClient
from bleak.backends.scanner import AdvertisementData, BaseBleakScanner
from bleak.backends.service import BleakGATTService, BleakGATTServiceCollection
from bleak.exc import BleakError

BATTERY = "0000180f-0000-1000-8000-00805f9b34fb"
BATTERY_LEVEL = "00002a19-0000-1000-8000-00805f9b34fb"


class Peripheral:
    """A device with services (UUIDs of characteristics by UUID of service)."""

    def __init__(
        self, name: str, services: Mapping[str, tuple[str, ...]], address: str = "24:AC:AC:00:00:01"
    ) -> None:
        self.name, self.address = name, address
        self.services = {**services, BATTERY: (BATTERY_LEVEL,)}
        self.values: dict[str, bytes] = {BATTERY_LEVEL: b"\x50"}
        self.written: list[tuple[str, bytes]] = []
        self.on_write: Callable[[str, bytes], None] = lambda uuid, data: None
        self.connections = 0
        self.is_near = True
        self.client: PeripheralClient | None = None

    @property
    def subscribed(self) -> set[str]:
        return set(self.client.callbacks) if self.client is not None else set()

    def notify(self, uuid: str, data: bytes) -> None:
        """Send a notification, if there is a connection that subscribed."""
        if self.client is not None and (callback := self.client.callbacks.get(uuid)) is not None:
            callback(bytearray(data))

    def drop(self) -> None:
        """Lose the connection, as when the person leaves."""
        if self.client is not None:
            self.client.lose()

    def backends(self) -> dict[str, Any]:
        """Return the attributes of a driver class that speaks with this peripheral only."""
        client = type("Client", (PeripheralClient,), {"peripheral": self})
        scanner = type("Scanner", (PeripheralScanner,), {"peripheral": self})
        return {"client_backend": client, "scanner_backend": scanner}


class PeripheralClient(BaseBleakClient):
    peripheral: Peripheral

    def __init__(self, device: Any, *args: Any, **options: Any) -> None:
        options = {key: options[key] for key in ("disconnected_callback", "timeout")}
        super().__init__(device, **options)
        self.callbacks: dict[str, Callable[[bytearray], None]] = {}
        self._connected = False

    @property
    def name(self) -> str:
        return self.peripheral.name

    @property
    def mtu_size(self) -> int:
        return 247

    @property
    def is_connected(self) -> bool:
        return self._connected

    async def connect(self, pair: bool, **kwargs: Any) -> None:
        await asyncio.sleep(0)
        if not self.peripheral.is_near:
            raise BleakError("out of reach")
        self.services = BleakGATTServiceCollection()
        handle = 0
        for service_uuid, characteristics in self.peripheral.services.items():
            handle += 1
            service = BleakGATTService(None, handle, service_uuid)
            self.services.add_service(service)
            for uuid in characteristics:
                handle += 1
                properties: Any = ["read", "write", "notify"]
                made = BleakGATTCharacteristic(None, handle, uuid, properties, lambda: 244, service)
                self.services.add_characteristic(made)
        self._connected = True
        self.peripheral.client = self
        self.peripheral.connections += 1

    async def disconnect(self) -> None:
        self._connected = False
        self.callbacks.clear()
        self.peripheral.client = None

    def lose(self) -> None:
        self._connected = False
        self.callbacks.clear()
        self.peripheral.client = None
        if self._disconnected_callback is not None:
            self._disconnected_callback()

    async def pair(self, *args: Any, **kwargs: Any) -> None: ...

    async def unpair(self) -> None: ...

    async def read_gatt_char(self, characteristic: BleakGATTCharacteristic, **kwargs: Any) -> bytearray:
        await asyncio.sleep(0)
        self._check()
        return bytearray(self.peripheral.values[characteristic.uuid])

    async def read_gatt_descriptor(self, descriptor: Any, **kwargs: Any) -> bytearray:
        raise NotImplementedError

    async def write_gatt_char(
        self, characteristic: BleakGATTCharacteristic, data: Any, response: bool
    ) -> None:
        await asyncio.sleep(0)
        self._check()
        self.peripheral.written.append((characteristic.uuid, bytes(data)))
        self.peripheral.on_write(characteristic.uuid, bytes(data))

    async def write_gatt_descriptor(self, descriptor: Any, data: Any) -> None:
        raise NotImplementedError

    async def start_notify(
        self, characteristic: BleakGATTCharacteristic, callback: Callable[[bytearray], None], **kwargs: Any
    ) -> None:
        await asyncio.sleep(0)
        self._check()
        self.callbacks[characteristic.uuid] = callback

    async def stop_notify(self, characteristic: BleakGATTCharacteristic) -> None:
        self.callbacks.pop(characteristic.uuid, None)

    def _check(self) -> None:
        if not self._connected:
            raise BleakError("not connected")


class PeripheralScanner(BaseBleakScanner):
    peripheral: Peripheral

    def __init__(self, detection_callback: Any, service_uuids: Any, *args: Any, **options: Any) -> None:
        super().__init__(detection_callback, service_uuids)

    async def start(self) -> None:
        self.seen_devices = {}
        if not self.peripheral.is_near:
            return
        one = self.peripheral
        advertised = AdvertisementData(one.name, {}, {}, list(one.services), None, -60, ())
        device = self.create_or_update_device(one.address, one.address, one.name, None, advertised)
        asyncio.get_running_loop().call_soon(self.call_detection_callbacks, device, advertised)

    async def stop(self) -> None: ...
