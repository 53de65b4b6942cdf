"""A client of the device gateway in one file, with the standard library only: copy it onto any computer.

    from device_client import DeviceClient

    client = DeviceClient("gateway.local", 54010, "hall-1", token)

    @client.command("setInterval")
    def set_interval(parameters, run):
        ...
        return {"seconds": parameters["seconds"]}

    client.start()
    client.send({"temperature": 21.5})

Or without a program: `python -m device_client --host gateway.local --device hall-1` sends each line of the
standard input, a JSON object of values, and prints commands. The token is in HANDOVER_DEVICE_TOKEN.

How it works: one thread connects again and again, with growing delays. Messages wait in memory until the
gateway has acknowledged them, and are sent again after a broken connection; the gateway stores a value once
for each time. Each command runs in a thread of its own, and its id is remembered: a command that arrives
again gets its last answer and is not executed again.
"""

from __future__ import annotations  # robots run old versions of Python

import argparse
import base64
import contextlib
import json
import os
import random
import secrets
import selectors
import socket
import ssl
import sys
import threading
import time
from collections import OrderedDict
from typing import Any, Callable, Dict, Mapping, Optional

VERSION = 1
MAX_WAITING = 50_000
"""Messages that wait for an acknowledgement; beyond it the oldest are dropped."""
MAX_REMEMBERED = 1_000
"""Commands whose last answer is remembered."""
MAX_LINE_BYTES = 64 * 1024
MAX_IMAGE_CHARS = 60 * 1024
"""Of base64 in one line; a multiple of four, so that each part can be decoded on its own."""
KEEP_ALIVE_S = 15.0
SEND_TIMEOUT_S = 15.0
"""A connection that takes no bytes for so long is broken."""
DEAD_S = 60.0
"""A connection on which nothing arrives for so long, though an answer is due, is broken."""
MIN_DELAY_S, MAX_DELAY_S = 0.2, 15.0


Message = Dict[str, Any]
Command = Callable[[Message, "Run"], Optional[Mapping[str, Any]]]


class Refused(Exception):  # noqa: N818 - named for what happened
    """The gateway refused the device, and connecting again does not help."""


class Run:
    """One execution of a command: `is_cancelled` says that it must stop; `progress` reports from 0 to 1."""

    def __init__(self, client: DeviceClient, identifier: str) -> None:
        self.id = identifier
        self.cancelled = threading.Event()
        self._client = client

    @property
    def is_cancelled(self) -> bool:
        """Return whether the gateway asked to stop."""
        return self.cancelled.is_set()

    def progress(self, fraction: float) -> None:
        """Report how much is done."""
        done = min(max(fraction, 0.0), 1.0)
        self._client.answer(self.id, {"type": "ack", "state": "running", "progress": done})


class DeviceClient:
    """A device; `on_state` is called with True and False as the connection comes and goes."""

    def __init__(
        self,
        host: str,
        port: int,
        device: str,
        token: str = "",
        *,
        tls: ssl.SSLContext | None = None,
        on_state: Callable[[bool], object] | None = None,
    ) -> None:
        self.address = (host, port)
        self.device = device
        self.boot = secrets.token_hex(8)
        self.refused: str | None = None
        self.dropped = 0
        self._token = token
        self._tls = tls
        self._on_state = on_state or (lambda _: None)
        self._commands: dict[str, Command] = {}
        self._drive: Callable[[Message | None], object] | None = None
        self._motion: tuple[Message, float] | None = None
        self._has_motion = threading.Event()
        self._runs: dict[str, Run] = {}
        self._answers: OrderedDict[str, Message] = OrderedDict()
        self._waiting: OrderedDict[int, Message] = OrderedDict()
        self._seq = 0
        self._inputs = 0
        self._images = 0
        self._connection: _Connection | None = None
        self._lock = threading.RLock()
        self._stopped = threading.Event()
        self._chance = random.Random()  # noqa: S311 - not that of the program, which may have a seed
        self._thread: threading.Thread | None = None

    def command(self, name: str) -> Callable[[Command], Command]:
        """Register a function(parameters, run) for a command; it returns a dict or None. A decorator."""

        def registered(function: Command) -> Command:
            self._commands[name] = function
            return function

        return registered

    def drive(self, function: Callable[[Message | None], object]) -> Callable[[Message | None], object]:
        """Register a function that moves the robot while a person drives it. A decorator.

        It gets each message with velocities, `base` (x, y in m/s, rz in rad/s) or `joints` (rad/s by name),
        and None when the robot must stop: the person has released the control, or no message has arrived in
        time. It is called by a thread of its own and must not block. A robot that walks goes to its stand.
        """
        self._drive = function
        return function

    def rests(self, data: Mapping[str, Any] | None = None) -> None:
        """Say that the robot has come to rest after it was driven."""
        with self._lock:
            seq = self._motion[0].get("seq") if self._motion is not None else None
        self.event("rest", dict(data or {}, seq=seq))

    def start(self) -> None:
        """Connect in the background."""
        if self._drive is not None:
            watch, drive = self._watch_motion, self._drive
            threading.Thread(target=watch, args=(drive,), name=f"drive {self.device}", daemon=True).start()
        self._thread = threading.Thread(target=self.run, name=f"device {self.device}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Disconnect; what was not acknowledged is lost."""
        self._stopped.set()
        with self._lock:
            self._break_off()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(5)

    def send(self, values: Mapping[str, float], t: float | None = None) -> None:
        """Send values by name; `t` is the time in seconds since 1970, now by default."""
        self._post({"type": "telemetry", "t": time.time() if t is None else t, "values": values})

    def state(self, state: str, battery_level: float | None = None) -> None:
        """Send the state: ok, idle, busy, paused, charging, outOfBattery, forMaintenance or error."""
        message: Message = {"type": "state", "t": time.time(), "state": state}
        if battery_level is not None:
            message["batteryLevel"] = battery_level
        self._post(message)

    def event(self, name: str, data: Any = None) -> None:
        """Send an event."""
        self._post({"type": "event", "t": time.time(), "name": name, "data": data})

    def human_input(self, axes: Mapping[str, float], held: bool, gripper: str | None = None) -> None:
        """Send what a person does with an input device: its axes by name, and whether the dead-man is held.

        Send it 20 times a second or more: without it the robot stops after 0.1 s. It is neither acknowledged
        nor sent again; while the device is away it is dropped. `gripper` is open or close.
        """
        with self._lock:
            self._inputs += 1
            message: Message = {"type": "human_input", "seq": self._inputs, "held": held, "axes": dict(axes)}
            if gripper is not None:
                message["gripper"] = gripper
            self._write(message)

    def image(self, content: bytes) -> None:
        """Send an image of a camera, PNG, JPEG or WebP, of at most 512 KiB; people see the newest one.

        It is neither acknowledged, nor stored, nor sent again; while the device is away it is dropped.
        """
        data = base64.b64encode(content).decode()
        pieces = [data[at : at + MAX_IMAGE_CHARS] for at in range(0, len(data), MAX_IMAGE_CHARS)]
        with self._lock:
            self._images += 1
            for part, piece in enumerate(pieces):
                message: Message = {"type": "image", "data": piece}
                if len(pieces) > 1:
                    message.update(frame=self._images, part=part, parts=len(pieces))
                self._write(message)

    def waiting(self) -> int:
        """Return how many messages have not been acknowledged."""
        with self._lock:
            return len(self._waiting)

    def run(self) -> None:
        """Stay connected until `stop`, or until the gateway refuses the device."""
        delay_s = MIN_DELAY_S
        while not self._stopped.is_set():
            began_s = time.monotonic()
            try:
                self._stay_connected()
            except Refused as error:
                self.refused = str(error)
                return
            except (OSError, ValueError):  # broken, or no answer of a gateway
                pass
            if time.monotonic() - began_s > MAX_DELAY_S:
                delay_s = MIN_DELAY_S
            self._stopped.wait(delay_s * self._chance.uniform(0.8, 1.2))
            delay_s = min(delay_s * 2, MAX_DELAY_S)

    def answer(self, identifier: str, answer: Message) -> None:
        """Send an answer to a command, and remember it for when the command arrives again."""
        with self._lock:
            answer = dict(answer, id=identifier)
            self._answers[identifier] = answer
            self._answers.move_to_end(identifier)
            while len(self._answers) > MAX_REMEMBERED:
                self._answers.popitem(last=False)
            self._write(answer)

    def _stay_connected(self) -> None:
        connection = _Connection(self.address, self._tls)
        was_connected = False
        try:
            lines = _Lines(connection)
            hello: Message = {
                "type": "hello",
                "version": VERSION,
                "device": self.device,
                "token": self._token,
            }
            hello.update(boot=self.boot, takes=sorted(self._commands))
            if self._drive is not None:
                hello["drives"] = True
            connection.sendall(_line(hello))
            self._check(lines.next(10.0))
            with self._lock:
                self._connection, was_connected = connection, True
                for message in list(self._waiting.values()):
                    self._write(message)
                for answer in list(self._answers.values()):
                    if answer.get("state", "done") == "done":  # the end may have been lost
                        self._write(answer)
            self._on_state(True)
            self._read(lines)
        finally:
            with self._lock:
                self._connection = None
            connection.close()
            if was_connected:
                self._on_state(False)

    def _read(self, lines: _Lines) -> None:
        received_s = time.monotonic()
        while not self._stopped.is_set():
            message = lines.next(KEEP_ALIVE_S)
            if message is None:
                if self.waiting() and time.monotonic() - received_s > DEAD_S:
                    raise OSError("the gateway does not answer")
                with self._lock:
                    self._write_bytes(b"\n")
                continue
            received_s = time.monotonic()
            self._process(message)

    def _process(self, message: Message) -> None:
        kind = message.get("type")
        if kind in ("ack", "error") and "seq" in message:
            with self._lock:  # a refused message would be refused again
                self._waiting.pop(message["seq"], None)
        if kind == "error":
            print(f"device gateway: {message.get('reason')}", file=sys.stderr)
            self._check(message if "retry" in message else None)
        if kind == "command":
            self._process_command(message)
        if kind == "drive":
            with self._lock:
                self._motion = message, time.monotonic()
            self._has_motion.set()

    def _watch_motion(self, drive: Callable[[Message | None], object]) -> None:
        """Pass on the newest velocities, and None once when they are no longer valid."""
        moves, done = False, -1.0
        while not self._stopped.is_set():
            with self._lock:
                message, at_s = self._motion or ({"held": False}, 0.0)
            left_s = at_s + float(message.get("validS", 0.0)) - time.monotonic()
            if message["held"] and left_s > 0:
                if at_s != done:
                    moves, done = True, at_s
                    drive(message)
            elif moves:
                moves = False
                drive(None)
            self._has_motion.wait(left_s if moves and left_s > 0 else 1.0)
            self._has_motion.clear()
        if moves:
            drive(None)

    def _process_command(self, message: Message) -> None:
        identifier, parameters = message["id"], message.get("parameters") or {}
        if message["name"] == "cancel":
            run = self._runs.get(str(parameters.get("id")))
            if run is not None:
                run.cancelled.set()
            return
        with self._lock:
            earlier = self._answers.get(identifier)
            if earlier is not None:
                self._write(earlier)
                return
            function = self._commands.get(message["name"])
            if function is None:
                self.answer(identifier, {"type": "error", "reason": f"unknown command {message['name']}"})
                return
            self.answer(identifier, {"type": "ack", "state": "accepted"})
            run = self._runs[identifier] = Run(self, identifier)
        threading.Thread(target=self._execute, args=(function, parameters, run), daemon=True).start()

    def _execute(self, function: Command, parameters: Message, run: Run) -> None:
        try:
            result = function(parameters, run) or {}
            answer = {"type": "ack", "state": "done", "result": result}
            if run.is_cancelled:
                answer = {"type": "error", "reason": "stopped"}
        except Exception as error:
            answer = {"type": "error", "reason": f"{type(error).__name__}: {error}"}
        self._runs.pop(run.id, None)
        self.answer(run.id, answer)

    def _post(self, message: Message) -> None:
        with self._lock:
            self._seq += 1
            message["seq"] = self._seq
            if len(_line(message)) > MAX_LINE_BYTES:
                raise ValueError(f"a message has at most {MAX_LINE_BYTES} bytes; send less at once")
            self._waiting[self._seq] = message
            if len(self._waiting) > MAX_WAITING:
                self._waiting.popitem(last=False)
                self.dropped += 1
            self._write(message)

    def _write(self, message: Message) -> None:
        self._write_bytes(_line(message))

    def _write_bytes(self, data: bytes) -> None:
        if self._connection is not None:
            try:
                self._connection.sendall(data)
            except OSError:  # the reading thread connects again
                self._break_off()

    def _break_off(self) -> None:
        """End the connection; the reading thread alone closes it.

        A socket that is closed while a thread reads frees its number, and that thread would read from
        whatever is opened next.
        """
        if self._connection is not None:
            self._connection.shutdown()
            self._connection = None

    @staticmethod
    def _check(message: Message | None) -> None:
        if message is not None and message.get("type") == "error":
            if not message.get("retry"):
                raise Refused(message.get("reason", "refused"))
            raise OSError(message.get("reason", "refused"))


class _Connection:
    """A connection that one thread reads while others write, with TLS or without.

    OpenSSL forbids the use of one connection by two threads at once, even if one only reads and one only
    writes. So the socket never blocks: a lock is held for each operation, and not while a thread waits.
    """

    def __init__(self, address: tuple[str, int], tls: ssl.SSLContext | None) -> None:
        self._socket = socket.create_connection(address, timeout=10)
        self._lock = threading.Lock()
        try:
            if tls is not None:
                self._socket = tls.wrap_socket(self._socket, server_hostname=address[0])
            self._socket.setblocking(False)
        except BaseException:
            self._socket.close()
            raise

    def receive(self, timeout_s: float) -> bytes | None:
        """Return bytes, none at the end of the connection; None if none arrive in time."""
        ends_s = time.monotonic() + timeout_s
        while True:
            try:
                with self._lock:
                    return self._socket.recv(65536)
            except (ssl.SSLWantReadError, BlockingIOError):
                events = selectors.EVENT_READ
            except ssl.SSLWantWriteError:
                events = selectors.EVENT_WRITE
            if not self._wait(events, ends_s):
                return None

    def sendall(self, data: bytes) -> None:
        """Send bytes; raise OSError if the other side takes none for `SEND_TIMEOUT_S`."""
        rest = memoryview(data)
        ends_s = time.monotonic() + SEND_TIMEOUT_S
        while rest:
            try:
                with self._lock:
                    sent = self._socket.send(rest)
            except (ssl.SSLWantWriteError, BlockingIOError):
                events = selectors.EVENT_WRITE
            except ssl.SSLWantReadError:
                events = selectors.EVENT_READ
            else:
                rest = rest[sent:]
                ends_s = time.monotonic() + SEND_TIMEOUT_S
                continue
            if not self._wait(events, ends_s):
                raise OSError("the gateway reads nothing")

    def shutdown(self) -> None:
        """End the connection in both directions; a thread that waits for bytes finds the end."""
        with self._lock, contextlib.suppress(OSError):
            socket.socket.shutdown(self._socket, socket.SHUT_RDWR)  # the TLS object stays as it is

    def close(self) -> None:
        """Close the socket."""
        with self._lock:
            self._socket.close()

    def _wait(self, events: int, ends_s: float) -> bool:
        """Wait until the socket is ready; return False if the time is over before."""
        with selectors.DefaultSelector() as selector:
            selector.register(self._socket, events)
            return bool(selector.select(max(ends_s - time.monotonic(), 0.0)))


class _Lines:
    """The messages that arrive over a connection."""

    def __init__(self, connection: _Connection) -> None:
        self._connection = connection
        self._rest = b""

    def next(self, timeout_s: float) -> Message | None:
        """Return the next message; None if none arrives in time. Raises OSError at the end."""
        while b"\n" not in self._rest:
            data = self._connection.receive(timeout_s)
            if data is None:
                return None
            if not data:
                raise OSError("the gateway closed the connection")
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        message: Message = json.loads(line)
        return message


def _line(message: Message) -> bytes:
    return json.dumps(message, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def tls_context(
    ca: str | None = None, certificate: str | None = None, key: str | None = None
) -> ssl.SSLContext:
    """Return a TLS context that verifies the gateway by `ca`, else by the authorities of the system.

    `certificate` and `key` are the files of the device's certificate, which replaces its token.
    """
    context = ssl.create_default_context(cafile=ca)
    if certificate is not None:
        context.load_cert_chain(certificate, key)
    return context


def main() -> None:
    """Send each line of the standard input, and print commands."""
    parser = argparse.ArgumentParser(description="Send values to the device gateway, a JSON object a line.")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=54010)
    parser.add_argument("--device", required=True)
    parser.add_argument("--tls", action="store_true", help="connect with TLS")
    parser.add_argument("--ca", help="PEM file of the authority that signed the gateway's certificate")
    parser.add_argument("--certificate", help="PEM file of the device's certificate, instead of a token")
    parser.add_argument("--key", help="PEM file of its private key")
    parser.add_argument("--takes", action="append", default=[], help="a command to print and confirm")
    options = parser.parse_args()
    token = os.environ.get("HANDOVER_DEVICE_TOKEN", "")
    if not token and not options.certificate:
        parser.error(
            "set HANDOVER_DEVICE_TOKEN to the token of the device, or name its --certificate and --key"
        )
    has_tls = options.tls or options.ca or options.certificate
    tls = tls_context(options.ca, options.certificate, options.key) if has_tls else None
    client = DeviceClient(options.host, options.port, options.device, token, tls=tls)
    for name in options.takes:

        def printed(parameters: Message, _: Run, name: str = name) -> None:
            print(json.dumps({"command": name, "parameters": parameters}), flush=True)

        client.command(name)(printed)
    client.start()
    for line in sys.stdin:
        if client.refused:
            break
        try:
            client.send(json.loads(line))
        except ValueError as error:
            print(f"not sent: {error}", file=sys.stderr)
    while client.waiting() and not client.refused:
        time.sleep(0.05)
    if client.refused:
        sys.exit(f"refused: {client.refused}")
    client.stop()


if __name__ == "__main__":
    main()
