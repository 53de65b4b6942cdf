"""The registered devices: their descriptions, their credentials, and who is let in with them."""

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from hmac import compare_digest
from typing import Final

from sqlalchemy import Engine

from handover.errors import Problem
from handover.messages import text_of
from handover.security.secret_tokens import is_token, new_token, token_hash
from handover.telemetry import get_logger
from handover_devices.model.description import DeviceDescription
from handover_devices.protocol.messages import is_device_name
from handover_devices.refusals import WrongCertificate, WrongToken
from handover_devices.registry.device import Device, LatestValue
from handover_devices.storage import device_store, history
from handover_devices.storage.device_store import DeviceFile, StoredDevice
from handover_devices.storage.history_writer import HistoryWriter

log = get_logger(__name__)

TOKEN_KIND: Final = "device"  # noqa: S105 - no token
_NO_HASH: Final = "0" * 64
"""Compared with the token of an unknown device, so that it takes as long as for a known one."""


@dataclass(frozen=True, slots=True)
class NewToken:
    """A device and its new token, which nobody can read again."""

    device: Device
    token: str


class DeviceRegistry:
    """All devices; call `load_devices` first. A change is durable when its method returns.

    `clock` is the time since 1970. A subclass has the connections: it ends that of a device whose credentials
    have changed (`_end_link`), and overrides `_note_change` and `_forget`.
    """

    def __init__(self, engine: Engine, writer: HistoryWriter, clock: Callable[[], float] = time.time) -> None:
        self.writer = writer
        self.devices: dict[str, Device] = {}
        self.on_changed: Callable[[Device], None] = lambda _: None
        """Called with each device that was added or whose description has changed."""
        self.on_removed: Callable[[str], None] = lambda _: None
        self._engine = engine
        self._clock = clock

    async def load_devices(self) -> None:
        """Read the devices and their latest values; those that are known keep their connections."""
        stored_devices = {
            entry.name: entry for entry in await asyncio.to_thread(device_store.load, self._engine)
        }
        for name in [name for name in self.devices if name not in stored_devices]:
            self.drop(name)
        for name, stored in stored_devices.items():
            device = self.devices.get(name)
            if device is None:
                device = self.devices[name] = Device(stored)
            elif _differs(device.stored, stored):
                self.replace(device, stored)
            await self._read_latest(device)

    async def _read_latest(self, device: Device) -> None:
        for name, (t_us, value) in (
            await asyncio.to_thread(history.latest, self._engine, device.name)
        ).items():
            latest = device.latest.get(name)
            if name in device.values and (latest is None or latest.t < t_us / 1e6):
                device.latest[name] = LatestValue(t_us / 1e6, value)

    def device(self, name: str) -> Device:
        """Return a device; raise `Problem` 404."""
        stored = self.devices.get(name)
        if stored is None:
            raise Problem.translated(
                404,
                "No such device",
                "device.unknown",
                'there is no device "{device}"; add it with `handover device add {device}`',
                device=name,
            )
        return stored

    async def add(self, name: str, description: DeviceDescription) -> NewToken:
        """Register a device and return its token."""
        if not is_device_name(name):
            raise Problem.translated(
                422,
                "Not a name",
                "device.bad_name",
                '"{name}" cannot be the name of a device: 1 to 64 letters, digits, "_", "." or "-", a '
                "letter or digit first",
                name=name[:64],
            )
        if name in self.devices:
            raise Problem.translated(
                409,
                "Name taken",
                "device.name_taken",
                'there is a device "{device}" already; choose another name',
                device=name,
            )
        now_us, token = int(self._clock() * 1e6), new_token(TOKEN_KIND)
        device = Device(StoredDevice(name, description, token_hash(token), now_us, now_us), has_news=True)
        self.devices[name] = device  # so that a second request for the name is refused meanwhile
        try:
            await self.writer.call(lambda connection: device_store.add(connection, device.stored))
        except BaseException:
            del self.devices[name]
            raise
        log.info("device added", device=name, kind=description.kind.value)
        self._note_change(device)
        return NewToken(device, token)

    async def describe(self, name: str, description: DeviceDescription) -> Device:
        """Replace the description of a device."""
        device = self.device(name)
        await self._replace(device, replace(device.stored, description=description))
        return device

    async def change_token(self, name: str) -> NewToken:
        """Give a device a new token; the old one ends at once, with its connection."""
        device, token = self.device(name), new_token(TOKEN_KIND)
        await self._replace(device, replace(device.stored, token_sha256=token_hash(token)))
        self._end_link(device, "tokenChanged", "the token of this device was replaced; give it the new one")
        return NewToken(device, token)

    async def revoke_token(self, name: str) -> None:
        """Remove the token of a device; it cannot connect until it gets a new one."""
        device = self.device(name)
        await self._replace(device, replace(device.stored, token_sha256=None))
        self._end_link(device, "tokenRevoked", "the token of this device was revoked; ask for a new one")

    async def set_certificate(self, name: str, sha256: str | None, end_us: int | None) -> None:
        """Give a device a certificate, by its fingerprint; None revokes it. The connection ends at once."""
        device = self.device(name)
        stored = replace(device.stored, certificate_sha256=sha256, certificate_end_us=end_us)
        await self._replace(device, stored)
        self._end_link(
            device,
            "certificateChanged",
            "the certificate of this device was replaced or revoked; use the new one",
        )

    async def remove(self, name: str) -> None:
        """Delete a device with its history, and end its connection."""
        self.device(name)
        await self.writer.call(lambda connection: device_store.remove(connection, name))
        self.drop(name)

    async def mirror(self, stored: StoredDevice) -> None:
        """Take over a device as the centre has it; its connection ends if its credentials have changed."""
        device = self.devices.get(stored.name)
        if device is None:
            await self.writer.call(lambda connection: device_store.add(connection, stored))
            self.devices[stored.name] = Device(stored)
        elif _differs(device.stored, stored):
            stored = replace(stored, updated_us=int(self._clock() * 1e6))
            await self.writer.call(lambda connection: device_store.replace(connection, stored))
            self.replace(device, stored)

    def adopt(self, stored: StoredDevice) -> None:
        """Use a device as another process has stored it."""
        device = self.devices.get(stored.name)
        if device is None:
            self.devices[stored.name] = Device(stored)
        elif _differs(device.stored, stored):
            self.replace(device, stored)
        else:
            return
        self._note_change(self.devices[stored.name])

    def replace(self, device: Device, stored: StoredDevice) -> None:
        """Use what is stored of a device; its connection ends if its credentials have changed."""
        before = device.stored
        device.describe(stored)
        if (stored.token_sha256, stored.certificate_sha256) != (
            before.token_sha256,
            before.certificate_sha256,
        ):
            reason = "the token or the certificate of this device was replaced or revoked; use the new one"
            self._end_link(device, "credentialsChanged", reason)

    def drop(self, name: str) -> None:
        """Forget a device that was deleted, and end its connection."""
        device = self.devices.pop(name, None)
        self.writer.forget(name)
        if device is not None:
            self._forget(device)
            self._end_link(device, "deleted", "this device was deleted; register it again")
            log.info("device deleted", device=name)
            self.on_removed(name)

    async def save_file(self, name: str, kind: str, file: DeviceFile | None) -> None:
        """Store a file of a device; None deletes it."""
        self.device(name)
        await self.writer.call(lambda connection: device_store.save_file(connection, name, kind, file))

    def authorized(self, name: str, token: str) -> Device:
        """Return the device with this token; raise `Problem` 401."""
        try:
            return self.with_token(name, token)
        except WrongToken as wrong:
            raise Problem(401, "Wrong token", text_of(wrong)) from None

    def with_token(self, name: str, token: str) -> Device:
        """Return the device with this token; raise `WrongToken`."""
        device = self.devices.get(name)
        stored = device.stored.token_sha256 if device is not None else None
        if not is_token(token, stored or _NO_HASH) or stored is None or device is None:
            raise WrongToken
        return device

    def with_certificate(self, name: str, sha256: str) -> Device:
        """Return the device whose certificate has this fingerprint; raise `WrongCertificate`."""
        device = self.devices.get(name)
        stored = device.stored.certificate_sha256 if device is not None else None
        if not compare_digest(sha256, stored or _NO_HASH) or stored is None or device is None:
            raise WrongCertificate
        return device

    async def _replace(self, device: Device, stored: StoredDevice) -> None:
        stored = replace(stored, updated_us=int(self._clock() * 1e6))
        await self.writer.call(lambda connection: device_store.replace(connection, stored))
        device.describe(stored)
        self._note_change(device)

    def _note_change(self, device: Device) -> None:
        self.on_changed(device)

    def _forget(self, device: Device) -> None:
        """A device was deleted."""

    def _end_link(self, device: Device, code: str, reason: str, *, retry: bool = False) -> None:
        """End the connection of a device."""


def _differs(stored: StoredDevice, other: StoredDevice) -> bool:
    return (stored.description, stored.token_sha256, stored.certificate_sha256) != (
        other.description,
        other.token_sha256,
        other.certificate_sha256,
    )
