"""The gateway: registered devices, their connections, and what becomes of each message.

Transports (TCP, HTTP) turn bytes into lines and pass them to a `Session`; everything else is here, once.

A message is answered after it is durable, and the answers of a connection have the order of its messages.
A second connection with the same device and a valid token replaces the first: after a broken network a robot
comes back long before its old connection is found dead. The replaced one gets `retry: false`, so that two
programs with one token do not take turns for ever.
"""

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hmac import compare_digest
from secrets import token_hex
from typing import Any, Final, Protocol

import orjson
from sqlalchemy import Engine

from handover.errors import Problem
from handover.messages import message, text_of
from handover.security.secret_tokens import is_token, new_token, token_hash
from handover.telemetry import get_logger
from services.device_gateway import metrics
from services.device_gateway.commands.dispatcher import Dispatcher
from services.device_gateway.model.description import DeviceDescription
from services.device_gateway.protocol.live import INPUT, ImagePart, live_message, parse_image
from services.device_gateway.protocol.messages import (
    MAX_LINE_BYTES,
    BadMessage,
    CommandAnswer,
    DeviceEvent,
    Hello,
    Message,
    StateReport,
    Telemetry,
    is_device_name,
    parse_message,
)
from services.device_gateway.protocol.times import TimeRule
from services.device_gateway.refusals import Refused, WrongCertificate, WrongToken
from services.device_gateway.registry.device import Device, LatestValue, Link
from services.device_gateway.registry.edge_marks import EdgeMarks
from services.device_gateway.storage import device_store, history
from services.device_gateway.storage.device_store import DeviceFile, StoredDevice
from services.device_gateway.storage.history_writer import HistoryWriter, MessageRow
from services.device_gateway.storage.outbox import RelayRow

log = get_logger(__name__)

MAX_LOGGED: Final = 1_000
"""Characters of a refused line in the log of messages."""

TOKEN_KIND: Final = "device"  # noqa: S105 - no token
_NO_HASH: Final = "0" * 64
"""Compared with the token of an unknown device, so that it takes as long as for a known one."""

Respond = Callable[[Sequence[Mapping[str, Any]]], None]


@dataclass(frozen=True, slots=True)
class NewToken:
    """A device and its new token, which nobody can read again."""

    device: Device
    token: str


class Reports(Protocol):
    """Who learns of devices with news; at an edge nobody, since the centre writes to the broker."""

    def put(self, device: Device) -> None:
        """Report a device soon."""

    def forget(self, name: str) -> None:
        """Stop reporting a device that was deleted."""


class Session:
    """A device over one connection, after its hello was accepted."""

    def __init__(self, gateway: "DeviceGateway", device: Device, link: Link) -> None:
        self.device = device
        self.link = link
        self._gateway = gateway

    def receive(self, lines: Sequence[bytes], respond: Respond) -> None:
        """Process lines; `respond` is called with the answers once the messages are durable."""
        self._gateway.receive(self.device, lines, respond)

    def end(self) -> None:
        """The connection has ended."""
        self._gateway.disconnect(self.device, self.link)


class DeviceGateway:
    """All devices; call `load` first. `clock` is the time since 1970."""

    def __init__(  # noqa: PLR0917 - wired once, by `app`
        self,
        engine: Engine,
        writer: HistoryWriter,
        dispatcher: Dispatcher,
        reports: Reports,
        times: TimeRule,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self.dispatcher = dispatcher
        self.writer = writer
        self.devices: dict[str, Device] = {}
        self.on_changed: Callable[[Device], None] = lambda _: None
        """Called with each device that was added or whose description has changed."""
        self.on_removed: Callable[[str], None] = lambda _: None
        self.on_values: Callable[[str, Mapping[str, float], float], None] = lambda *_: None
        """Called with the device, the values and the time of each telemetry message."""
        self.on_input: Callable[[str, bytes], None] = lambda *_: None
        """Called with each input of a person, which is neither stored nor acknowledged."""
        self.on_image: Callable[[str, ImagePart], object] = lambda *_: None
        """Called with each part of an image of a camera, likewise. Raises `BadMessage`."""
        self.relay_live: Callable[[str, Mapping[str, Any]], object] | None = None
        """At an edge it is called with both instead."""
        self.on_disconnected: Callable[[str], None] = lambda _: None
        self.edge_marks = EdgeMarks({})
        self._engine = engine
        self._reports = reports
        self._times = times
        self._clock = clock

    async def load(self) -> None:
        """Read the devices and their latest values."""
        for stored in await asyncio.to_thread(device_store.load, self._engine):
            device = Device(stored)
            found = await asyncio.to_thread(history.latest, self._engine, stored.name)
            device.latest = {
                name: LatestValue(t_us / 1e6, value)
                for name, (t_us, value) in found.items()
                if name in device.values
            }
            self.devices[stored.name] = device
        self.edge_marks = EdgeMarks(await asyncio.to_thread(device_store.edge_marks, self._engine))
        await self.dispatcher.load()

    # Registration

    def device(self, name: str) -> Device:
        """Return a device; raise `Problem` 404."""
        found = self.devices.get(name)
        if found is None:
            raise Problem(
                404,
                "No such device",
                message(
                    "device.unknown",
                    'there is no device "{device}"; add it with `handover device add {device}`',
                    device=name,
                ),
            )
        return found

    async def add(self, name: str, description: DeviceDescription) -> NewToken:
        """Register a device and return its token."""
        if not is_device_name(name):
            raise Problem(
                422,
                "Not a name",
                message(
                    "device.bad_name",
                    '"{name}" cannot be the name of a device: 1 to 64 letters, digits, "_", "." or "-", a '
                    "letter or digit first",
                    name=name[:64],
                ),
            )
        if name in self.devices:
            raise Problem(
                409,
                "Name taken",
                message(
                    "device.name_taken",
                    'there is a device "{device}" already; choose another name',
                    device=name,
                ),
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
        self._changed(device)
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
        device = self.device(name)
        await self.writer.call(lambda connection: device_store.remove(connection, name))
        self.devices.pop(name, None)
        self.writer.forget(name)
        self._reports.forget(name)
        self.dispatcher.forget(name)
        self.edge_marks.forget(name)
        self._end_link(device, "deleted", "this device was deleted; register it again")
        log.info("device deleted", device=name)
        self.on_removed(name)

    async def mirror(self, stored: StoredDevice) -> None:
        """Take over a device as the centre has it; its connection ends if its credentials have changed."""
        device = self.devices.get(stored.name)
        if device is None:
            await self.writer.call(lambda connection: device_store.add(connection, stored))
            self.devices[stored.name] = Device(stored)
            return
        before = device.stored
        credentials = (stored.token_sha256, stored.certificate_sha256)
        same = (before.description, before.token_sha256, before.certificate_sha256)
        if same == (stored.description, *credentials):
            return
        await self._replace(device, stored)
        if credentials != (before.token_sha256, before.certificate_sha256):
            reason = "the token or the certificate of this device was replaced or revoked; use the new one"
            self._end_link(device, "credentialsChanged", reason)

    async def save_file(self, name: str, kind: str, file: DeviceFile | None) -> None:
        """Store a file of a device; None deletes it."""
        self.device(name)
        await self.writer.call(lambda connection: device_store.save_file(connection, name, kind, file))

    # Connections

    def connect(self, hello: Hello, link: Link, certificate_sha256: str = "") -> Session:
        """Accept a connection; raise `Refused`. An earlier connection of the device is replaced.

        `certificate_sha256` is the fingerprint of the client certificate, empty without one. It counts only
        if the hello has no token.
        """
        try:
            if hello.token or not certificate_sha256:
                device = self.with_token(hello.device, hello.token)
            else:
                device = self.with_certificate(hello.device, certificate_sha256)
        except (WrongToken, WrongCertificate) as wrong:
            # An edge may not know yet a device that was registered at the centre a moment ago.
            raise Refused(wrong.code, str(wrong), retry=self.writer.outbox is not None) from None
        session = self._begin(device, hello.boot, link)
        device.drives = hello.drives
        return session

    def attach(self, name: str, link: Link, boot: str = "") -> Session:
        """Begin the session of a device that an adapter has identified by other means than a token.

        Raises `Problem` 404.
        """
        return self._begin(self.device(name), boot, link)

    def _begin(self, device: Device, boot: str, link: Link) -> Session:
        if device.link is not None:
            log.warning("connection replaced", device=device.name)
            self._end_link(device, "replaced", "another connection of this device has replaced this one")
        device.link = link
        device.seen_at = self._clock()
        device.has_news = True
        link.boot = boot or f"connection-{token_hex(8)}"
        metrics.CONNECTED.inc()
        self._reports.put(device)
        self.dispatcher.connect(device.name, link)
        log.info("device connected", device=device.name, boot=link.boot)
        return Session(self, device, link)

    def greeting(self, hello: Hello, device: Device) -> dict[str, Any]:
        """Return the answer to a hello, with the names in it that are not registered."""
        commands = {command.name for command in device.stored.description.commands}
        unknown = [name for name in hello.measures if name not in device.values]
        unknown += [name for name in hello.takes if name not in commands]
        return {
            "type": "ack",
            "version": 1,
            "device": device.name,
            "time": self._clock(),
            **({"unknown": unknown} if unknown else {}),
        }

    def disconnect(self, device: Device, link: Link) -> None:
        """Note that a connection has ended, unless it was replaced before."""
        self.dispatcher.disconnect(device.name, link)
        if device.link is link:
            device.link, device.drives = None, False
            device.has_news = True
            metrics.CONNECTED.dec()
            self._reports.put(device)
            self.on_disconnected(device.name)
            log.info("device disconnected", device=device.name)

    def end(self, name: str, code: str, reason: str, *, retry: bool) -> None:
        """End the connection of a device, if it has one."""
        device = self.devices.get(name)
        if device is not None:
            self._end_link(device, code, reason, retry=retry)

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

    # Messages

    def receive(self, device: Device, lines: Sequence[bytes], respond: Respond) -> "asyncio.Future[None]":
        """Process lines of a device; `respond` is called with the answers once the messages are durable.

        The future is done at the same time, also if there is no answer.
        """
        stored, answers = self.store(device, lines, self._times)
        if answers:
            stored.add_done_callback(lambda _: respond(answers))
        return stored

    def store(
        self, device: Device, lines: Sequence[bytes], times: TimeRule, max_bytes: int = MAX_LINE_BYTES
    ) -> tuple["asyncio.Future[None]", list[Mapping[str, Any]]]:
        """Process lines of a device; return the answers, and a future that is done when they may be sent."""
        now_s = self._clock()
        now_us = int(now_s * 1e6)
        device.seen_at = now_s
        answers: list[Mapping[str, Any]] = []
        messages: list[MessageRow] = []
        values: list[tuple[str, str, int, float]] = []
        relays: list[RelayRow] = []
        for line in lines:
            if (live := live_message(line)) is not None:
                if (fault := self.pass_on(device, line, live)) is not None:
                    answers.append(fault)
                continue
            try:
                message = parse_message(line, max_bytes)
                kind, answer = self._accept(device, message, times=times, now_s=now_s, values=values)
            except BadMessage as bad:
                metrics.MESSAGES_REFUSED.labels(bad.code).inc()
                answer = _with_seq({"type": "error", "code": bad.code, "reason": str(bad)}, bad.seq)
                answers.append(answer)
                text = line[:MAX_LOGGED].decode(errors="replace").replace("\0", "")
                messages.append(MessageRow(device.name, now_us, "in", "refused", text, str(bad)))
            else:
                if answer is not None:
                    answers.append(answer)
                messages.append(MessageRow(device.name, now_us, "in", kind, _text(line), None))
                if self.writer.outbox is not None:
                    relays.append(RelayRow(device.name, now_us, _with_time(line, message, now_s)))
        self._reports.put(device)
        return self.writer.add(messages=messages, values=values, relays=relays), answers

    def pass_on(self, device: Device, line: bytes, message: Mapping[str, Any]) -> Mapping[str, Any] | None:
        """Pass on a message that counts only at once; return the answer, if it is refused."""
        kind = str(message["type"])
        metrics.MESSAGES.labels(kind).inc()
        if self.relay_live is not None:
            self.relay_live(device.name, message)
            return None
        if kind == INPUT:
            self.on_input(device.name, line)
            return None
        try:
            self.on_image(device.name, parse_image(message))
        except BadMessage as bad:
            metrics.MESSAGES_REFUSED.labels(bad.code).inc()
            return {"type": "error", "code": bad.code, "reason": str(bad)}
        return None

    def _accept(
        self,
        device: Device,
        message: Message,
        *,
        times: TimeRule,
        now_s: float,
        values: list[tuple[str, str, int, float]],
    ) -> tuple[str, Mapping[str, Any] | None]:
        """Apply a message and return its type and the answer; raise `BadMessage`."""
        if isinstance(message, CommandAnswer):
            if not self.dispatcher.answer(device.name, message):
                raise BadMessage("unknownCommand", f'{device.name} has no command with the id "{message.id}"')
            metrics.MESSAGES.labels("answer").inc()
            return "answer", None
        t = times.time_of(message.t, now_s, message.seq)
        answer = _with_seq({"type": "ack"}, message.seq)
        if isinstance(message, Telemetry):
            outside = device.require_known(message)
            device.observe(message, t)
            self.on_values(device.name, message.values, t)
            t_us = int(t * 1e6)
            values.extend((device.name, name, t_us, value) for name, value in message.values.items())
            if outside:
                answer["outOfRange"] = outside
            kind = "telemetry"
        elif isinstance(message, StateReport):
            device.observe_state(message, t)
            kind = "state"
        else:
            self._observe_event(device, message, t)
            kind = "event"
        metrics.MESSAGES.labels(kind).inc()
        return kind, answer

    @staticmethod
    def _observe_event(device: Device, message: DeviceEvent, t: float) -> None:
        if device.event is None or t >= device.event[2]:
            device.event = (message.name, message.data, t)
            device.has_news = True

    def _end_link(self, device: Device, code: str, reason: str, *, retry: bool = False) -> None:
        link = device.link
        if link is not None:
            self.disconnect(device, link)
            link.end(code, reason, retry=retry)

    async def _replace(self, device: Device, stored: StoredDevice) -> None:
        stored = replace(stored, updated_us=int(self._clock() * 1e6))
        await self.writer.call(lambda connection: device_store.replace(connection, stored))
        device.describe(stored)
        self._changed(device)

    def _changed(self, device: Device) -> None:
        self._reports.put(device)
        self.on_changed(device)


def _with_seq(answer: dict[str, Any], seq: int | None) -> dict[str, Any]:
    if seq is not None:
        answer["seq"] = seq
    return answer


def _text(line: bytes) -> str:
    """Return a valid JSON line as text; PostgreSQL stores no NUL, which JSON can only have escaped."""
    return line.decode(errors="replace")


def _with_time(line: bytes, message: Message, now_s: float) -> str:
    """Return a valid message as one line for the centre: with the time of arrival if it has none."""
    if (isinstance(message, CommandAnswer) or message.t is not None) and b"\n" not in line:
        return _text(line)
    given = orjson.loads(line)
    if not isinstance(message, CommandAnswer) and message.t is None:
        given["t"] = now_s
    return orjson.dumps(given).decode()


def encoded(answers: Sequence[Mapping[str, Any]]) -> bytes:
    """Return answers as lines."""
    return b"".join(orjson.dumps(answer) + b"\n" for answer in answers)
