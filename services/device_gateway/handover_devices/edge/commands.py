"""Commands at an edge: passed on at once or not at all.

Nothing that comes from the centre waits here. A command is passed on if its device is connected, its deadline
has not passed, and, for a motion, it is fresh: a connection that was interrupted delivers late what was sent
before, and a robot must not move then. The age is bounded without comparing clocks (`protocol.relaying`).
A motion that is not passed on is answered as failed. Others are left to the centre, which repeats or ends
them (`commands.command`).

Velocities of a person who drives (`driving`) are valid for a moment. If no newer one has arrived by then, or
if the connection with the centre ends, the robot gets the message to stop from here.
"""

import asyncio
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import orjson
from sqlalchemy import Engine

from handover.messages import Message, message, with_code
from handover.telemetry import get_logger
from handover_devices.commands.dispatcher import CommandLink, Dispatcher
from handover_devices.gateway import DeviceGateway
from handover_devices.metrics import EDGE_COMMANDS
from handover_devices.model.description import CANCEL, CommandKind
from handover_devices.protocol.messages import CommandAnswer
from handover_devices.registry.device import Device, Link
from handover_devices.storage.history_writer import HistoryWriter
from handover_devices.storage.outbox import RelayRow

log = get_logger(__name__)

MAX_DRIVE_DELAY_S: Final = 0.3
"""Velocities of a person that took longer are not passed on."""
MAX_OPEN_MOTIONS: Final = 10_000


class EdgeDispatcher(Dispatcher):
    """Replaces the dispatcher of a gateway: commands come from the centre, and so do their ids."""

    def __init__(self, engine: Engine, writer: HistoryWriter) -> None:
        super().__init__(engine, writer, ack_timeout_s=1.0)
        self.on_presence: Callable[[str], None] = lambda _: None
        """Called with a device that has connected or disconnected."""
        self.on_answer: Callable[[str, CommandAnswer], None] = lambda *_: None

    async def load(self) -> None:
        """Read nothing: the centre has the commands."""

    def connect(self, device: str, link: CommandLink) -> None:  # noqa: ARG002
        """Note that a device has connected."""
        self.on_presence(device)

    def disconnect(self, device: str, link: CommandLink) -> None:  # noqa: ARG002
        """Note that a device has disconnected."""
        self.on_presence(device)

    def answer(self, device: str, answer: CommandAnswer) -> bool:
        """Accept an answer; the centre knows whether there is such a command."""
        self.on_answer(device, answer)
        return True

    def forget(self, device: str) -> None:
        """Forget nothing: nothing is kept of a device."""


class EdgeCommands:
    """Passes on what comes from the centre. `now` is a monotonic clock, `clock` the time since 1970."""

    def __init__(
        self,
        gateway: DeviceGateway,
        max_motion_delay_s: float,
        *,
        is_replica: bool = False,
        now: Callable[[], float] = time.monotonic,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._gateway = gateway
        self._max_motion_delay_s = max_motion_delay_s
        self._is_replica = is_replica
        self._now = now
        self._clock = clock
        self._motions: dict[tuple[str, str], Link] = {}
        self._driven: dict[str, tuple[Link, int, asyncio.TimerHandle]] = {}

    def deliver(self, name: str, message: Mapping[str, Any], age_s: float | None) -> None:
        """Pass on a message that is not older than `age_s`, None if its age is not known."""
        device = self._gateway.devices.get(name)
        if device is None:
            return
        kind = message.get("type")
        if kind == "drive":
            self._drive(device, message, age_s)
        elif kind == "command":
            self._command(device, message, age_s)
        elif device.link is not None:
            device.link.send(message)

    def note_answer(self, device: str, answer: CommandAnswer) -> None:
        """Note the end of a motion."""
        if answer.state is None or answer.state.value == "done":
            self._motions.pop((device, answer.id), None)

    def stop_driven(self) -> None:
        """The connection with the centre has ended: stop every robot that a person drives."""
        for name in tuple(self._driven):
            self._stop(name)

    def cancel_motions(self) -> int:
        """Ask the devices to end the motions that run; return how many."""
        motions, self._motions = self._motions, {}
        for (name, identifier), link in motions.items():
            device = self._gateway.devices.get(name)
            if device is not None and device.link is not None and device.link.boot == link.boot:
                cancel = {"id": f"{identifier}:{CANCEL}", "name": CANCEL, "parameters": {"id": identifier}}
                device.link.send({"type": "command", **cancel})
                EDGE_COMMANDS.labels("cancelled").inc()
        return len(motions)

    def _command(self, device: Device, message: Mapping[str, Any], age_s: float | None) -> None:
        name, identifier = str(message.get("name")), str(message.get("id"))
        link = device.link
        if name == CANCEL:
            if link is not None:
                link.send(message)
            return
        specification = device.stored.description.command(name)
        is_motion = specification is None or specification.kind is CommandKind.MOTION
        reason = self._reason_against(device, message, age_s, is_motion)
        if reason is not None or link is None:
            EDGE_COMMANDS.labels("refused").inc()
            log.warning("command not passed on", device=device.name, command=identifier, reason=reason)
            if is_motion and reason is not None:
                self._fail(device, identifier, reason)
            return
        if is_motion and len(self._motions) < MAX_OPEN_MOTIONS:
            self._motions[device.name, identifier] = link
        link.send(message)
        EDGE_COMMANDS.labels("passedOn").inc()

    def _reason_against(
        self, device: Device, request: Mapping[str, Any], age_s: float | None, is_motion: bool
    ) -> Message | None:
        refused = _replica_refusals if self._is_replica else _edge_refusals
        age = "?" if age_s is None else f"{age_s:.1f}"
        away, too_late, old = refused(device.name, age, f"{self._max_motion_delay_s:g}")
        if device.link is None:
            return away
        remaining_s = request.get("remaining", 0.0)
        if age_s is not None and isinstance(remaining_s, int | float) and age_s >= remaining_s:
            return too_late
        if is_motion and (age_s is None or age_s > self._max_motion_delay_s):
            return old
        return None

    def _fail(self, device: Device, identifier: str, reason: str) -> None:
        body = orjson.dumps({"type": "error", "id": identifier, **with_code("reason", reason)}).decode()
        self._gateway.writer.add(relays=[RelayRow(device.name, int(self._clock() * 1e6), body)])

    def _drive(self, device: Device, message: Mapping[str, Any], age_s: float | None) -> None:
        link = device.link
        seq, valid_s = int(message.get("seq", 0)), float(message.get("validS", 0.0))
        if not message.get("held"):
            self._forget_driven(device.name)
            if link is not None:
                link.send(message)
            return
        if link is None or age_s is None or age_s > MAX_DRIVE_DELAY_S or not link.send_latest(message):
            EDGE_COMMANDS.labels("velocityDropped").inc()
            return
        self._forget_driven(device.name)
        timer = asyncio.get_running_loop().call_later(valid_s, self._stop, device.name)
        self._driven[device.name] = link, seq, timer

    def _stop(self, name: str) -> None:
        link, seq, timer = self._driven.pop(name)
        timer.cancel()
        EDGE_COMMANDS.labels("stopped").inc()
        link.send({"type": "drive", "seq": seq, "held": False, "validS": 0.0})

    def _forget_driven(self, name: str) -> None:
        driven = self._driven.pop(name, None)
        if driven is not None:
            driven[2].cancel()


def _edge_refusals(device: str, age: str, allowed: str) -> tuple[Message, Message, Message]:
    """Return why an edge does not pass a command on: device away, after its deadline, a motion too old."""
    return (
        message(
            "device.edge_device_away",
            "{device} is not connected to the edge; the command was not passed on",
            device=device,
        ),
        message(
            "device.edge_too_late", "the command reached the edge after its deadline, and was not passed on"
        ),
        message(
            "device.edge_motion_late",
            "the motion reached the edge up to {age} s after it was sent, and was not passed on: the "
            "connection with the centre is slow or was interrupted, and at most {allowed} s are allowed "
            "(HANDOVER_EDGE_MAX_MOTION_DELAY_S). Send it again",
            age=age,
            allowed=allowed,
        ),
    )


def _replica_refusals(device: str, age: str, allowed: str) -> tuple[Message, Message, Message]:
    """Return why a replica of the gateway does not pass a command of the leader on, in the same order."""
    return (
        message(
            "device.replica_device_away",
            "{device} is not connected to this replica of the gateway any more; the command was not passed "
            "on",
            device=device,
        ),
        message(
            "device.replica_too_late",
            "the command reached the replica of the gateway after its deadline, and was not passed on",
        ),
        message(
            "device.replica_motion_late",
            "the motion reached the replica of the gateway up to {age} s after it was sent, and was not "
            "passed on: the connection between the replicas is slow or was interrupted, and at most "
            "{allowed} s are allowed (HANDOVER_EDGE_MAX_MOTION_DELAY_S). Send it again",
            age=age,
            allowed=allowed,
        ),
    )
