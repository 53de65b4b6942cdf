"""Edges at the centre: one connection relays many devices, each of which appears as a device of its own.

An edge is a device of kind `edge` with its own token or certificate. It may relay the devices whose
description names it as their `edge`; of others nothing is accepted. What it may relay is sent to it with the
hashes of their credentials, so that it can check them on its own while the connection is broken.

Numbers of the stream make repetitions harmless: the last number is stored in the transaction of the messages,
and smaller ones are acknowledged without being stored again. Buffered messages may be older than those of a
device that is connected directly (`device_edge_max_age_h`).

Commands use the connection only while it exists: with it each relayed device is disconnected, and what
happens to a command then depends on its kind, as for every device (`commands.command`).

Live messages, inputs of people and images, are passed on if they are fresh: a connection that was interrupted
delivers late what was sent before, and no robot may move by it. An input that holds nothing may be late.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import orjson

from handover.telemetry import get_logger
from handover_devices.gateway import DeviceGateway, Respond, Session
from handover_devices.metrics import RELAYED
from handover_devices.model.description import DeviceKind
from handover_devices.protocol.messages import BadMessage, Hello, RelayHello
from handover_devices.protocol.relaying import MAX_RELAYED_BYTES, Live, Ping, Presence, Relayed, parse_relayed
from handover_devices.protocol.times import TimeRule
from handover_devices.refusals import HelloRefused
from handover_devices.registry.device import Device, Link
from handover_devices.storage.history_writer import EdgeMark

log = get_logger(__name__)

SILENCE_S: Final = 5.0
"""An edge that sends nothing for this time is disconnected: it sends a ping each second."""

MAX_LIVE_AGE_S: Final = 0.3
"""Inputs of people and images that may be older are dropped; the robot stops when no input arrives."""
MAX_PONGS: Final = 64

MIN_MESSAGES_PER_S: Final = 5_000.0
"""Buffered messages arrive at once. An edge whose pings wait behind a lower rate would count as lost."""


class RelayedLink:
    """The connection of a device through an edge."""

    def __init__(self, relay: "RelaySession", name: str) -> None:
        self.boot = ""
        self._relay = relay
        self._name = name

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message to the device, with a bound of its age."""
        self._relay.deliver(self._name, message)

    def send_latest(self, message: Mapping[str, Any]) -> bool:
        """Send a message that must not wait; return False, without sending it, if it would."""
        return self._relay.deliver_latest(self._name, message)

    def end(self, code: str, reason: str, *, retry: bool) -> None:
        """Let the edge end the connection of the device."""
        self._relay.end_device(self._name, self, code, reason, retry=retry)


class RelaySession(ABC):
    """Another gateway over one connection, after its hello was accepted; it relays devices."""

    def __init__(self, gateway: DeviceGateway, name: str, link: Link) -> None:
        self.name = name
        self.gateway = gateway
        self._link = link
        self._granted: set[str] = set()
        self._devices: dict[str, tuple[Session, RelayedLink]] = {}
        self._ping: tuple[int, float] | None = None
        self._pongs: dict[int, float] = {}
        self._is_ended = False

    @abstractmethod
    def may_relay(self, device: Device) -> bool:
        """Return whether messages of a device are accepted."""

    @abstractmethod
    def received(self) -> int:
        """Return the number of the last message that was received."""

    @abstractmethod
    def store(self, device: Device, relayed: Relayed) -> list[Mapping[str, Any]]:
        """Process a new message of a device; return the errors that answer it."""

    @abstractmethod
    def acknowledge(
        self, answers: list[Mapping[str, Any]], last: int | None, is_new: bool, respond: Respond
    ) -> None:
        """Respond once what was received up to the number `last`, now and before, is durable."""

    def begin(self) -> None:
        """Send which devices are relayed."""
        granted = [device for device in self.gateway.devices.values() if self.may_relay(device)]
        for device in granted:
            self.send_device(device)
        self._link.send({"type": "devices", "names": [device.name for device in granted]})

    def send_device(self, device: Device) -> None:
        """Send a device that may be relayed."""
        stored = device.stored
        self._granted.add(device.name)
        self._link.send(
            {
                "type": "device",
                "name": device.name,
                "description": stored.description.model_dump(
                    mode="json", by_alias=True, exclude_defaults=True
                ),
                "tokenSha256": stored.token_sha256,
                "certificateSha256": stored.certificate_sha256,
                "certificateEndUs": stored.certificate_end_us,
            }
        )

    def changed(self, device: Device) -> None:
        """A device was added or changed: it is sent, or taken back."""
        if self.may_relay(device):
            self.send_device(device)
        else:
            self.withdraw(device.name)

    def withdraw(self, name: str) -> None:
        """Take a device back, if it was sent: it was deleted, or granted to another edge."""
        if name not in self._granted:
            return
        self._granted.remove(name)
        device = self._devices.pop(name, None)
        if device is not None:
            device[0].end()
        self._link.send({"type": "removed", "name": name})

    def receive(self, lines: Sequence[bytes], respond: Respond) -> None:
        """Process lines; `respond` is called once the messages are durable."""
        answers: list[Mapping[str, Any]] = []
        before = last = self.received()
        is_relayed = False
        for line in lines:
            try:
                relayed = parse_relayed(line)
            except BadMessage as bad:
                answers.append({"type": "error", "seq": bad.seq, "code": bad.code, "reason": str(bad)})
                continue
            if isinstance(relayed, Ping):
                self._answer_ping(relayed)
            elif isinstance(relayed, Live):
                self._pass_on(relayed)
            elif isinstance(relayed, Presence):
                answers += self._note_presence(relayed)
            else:
                is_relayed = True
                if relayed.seq > last:
                    last = relayed.seq
                    answers += self._store(relayed)
                else:
                    RELAYED.labels("repeated").inc()
        if answers or is_relayed:
            self.acknowledge(answers, last if is_relayed else None, last > before, respond)

    def deliver(self, name: str, message: Mapping[str, Any]) -> None:
        """Send a message to a device."""
        self._link.send(self._delivery(name, message))

    def deliver_latest(self, name: str, message: Mapping[str, Any]) -> bool:
        """Send a message to a device unless it would wait."""
        return self._link.send_latest(self._delivery(name, message))

    def end_device(self, name: str, link: RelayedLink | None, code: str, reason: str, *, retry: bool) -> None:
        """Let the other side end the connection of a device; None for one that never had a session."""
        device = self._devices.get(name)
        if device is not None and device[1] is link:
            del self._devices[name]
        end = {"type": "end", "device": name, "code": code, "reason": reason, "retry": retry}
        self._link.send(end)

    def close(self, code: str, reason: str) -> None:
        """End the connection; the other side connects again."""
        self._link.end(code, reason, retry=True)

    def end(self) -> None:
        """The connection has ended, and with it those of all its devices."""
        if self._is_ended:
            return
        self._is_ended = True
        for session, _ in tuple(self._devices.values()):
            session.end()
        self._devices.clear()
        self.on_end()

    @abstractmethod
    def on_end(self) -> None:
        """The sessions of all devices have ended."""

    def _answer_ping(self, ping: Ping) -> None:
        self._ping = ping.n, time.monotonic()
        self._pongs[ping.n] = self._ping[1]
        if len(self._pongs) > MAX_PONGS:
            del self._pongs[next(iter(self._pongs))]
        self._link.send({"type": "pong", "n": ping.n})

    def _delivery(self, name: str, message: Mapping[str, Any]) -> dict[str, Any]:
        delivery: dict[str, Any] = {"type": "deliver", "device": name, "message": message}
        if self._ping is not None:
            number, at_s = self._ping
            delivery["after"] = [number, round(time.monotonic() - at_s, 4)]
        return delivery

    def _note_presence(self, presence: Presence) -> list[Mapping[str, Any]]:
        device = self.gateway.devices.get(presence.device)
        relayed_device = self._devices.get(presence.device)
        if presence.boot is None:
            if relayed_device is not None:
                del self._devices[presence.device]
                relayed_device[0].end()
            return []
        if device is None or device.name == self.name or not self.may_relay(device):
            return [{**self._not_granted(presence.device), "seq": None}]
        if (
            relayed_device is None
            or relayed_device[1].boot != presence.boot
            or device.link is not relayed_device[1]
        ):
            began_s = time.monotonic() - presence.age_s
            is_elsewhere = device.link is not None and (
                relayed_device is None or device.link is not relayed_device[1]
            )
            if is_elsewhere and device.linked_s > began_s:
                reason = "a younger connection of this device is open"
                self.end_device(device.name, None, "replaced", reason, retry=False)
                return []
            link = RelayedLink(self, device.name)
            session = self.gateway.attach(device.name, link, presence.boot)
            device.linked_s = began_s
            self._devices[device.name] = session, link
        device.drives = presence.drives
        return []

    def _pass_on(self, live: Live) -> None:
        """Pass on an input or image of a device that is connected through this gateway, if it is fresh."""
        relayed_device = self._devices.get(live.device)
        device = None if relayed_device is None else relayed_device[0].device
        if (
            relayed_device is None
            or device is None
            or device.link is not relayed_device[1]
            or not self.may_relay(device)
        ):
            RELAYED.labels("refused").inc()
            return
        sent_s = self._pongs.get(live.pong)
        is_fresh = sent_s is not None and time.monotonic() - sent_s - live.held_s <= MAX_LIVE_AGE_S
        if not is_fresh and live.message.get("held", True):
            RELAYED.labels("late").inc()
            return
        fault = self.gateway.pass_on(device, orjson.dumps(live.message), live.message)
        RELAYED.labels("refused" if fault else "live").inc()
        if fault is not None:
            self.deliver(live.device, fault)

    def _store(self, relayed: Relayed) -> list[Mapping[str, Any]]:
        device = self.gateway.devices.get(relayed.device)
        if device is None or not self.may_relay(device):
            RELAYED.labels("refused").inc()
            return [{**self._not_granted(relayed.device), "seq": relayed.seq}]
        errors = self.store(device, relayed)
        RELAYED.labels("refused" if errors else "stored").inc()
        return [{**error, "seq": relayed.seq, "device": relayed.device} for error in errors]

    def _not_granted(self, name: str) -> dict[str, Any]:
        reason = f'{name} was not granted to {self.name}; set "edge" in its description to this edge'
        return {"type": "error", "device": name, "code": "notGranted", "reason": reason}


class EdgeSession(RelaySession):
    """An edge; what it relays is stored here, with the number of its stream."""

    def __init__(self, relays: "EdgeRelays", session: Session, link: Link, hello: RelayHello) -> None:
        super().__init__(relays.gateway, session.device.name, link)
        self.stream = hello.stream
        self._relays = relays
        self._session = session

    def may_relay(self, device: Device) -> bool:
        """Return whether a device was granted to this edge."""
        return self.name in {device.stored.description.edge, device.name}

    def received(self) -> int:
        """Return the number of the last message of the stream that was received."""
        return self.gateway.edge_marks.received(self.name, self.stream)

    def store(self, device: Device, relayed: Relayed) -> list[Mapping[str, Any]]:
        """Store a message."""
        _, answers = self.gateway.store(device, [relayed.line], self._relays.times, MAX_RELAYED_BYTES)
        return [answer for answer in answers if answer["type"] == "error"]

    def acknowledge(
        self, answers: list[Mapping[str, Any]], last: int | None, is_new: bool, respond: Respond
    ) -> None:
        """Store the number of the stream, and respond then."""
        mark = None if last is None else EdgeMark(self.name, self.stream, last)
        stored = self.gateway.writer.add(marks=[mark] if mark is not None and is_new else [])
        if mark is not None:
            self.gateway.edge_marks.note_received(mark)
            answers.append({"type": "ack", "seq": mark.seq})

        def is_stored(_: object) -> None:
            if mark is not None:
                self.gateway.edge_marks.note_stored(mark)
            respond(answers)

        stored.add_done_callback(is_stored)

    def on_end(self) -> None:
        """The edge itself is disconnected as well."""
        if self._relays.sessions.get(self.name) is self:
            del self._relays.sessions[self.name]
        self._session.end()


class EdgeRelays:
    """The connected edges, by name."""

    def __init__(
        self, gateway: DeviceGateway, times: TimeRule, clock: Callable[[], float] = time.time
    ) -> None:
        self.gateway = gateway
        self.times = times
        self.sessions: dict[str, EdgeSession] = {}
        self._clock = clock

    def begin(self, session: Session, link: Link, hello: Hello) -> EdgeSession:
        """Begin the session of an edge; raise `HelloRefused`."""
        edge, relay = session.device, hello.relay
        assert relay is not None  # noqa: S101 - the caller has looked
        if edge.stored.description.kind is not DeviceKind.EDGE:
            raise HelloRefused(
                "noEdge", f"{edge.name} is registered as no edge; register a device of kind edge"
            )
        ahead_s = relay.time - self._clock()
        if abs(ahead_s) > self.times.max_ahead_s:
            raise HelloRefused(
                "clock",
                f"the clock of {edge.name} differs from that of the centre by {ahead_s:.0f} s, and at most "
                f"{self.times.max_ahead_s:g} s are allowed; set it (NTP). What is buffered waits",
                retry=True,
            )
        made = EdgeSession(self, session, link, relay)
        self.sessions[edge.name] = made
        log.info("edge connected", edge=edge.name, stream=relay.stream)
        return made

    def messages_per_s(self, edge: Device, of_device: float) -> float:
        """Return the rate of an edge: that of all its devices, and enough to catch up after an outage."""
        devices = self.gateway.devices.values()
        count = sum(device.stored.description.edge == edge.name for device in devices)
        return max(count * of_device, MIN_MESSAGES_PER_S)

    def changed(self, device: Device) -> None:
        """A device was added or changed: its edge gets it, and one that had it before loses it."""
        for relay in tuple(self.sessions.values()):
            relay.changed(device)

    def removed(self, name: str) -> None:
        """A device was deleted."""
        for relay in tuple(self.sessions.values()):
            relay.withdraw(name)
