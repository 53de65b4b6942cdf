"""The dispatcher: sends commands to devices and follows them to their end.

A command is durable before it is sent: after `kill -9` the gateway knows each command that a device may have
received. One for a device that is connected is written once, as sent. `next_step` decides what happens to
each; a task asks it several times a second, and at once when a device connects. No command waits for the
writing of another one: the history writer writes them together, and those of a device are sent in their
order, since who waits for the same writing continues in the order of waiting.
"""

import asyncio
from collections import OrderedDict, defaultdict
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final, Protocol
from uuid import uuid4

import orjson
from sqlalchemy import Engine

from handover.messages import message
from handover.runtime.clocks import SteadyTime
from handover.security.audit_trail import current_request
from handover.telemetry import get_logger
from handover_devices import metrics
from handover_devices.commands.command import OPEN, Command, CommandState, Sent, Step, answered, next_step
from handover_devices.commands.forms import cancel_message, command_message, command_of, row_of
from handover_devices.commands.problems import (
    device_away,
    edge_away,
    id_taken,
    no_command,
    no_longer_leading,
    require_valid,
    too_many_commands,
    unknown_command,
)
from handover_devices.model.description import CANCEL, CommandKind, DeviceDescription
from handover_devices.protocol.messages import AnswerState, CommandAnswer
from handover_devices.storage import device_store
from handover_devices.storage.history_writer import HistoryWriter, MessageRow

log = get_logger(__name__)

TICK_S: Final = 0.2
ACK_TIMEOUT_S: Final = 2.0
"""A command without an answer for this time is sent again, if its kind allows it."""
MAX_OPEN: Final = 64
"""Open commands of one device."""
MAX_ENDED: Final = 2_000
"""Ended commands that are kept in memory; the database has all."""
CANCEL_TIMEOUT_S: Final = 10.0
CANCEL_WRITE_TIMEOUT_S: Final = 2.0


class CommandLink(Protocol):
    """The connection of a device; `boot` is the run of its program."""

    boot: str

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message."""


class _Open:
    """A command with what is not stored: how it was sent, and who waits for it."""

    def __init__(self, command: Command) -> None:
        self.command = command
        self.sent = Sent()
        self.is_cancelling = False
        self.is_busy = False
        self.is_lost = False
        """Whether another process leads since, which has it if it was written."""
        self.changed = asyncio.Event()
        self.written: asyncio.Future[None] | None = None
        """Done when the command is durable for the first time; None for one that was read."""

    def change(self, command: Command) -> bool:
        """Replace the command; return whether it differs."""
        if command == self.command:
            return False
        self.command = command
        self.changed.set()
        self.changed = asyncio.Event()
        return True


class Dispatcher:
    """All open commands; run `run` as a task. `clock` is the time since 1970."""

    def __init__(
        self,
        engine: Engine,
        writer: HistoryWriter,
        ack_timeout_s: float = ACK_TIMEOUT_S,
        clock: Callable[[], float] | None = None,
    ) -> None:
        self._engine = engine
        self._writer = writer
        self._ack_timeout_s = ack_timeout_s
        # A deadline is a span of time: a wall clock that is set must not let all commands expire at once.
        self._clock = SteadyTime() if clock is None else clock
        self._links: dict[str, CommandLink] = {}
        self._open: defaultdict[str, dict[str, _Open]] = defaultdict(dict)
        self._ended: OrderedDict[tuple[str, str], _Open] = OrderedDict()
        self._wake = asyncio.Event()

    async def load(self) -> None:
        """Read the open commands of an earlier run, or of another process."""
        self.clear()
        for row in await asyncio.to_thread(device_store.commands, self._engine, OPEN):
            self._open[row.device][row.id] = _Open(command_of(row))
        # A device that connects again repeats the ends of its commands.
        for row in await asyncio.to_thread(device_store.last_commands, self._engine, MAX_ENDED):
            if row.id not in self._open[row.device]:
                self._ended[row.device, row.id] = _Open(command_of(row))

    def clear(self) -> None:
        """Forget everything: another process leads."""
        for opened in self._open.values():
            for pending in opened.values():
                pending.is_lost = True
        self._open.clear()
        self._ended.clear()
        self._links.clear()

    async def run(self) -> None:
        """Process open commands until cancelled."""
        async with asyncio.TaskGroup() as steps:
            while True:
                for opened in self._open.values():
                    for pending in opened.values():
                        step = Step.WAIT if pending.is_busy else self._next_step(pending)
                        if step is not Step.WAIT:
                            pending.is_busy = True
                            steps.create_task(self._proceed(pending, step))
                try:
                    async with asyncio.timeout(TICK_S if any(self._open.values()) else None):
                        await self._wake.wait()
                except TimeoutError:
                    pass
                self._wake.clear()

    def connect(self, device: str, link: CommandLink) -> None:
        """Send commands of `device` over `link` from now on."""
        self._links[device] = link
        for pending in self._open[device].values():
            pending.sent = Sent()
        self._wake.set()

    def disconnect(self, device: str, link: CommandLink) -> None:
        """Stop using `link`, unless a newer one has replaced it."""
        if self._links.get(device) is link:
            del self._links[device]

    async def order(
        self,
        device: str,
        description: DeviceDescription,
        name: str,
        parameters: Mapping[str, Any],
        *,
        timeout_s: float,
        identifier: str | None = None,
    ) -> Command:
        """Accept a command; it is durable when this returns. The same id again returns the same command.

        Raises `Problem`: 404 for a command that the device does not take, 422 for wrong parameters, 409 for a
        motion while the device is away and for an id with other content, 429 for too many open commands.
        """
        specification = description.command(name)
        if specification is None:
            raise unknown_command(device, name, description)
        require_valid(name, parameters, specification.parameters)
        known_one = await self._known(device, identifier, name, parameters) if identifier else None
        if known_one is not None:
            return known_one
        identifier = identifier or uuid4().hex
        if len(self._open[device]) >= MAX_OPEN:
            raise too_many_commands(device, MAX_OPEN)
        now_s = self._clock()
        link = self._links.get(device)
        if link is None and specification.kind is CommandKind.MOTION:
            if description.edge is not None and description.edge not in self._links:
                raise edge_away(device, name, description.edge)
            raise device_away(device, name)
        command = Command(
            device, identifier, name, specification.kind, dict(parameters), now_s, now_s + timeout_s
        )
        pending = _Open(command.sent_to(link.boot) if link is not None else command)
        pending.is_busy = True
        self._open[device][identifier] = pending
        logged = [] if link is None else [self._logged(pending.command)]
        pending.written = self._writer.add(
            messages=logged, commands=[row_of(pending.command)], requested=current_request()
        )
        try:
            await asyncio.shield(pending.written)
            if pending.is_lost:
                raise no_longer_leading()
            if specification.kind is CommandKind.MOTION and link is not None:
                self._send_motion(pending, link)
        finally:
            pending.is_busy = False
        self._wake.set()
        return pending.command

    async def _known(
        self, device: str, identifier: str, name: str, parameters: Mapping[str, Any]
    ) -> Command | None:
        """Return the durable command with this id; raise `Problem` 409 if it is another one."""
        stored = await self._find(device, identifier)
        pending = self._open[device].get(identifier)  # the same id may have come while the database was asked
        present = pending.command if pending is not None else stored
        if present is None:
            return None
        if (present.name, dict(present.parameters)) != (name, dict(parameters)):
            raise id_taken(identifier)
        if pending is None:
            return present
        if pending.written is not None:
            await asyncio.shield(pending.written)
        return pending.command

    async def cancel(self, device: str, identifier: str) -> Command:
        """Cancel a command: one that was not sent ends at once, another one when the device answers."""
        pending = self._open[device].get(identifier)
        if pending is None:
            stored = await self._find(device, identifier)
            if stored is None:
                raise no_command(device, identifier)
            return stored
        if (
            pending.command.state is CommandState.QUEUED
            and pending.command.boot is None
            and not pending.is_busy
        ):
            pending.change(pending.command.ended(CommandState.CANCELLED, "cancelled before it was sent"))
            written = self._writer.add(commands=[row_of(pending.command)])
            self._close_if_ended(pending)
            # It is cancelled, and is not sent: a database that does not answer must not keep that back.
            await asyncio.wait({written}, timeout=CANCEL_WRITE_TIMEOUT_S)
        elif not pending.is_cancelling:
            self._cancel_sent(pending)
        return pending.command

    def answer(self, device: str, answer: CommandAnswer) -> bool:
        """Process an answer of a device; return whether it concerns a command of this device."""
        pending = self._open[device].get(answer.id) or self._ended.get((device, answer.id))
        if pending is None:
            return answer.id.endswith(f":{CANCEL}")
        if not pending.command.is_open and answer.state in {AnswerState.ACCEPTED, AnswerState.RUNNING}:
            self._cancel_late(pending.command)
        elif pending.change(answered(pending.command, answer, is_cancelling=pending.is_cancelling)):
            self._writer.add(commands=[row_of(pending.command)])
            self._close_if_ended(pending)
        return True

    async def find(self, device: str, identifier: str) -> Command:
        """Return a command; raise `Problem` 404."""
        command = await self._find(device, identifier)
        if command is None:
            raise no_command(device, identifier)
        return command

    async def wait(self, device: str, identifier: str, since: Command, timeout_s: float) -> Command:
        """Return the command when it differs from `since` or has ended, at the latest after `timeout_s`."""
        pending = self._open[device].get(identifier) or self._ended.get((device, identifier))
        if pending is None:
            return await self.find(device, identifier)
        try:
            async with asyncio.timeout(timeout_s):
                while pending.command.is_open and pending.command == since:
                    await pending.changed.wait()
        except TimeoutError:
            pass
        return pending.command

    def forget(self, device: str) -> None:
        """Forget the commands of a device that was deleted."""
        for pending in self._open.pop(device, {}).values():
            pending.change(pending.command.ended(CommandState.CANCELLED, "the device was deleted"))

    def _next_step(self, pending: _Open) -> Step:
        link = self._links.get(pending.command.device)
        boot = link.boot if link else None
        return next_step(pending.command, self._clock(), boot, pending.sent, self._ack_timeout_s)

    async def _proceed(self, pending: _Open, step: Step) -> None:
        """Carry out a step; the command is busy until then."""
        try:
            await self._carry_out(pending, step)
        finally:
            pending.is_busy = False

    async def _carry_out(self, pending: _Open, step: Step) -> None:
        command = pending.command
        link = self._links.get(command.device)
        if step is Step.EXPIRE:
            if command.boot is not None and link is not None and not pending.is_cancelling:
                link.send(cancel_message(command))
            reason = (
                message("device.command_never_connected", "the device did not connect before the deadline")
                if command.boot is None
                else message(
                    "device.command_no_end",
                    "the device reported no end before the deadline; what it did is unknown",
                )
            )
            await self._end(pending, CommandState.EXPIRED, reason)
        elif step is Step.GIVE_UP:
            reason = message(
                "device.command_restarted",
                "the device started again; whether it executed the command is unknown",
            )
            if command.boot is None:
                reason = message("device.command_not_sent", "the gateway stopped before it sent the motion")
            await self._end(pending, CommandState.UNKNOWN if command.boot else CommandState.FAILED, reason)
        elif step is Step.SEND and link is not None:
            if command.boot != link.boot:
                pending.change(command.sent_to(link.boot))
                await self._write(pending.command, messages=[self._logged(pending.command)])
            if self._links.get(command.device) is link and pending.command.is_open:
                now_s = self._clock()
                pending.sent = Sent(pending.sent.times + 1, now_s)
                link.send(command_message(pending.command, now_s))

    def _send_motion(self, pending: _Open, link: CommandLink) -> None:
        """Send a motion once, if the connection that it was accepted for still exists.

        One that was cancelled, or is too late, when it is stored at last, is not sent.
        """
        if pending.is_cancelling:
            pending.change(pending.command.ended(CommandState.CANCELLED, "cancelled before it was sent"))
            self._writer.add(commands=[row_of(pending.command)])
            self._close_if_ended(pending)
            return
        if self._clock() >= pending.command.deadline_s:
            late = message(
                "device.command_too_late", "it was stored after its deadline; the motion was not sent"
            )
            pending.change(pending.command.ended(CommandState.FAILED, late))
            self._writer.add(commands=[row_of(pending.command)])
            self._close_if_ended(pending)
            return
        if self._links.get(pending.command.device) is link:
            pending.sent = Sent(1, self._clock())
            link.send(command_message(pending.command, self._clock()))
            return
        reason = message("device.command_disconnected", "the device disconnected; the motion was not sent")
        pending.change(pending.command.ended(CommandState.FAILED, reason))
        self._writer.add(commands=[row_of(pending.command)])
        self._close_if_ended(pending)

    def _cancel_late(self, command: Command) -> None:
        """Cancel a command that has been given up, and that the device works on."""
        link = self._links.get(command.device)
        if link is not None and command.state is not CommandState.DONE:
            log.warning("a command that was given up is active", device=command.device, command=command.id)
            link.send(cancel_message(command))

    def _cancel_sent(self, pending: _Open) -> None:
        pending.is_cancelling = True
        link = self._links.get(pending.command.device)
        if link is not None:
            link.send(cancel_message(pending.command))
        deadline_s = min(pending.command.deadline_s, self._clock() + CANCEL_TIMEOUT_S)
        pending.command = replace(pending.command, deadline_s=deadline_s)
        self._writer.add(commands=[row_of(pending.command)])

    async def _end(self, pending: _Open, state: CommandState, reason: str) -> None:
        pending.change(pending.command.ended(state, reason))
        await self._write(pending.command)
        self._close_if_ended(pending)

    def _close_if_ended(self, pending: _Open) -> None:
        command = pending.command
        if command.is_open or self._open[command.device].pop(command.id, None) is None:
            return
        metrics.COMMANDS.labels(command.state.value).inc()
        log.info("command ended", device=command.device, command=command.id, state=command.state.value)
        self._ended[command.device, command.id] = pending
        while len(self._ended) > MAX_ENDED:
            self._ended.popitem(last=False)

    async def _write(self, command: Command, messages: list[MessageRow] | None = None) -> None:
        await asyncio.shield(self._writer.add(messages=messages or [], commands=[row_of(command)]))

    def _logged(self, command: Command) -> MessageRow:
        now_s = self._clock()
        body = orjson.dumps(command_message(command, now_s)).decode()
        return MessageRow(command.device, int(now_s * 1e6), "out", "command", body, None)

    async def _find(self, device: str, identifier: str) -> Command | None:
        pending = self._open[device].get(identifier) or self._ended.get((device, identifier))
        if pending is not None:
            return pending.command
        row = await asyncio.to_thread(device_store.command, self._engine, device, identifier)
        return None if row is None else command_of(row)
