"""The gateway: the connections of registered devices, and what becomes of each message.

Transports (TCP, HTTP) turn bytes into lines and pass them to a `Session`; everything else is here, once.

A message is answered after it is durable, and the answers of a connection have the order of its messages.
A second connection with the same device and a valid token replaces the first: after a broken network a robot
comes back long before its old connection is found dead. The replaced one gets `retry: false`, so that two
programs with one token do not take turns for ever.
"""

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence
from secrets import token_hex
from typing import Any, Final, Protocol

import orjson
from sqlalchemy import Engine

from handover.telemetry import get_logger
from handover_devices import metrics
from handover_devices.commands.dispatcher import Dispatcher
from handover_devices.protocol.live import INPUT, ImagePart, live_message, parse_image
from handover_devices.protocol.messages import (
    MAX_LINE_BYTES,
    BadMessage,
    CommandAnswer,
    DeviceEvent,
    Hello,
    Message,
    StateReport,
    Telemetry,
    parse_message,
)
from handover_devices.protocol.times import TimeRule
from handover_devices.refusals import HelloRefused, WrongCertificate, WrongToken
from handover_devices.registry.device import Device, Link
from handover_devices.registry.edge_marks import EdgeMarks
from handover_devices.registry.registry import DeviceRegistry
from handover_devices.storage import device_store
from handover_devices.storage.history_writer import HistoryWriter, MessageRow
from handover_devices.storage.outbox import RelayRow

log = get_logger(__name__)

MAX_LOGGED: Final = 1_000
"""Characters of a refused line in the log of messages."""

Respond = Callable[[Sequence[Mapping[str, Any]]], None]


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


class DeviceGateway(DeviceRegistry):
    """All devices, their connections and their messages; call `load` first."""

    def __init__(  # noqa: PLR0917 - wired once, by `app`
        self,
        engine: Engine,
        writer: HistoryWriter,
        dispatcher: Dispatcher,
        reports: Reports,
        times: TimeRule,
        clock: Callable[[], float] = time.time,
    ) -> None:
        super().__init__(engine, writer, clock)
        self.dispatcher = dispatcher
        self.reports = reports
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
        self.is_shared = engine.dialect.name == "postgresql"
        """Whether other processes may use the database: replicas of this gateway."""
        self._times = times

    async def load(self) -> None:
        """Read the devices, their latest values and their open commands."""
        await self.load_devices()
        await self.read_edge_marks()
        await self.dispatcher.load()
        for device in self.devices.values():
            if device.link is not None:
                self.dispatcher.connect(device.name, device.link)

    async def read_edge_marks(self) -> None:
        """Read what is stored of the edges."""
        self.edge_marks.merge(await asyncio.to_thread(device_store.edge_marks, self._engine))

    # Connections

    def connect(self, hello: Hello, link: Link, certificate_sha256: str = "") -> Session:
        """Accept a connection; raise `HelloRefused`. An earlier connection of the device is replaced.

        `certificate_sha256` is the fingerprint of the client certificate, empty without one. It counts only
        if the hello has no token.
        """
        device = self.authenticated(hello, certificate_sha256)
        session = self._begin(device, hello.boot, link)
        device.drives = hello.drives
        return session

    def authenticated(self, hello: Hello, certificate_sha256: str = "") -> Device:
        """Return the device of a hello, as for `connect`; raise `HelloRefused`."""
        try:
            if hello.token or not certificate_sha256:
                return self.with_token(hello.device, hello.token)
            return self.with_certificate(hello.device, certificate_sha256)
        except (WrongToken, WrongCertificate) as wrong:
            # An edge may not know yet a device that was registered at the centre a moment ago.
            raise HelloRefused(wrong.code, str(wrong), retry=self.writer.outbox is not None) from None

    def attach(self, name: str, link: Link, boot: str = "") -> Session:
        """Begin the session of a device that an adapter has identified by other means than a token.

        Raises `Problem` 404.
        """
        return self._begin(self.device(name), boot, link)

    def _begin(self, device: Device, boot: str, link: Link) -> Session:
        if device.link is not None:
            log.warning("connection replaced", device=device.name)
            self._end_link(device, "replaced", "another connection of this device has replaced this one")
        device.link, device.linked_s = link, time.monotonic()
        device.seen_at = self._clock()
        device.has_news = True
        link.boot = boot or f"connection-{token_hex(8)}"
        metrics.CONNECTED.inc()
        self.reports.put(device)
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
            self.reports.put(device)
            self.on_disconnected(device.name)
            log.info("device disconnected", device=device.name)

    def end(self, name: str, code: str, reason: str, *, retry: bool) -> None:
        """End the connection of a device, if it has one."""
        device = self.devices.get(name)
        if device is not None:
            self._end_link(device, code, reason, retry=retry)

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
                metrics.MESSAGES.labels(kind).inc()
                if answer is not None:
                    answers.append(answer)
                messages.append(MessageRow(device.name, now_us, "in", kind, _text(line), None))
                if self.writer.outbox is not None:
                    relays.append(RelayRow(device.name, now_us, _with_time(line, message, now_s)))
        self.reports.put(device)
        return self.writer.add(messages=messages, values=values, relays=relays), answers

    def observe(self, device: Device, line: bytes, times: TimeRule, max_bytes: int) -> str | None:
        """Apply a message that another process has stored; return why it is refused, if it is."""
        device.seen_at = now_s = self._clock()
        try:
            self._accept(device, parse_message(line, max_bytes), times=times, now_s=now_s, values=[])
        except BadMessage as bad:
            return str(bad)
        self.reports.put(device)
        return None

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

    def _note_change(self, device: Device) -> None:
        self.reports.put(device)
        super()._note_change(device)

    def _forget(self, device: Device) -> None:
        self.reports.forget(device.name)
        self.dispatcher.forget(device.name)
        self.edge_marks.forget(device.name)


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
    fields = orjson.loads(line)
    if not isinstance(message, CommandAnswer) and message.t is None:
        fields["t"] = now_s
    return orjson.dumps(fields).decode()


def encoded(answers: Sequence[Mapping[str, Any]]) -> bytes:
    """Return answers as lines."""
    return b"".join(orjson.dumps(answer) + b"\n" for answer in answers)
