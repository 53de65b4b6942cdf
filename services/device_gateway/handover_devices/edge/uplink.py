"""The connection of an edge with the centre: outbound, with TLS, opened again whenever it ends.

A replica of the central gateway relays to the one that leads in the same way (`replicas.following`).

Messages of devices are read from the outbox in the order of their numbers and sent while at most
`MAX_UNACKNOWLEDGED_BYTES` wait for an acknowledgement; acknowledged ones are deleted. After a broken
connection the greeting of the centre says which number it has stored, and sending continues behind it.

Live messages, inputs of people and images, go past the outbox: at once, or not at all.

The connection counts as lost when nothing arrives for `SILENCE_S`: the centre answers a ping each second.
"""

import asyncio
import time
from collections import deque
from collections.abc import Mapping
from functools import partial
from secrets import token_hex
from typing import Any, Final

import orjson
from pydantic import ValidationError

from handover.errors import HandoverError, Problem, TranslatedError
from handover.network.tls_trust import handshake_fault
from handover.runtime.retry import Backoff
from handover.telemetry import get_logger
from handover_devices import metrics
from handover_devices.edge.commands import EdgeCommands, EdgeDispatcher
from handover_devices.edge.upstream import Upstream
from handover_devices.gateway import DeviceGateway
from handover_devices.model.description import DeviceDescription
from handover_devices.protocol.messages import VERSION, encode
from handover_devices.protocol.relaying import MAX_DELIVERED_BYTES
from handover_devices.storage.device_store import StoredDevice
from handover_devices.storage.outbox import MessageQueue, StoredRow

log = get_logger(__name__)

CONNECT_TIMEOUT_S: Final = 10.0
PING_S: Final = 1.0
SILENCE_S: Final = 5.0
MAX_RETRY_S: Final = 10.0
PAGE_ROWS: Final = 200
MAX_UNACKNOWLEDGED_BYTES: Final = 512 * 1024
MAX_PINGS: Final = 64
MAX_WAITING_BYTES: Final = 64 * 1024
"""Of live messages: while more waits to be written, a newer one is dropped, and does not wait behind it."""
DELETE_S: Final = 0.25
"""Acknowledged messages are deleted at most this often."""


class LinkLost(TranslatedError):
    """The connection with the centre has ended; the text says why."""


class Uplink:
    """Relays to the centre; run `run` as a task."""

    def __init__(
        self,
        upstream: Upstream,
        gateway: DeviceGateway,
        dispatcher: EdgeDispatcher,
        commands: EdgeCommands,
        outbox: MessageQueue,
        *,
        cancel_motions_after_s: float,
    ) -> None:
        self.upstream = upstream
        self.name = str(upstream.hello.get("device", ""))
        self.is_connected = False
        self.since_s: float | None = None
        """When the present state, connected or not, began; seconds since 1970."""
        self.fault: str | None = "not connected yet"
        self.round_trip_s: float | None = None
        self._cancel_after_s = cancel_motions_after_s
        self._gateway, self._commands, self._outbox = gateway, commands, outbox
        self._boot = token_hex(8)
        self._writer: asyncio.StreamWriter | None = None
        self._news = asyncio.Event()
        self._room = asyncio.Event()
        self._unacknowledged: deque[tuple[int, int]] = deque()
        self._unacknowledged_bytes = 0
        self._acknowledged = 0
        self._has_acknowledged = asyncio.Event()
        self._changes: asyncio.Queue[Mapping[str, Any]] = asyncio.Queue()
        self._pings: dict[int, float] = {}
        self._ping = 0
        self._pong: tuple[int, float] | None = None
        self._takes_live = False
        self._received_s = 0.0
        self._canceller: asyncio.TimerHandle | None = None
        gateway.writer.on_relays = self._news.set
        gateway.relay_live = self.send_live
        dispatcher.on_presence = self._presence_changed
        dispatcher.on_answer = commands.note_answer

    async def run(self) -> None:
        """Stay connected until cancelled."""
        backoff = Backoff(max_s=MAX_RETRY_S)
        while True:
            await self.try_once(backoff)
            await backoff.wait()

    async def try_once(self, backoff: Backoff) -> None:
        """Connect, and serve until the connection ends; `backoff` is reset when it was there."""
        try:
            await self._serve(backoff)
        except* (OSError, TimeoutError, asyncio.IncompleteReadError, ValueError, HandoverError) as errors:
            self._note_fault(errors)
        finally:
            self._disconnected()

    async def _serve(self, backoff: Backoff) -> None:
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            reader, writer = await asyncio.open_connection(
                self.upstream.host,
                self.upstream.port,
                ssl=self.upstream.tls,
                server_hostname=self.upstream.tls_name if self.upstream.tls else None,
                limit=MAX_DELIVERED_BYTES,
            )
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT_S):
                sent = await self._greet(reader, writer)
            self._connected(writer)
            backoff.reset()
            async with asyncio.TaskGroup() as group:
                group.create_task(self._read(reader))
                group.create_task(self._follow_registry())
                group.create_task(self._send(writer, sent))
                group.create_task(self._keep_alive(writer))
                group.create_task(self._delete())
        finally:
            writer.transport.abort()

    async def _greet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> int:
        """Send the hello; return the number up to which the centre has stored everything."""
        outbox = self._outbox
        hello = {"type": "hello", "version": VERSION, **self.upstream.hello, "boot": self._boot}
        writer.write(encode({**hello, "relay": {"stream": outbox.stream, "time": time.time()}}))
        line = await reader.readline()
        greeting = orjson.loads(line) if line else {}
        if greeting.get("type") != "ack" or "received" not in greeting:
            raise LinkLost(str(greeting.get("reason") or "the other side is no gateway that takes edges"))
        received = int(greeting["received"])
        self._takes_live = greeting.get("live") is True
        if received > await asyncio.to_thread(outbox.last):
            log.warning("the centre knows later messages than this edge: another stream begins")
            await self._gateway.writer.call(outbox.begin_stream)
            raise LinkLost("the database of this edge is older than what the centre has; connecting again")
        self._acknowledge(received)
        return received

    # What the centre sends

    async def _read(self, reader: asyncio.StreamReader) -> None:
        while line := await reader.readline():
            self._received_s = time.monotonic()
            await self._process(orjson.loads(line))
        raise LinkLost("the centre has closed the connection")

    async def _process(self, message: Mapping[str, Any]) -> None:
        kind = message.get("type")
        if kind == "ack" and "seq" in message:
            self._acknowledge(int(message["seq"]))
        elif kind == "pong":
            self._pong = message["n"], time.monotonic()
            sent_s = self._pings.get(message["n"])
            self.round_trip_s = None if sent_s is None else time.monotonic() - sent_s
        elif kind == "deliver":
            self._commands.deliver(message["device"], message["message"], self._age_s(message.get("after")))
        elif kind in ("device", "devices", "removed", "end"):
            self._changes.put_nowait(message)
        elif kind == "error":
            await self._refused(message)

    async def _follow_registry(self) -> None:
        """Take over what the centre has registered; commands do not wait for it."""
        gateway = self._gateway
        while True:
            message = await self._changes.get()
            kind = message["type"]
            if kind == "device":
                await self._mirror(message)
            elif kind == "devices":
                names = set(message["names"])
                for name in [device for device in gateway.devices if device not in names]:
                    await self.remove(name)
            elif kind == "removed" and message["name"] in gateway.devices:
                await self.remove(message["name"])
            elif kind == "end":
                gateway.end(
                    message["device"], message["code"], message["reason"], retry=bool(message["retry"])
                )

    async def mirror(self, stored: StoredDevice) -> None:
        """Take over a device."""
        await self._gateway.mirror(stored)

    async def remove(self, name: str) -> None:
        """Delete a device that is no longer relayed."""
        reason = (
            f"the centre no longer lets {self.name} relay this device; grant it again, or connect elsewhere"
        )
        self._gateway.end(name, "notGranted", reason, retry=True)
        await self._gateway.remove(name)

    async def _mirror(self, message: Mapping[str, Any]) -> None:
        try:
            description = DeviceDescription.model_validate(message["description"])
        except ValidationError as error:
            log.warning("device of the centre not understood", device=message["name"], error=str(error)[:300])
            return
        now_us = int(time.time() * 1e6)
        stored = StoredDevice(
            message["name"],
            description,
            message["tokenSha256"],
            now_us,
            now_us,
            message["certificateSha256"],
            message["certificateEndUs"],
        )
        await self.mirror(stored)

    async def _refused(self, message: Mapping[str, Any]) -> None:
        if "retry" in message:
            raise LinkLost(str(message.get("reason")))
        log.warning(
            "refused by the centre", **{name: message.get(name) for name in ("device", "code", "reason")}
        )
        if message.get("seq") is not None:
            await self._gateway.writer.call(lambda connection: self._outbox.note_refused(connection, 1))

    def _age_s(self, after: Any) -> float | None:
        """Return a bound of the age of a message; None if there is none."""
        if not after:
            return None
        number, held_s = after
        sent_s = self._pings.get(number)
        return None if sent_s is None else max(time.monotonic() - sent_s - float(held_s), 0.0)

    # What is sent to the centre

    async def _send(self, writer: asyncio.StreamWriter, sent: int) -> None:
        while True:
            self._news.clear()
            rows = await asyncio.to_thread(self._outbox.read, sent, PAGE_ROWS)
            if not rows:
                await self._news.wait()
                continue
            for row in rows:
                while self._unacknowledged_bytes >= MAX_UNACKNOWLEDGED_BYTES:
                    self._room.clear()
                    await self._room.wait()
                line = _relayed(row)
                self._unacknowledged.append((row.seq, len(line)))
                self._unacknowledged_bytes += len(line)
                writer.write(line)
                sent = row.seq
            await writer.drain()

    def _acknowledge(self, seq: int) -> None:
        """Everything up to a number is stored at the centre."""
        while self._unacknowledged and self._unacknowledged[0][0] <= seq:
            self._unacknowledged_bytes -= self._unacknowledged.popleft()[1]
        self._room.set()
        self._acknowledged = max(self._acknowledged, seq)
        self._has_acknowledged.set()

    async def _delete(self) -> None:
        while True:
            await self._has_acknowledged.wait()
            self._has_acknowledged.clear()
            seq = self._acknowledged
            try:
                await self._gateway.writer.call(partial(self._outbox.acknowledge, seq=seq))
            except Problem:
                await self._gateway.writer.call(self._outbox.count)
                raise
            await asyncio.sleep(DELETE_S)

    async def _keep_alive(self, writer: asyncio.StreamWriter) -> None:
        while True:
            self._ping += 1
            self._pings[self._ping] = time.monotonic()
            self._pings.pop(self._ping - MAX_PINGS, None)
            writer.write(encode({"type": "ping", "n": self._ping}))
            await asyncio.sleep(PING_S)
            if time.monotonic() - self._received_s > SILENCE_S:
                raise LinkLost(f"nothing arrived from the centre for {SILENCE_S:g} s")

    def send_live(self, device: str, message: Mapping[str, Any]) -> bool:
        """Send an input or image of a device at once; return False, without sending it, if it would wait."""
        writer, pong = self._writer, self._pong
        if writer is None or pong is None or not self._takes_live:
            return False
        if writer.transport.get_write_buffer_size() > MAX_WAITING_BYTES:
            return False
        after = [pong[0], round(time.monotonic() - pong[1], 4)]
        writer.write(encode({"type": "live", "device": device, "after": after, "message": message}))
        return True

    def _presence_changed(self, name: str) -> None:
        asyncio.get_running_loop().call_soon(self._send_presence, name)

    def _send_presence(self, name: str) -> None:
        """Send whether a device is connected now, if the centre can be reached."""
        if self._writer is None or name == self.name:
            return
        device = self._gateway.devices.get(name)
        if device is None or device.link is None:
            self._writer.write(encode({"type": "offline", "device": name}))
            return
        age_s = round(time.monotonic() - device.linked_s, 3)
        online = {"type": "online", "device": name, "boot": device.link.boot, "drives": device.drives}
        self._writer.write(encode({**online, "ageS": age_s}))

    # The state of the connection

    def _connected(self, writer: asyncio.StreamWriter) -> None:
        self._writer, self._received_s = writer, time.monotonic()
        self._changes = asyncio.Queue()  # the centre sends all again
        self.is_connected, self.since_s, self.fault = True, time.time(), None
        if self._canceller is not None:
            self._canceller.cancel()
            self._canceller = None
        metrics.LINK_UP.set(1)
        host, port = self.upstream.host, self.upstream.port
        log.info("connected with the centre", host=host, port=port, waiting=self._outbox.waiting)
        for device in tuple(self._gateway.devices.values()):
            if device.link is not None:
                self._send_presence(device.name)

    def _disconnected(self) -> None:
        self._writer = None
        self._unacknowledged.clear()
        self._unacknowledged_bytes = 0
        self._pings.clear()
        self._pong, self._takes_live = None, False
        self.round_trip_s = None
        self._commands.stop_driven()
        if self.is_connected:
            self.is_connected, self.since_s = False, time.time()
            metrics.LINK_UP.set(0)
            loop = asyncio.get_running_loop()
            self._canceller = loop.call_later(self._cancel_after_s, self._cancel_motions)

    def _cancel_motions(self) -> None:
        self._canceller = None
        if count := self._commands.cancel_motions():
            log.warning("motions cancelled: the centre is unreachable", motions=count)

    def _note_fault(self, errors: BaseExceptionGroup[Exception]) -> None:
        error: BaseException = errors
        while isinstance(error, BaseExceptionGroup):
            error = error.exceptions[0]
        where = f"{self.upstream.host}:{self.upstream.port}"
        fault = handshake_fault(error, where)
        reason = str(error) or type(error).__name__
        if fault is None:
            is_network = isinstance(error, OSError)  # a timeout is one
            fault = f"{where} does not answer ({reason}); check address and network" if is_network else reason
        if fault != self.fault:
            log.warning("no connection with the centre", centre=where, reason=fault)
        self.fault = fault


def _relayed(row: StoredRow) -> bytes:
    """Return a line for a message of the outbox, which is JSON already."""
    head = orjson.dumps({"type": "relay", "seq": row.seq, "device": row.device})
    return head[:-1] + b',"message":' + row.body.encode() + b"}\n"
