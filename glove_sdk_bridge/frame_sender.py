"""The frame sender: sends the frames of a glove to the gesture controller, and reconnects by itself.

The caller never waits. A frame that has waited for half a second is dropped and counted, because an old frame
would show a gesture that the person no longer makes.
"""

import contextlib
import random
import socket
import ssl
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Self

from glove_sdk_bridge.errors import BadLine, BridgeError, Say
from glove_sdk_bridge.frames import Frame, Hello, parse_object
from glove_sdk_bridge.lines import Lines
from glove_sdk_bridge.tls import reason_of

INITIAL_RETRY_S, MAX_RETRY_S = 0.2, 5.0
MAX_FRAME_AGE_S = 0.5
MAX_WAITING = 2048
"""The largest number of frames that wait to be sent."""

CONNECT_TIMEOUT_S = 5.0
ACK_TIMEOUT_S = 5.0
SEND_TIMEOUT_S = 2.0
MIN_STABLE_S = 5.0
"""A connection that lasted this long resets the retry delay."""

SEND_BUFFER_BYTES = 16 * 1024
"""Small, so that frames for an unresponsive controller wait here and are dropped, not in the kernel."""

_CHECK_INTERVAL_S = 0.05
_CLOSE_TIMEOUT_S = 0.5


class Refused(BridgeError):
    """The controller refuses this glove; with `lasting`, a retry would not help."""

    def __init__(self, reason: str, *, lasting: bool) -> None:
        super().__init__(reason)
        self.lasting = lasting


class FrameSender:
    """Keeps a connection during the context, with `tls` if given; `say` gets messages for a person."""

    def __init__(
        self,
        hello: Hello,
        host: str,
        port: int,
        *,
        say: Say,
        tls: ssl.SSLContext | None = None,
        chance: random.Random | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.sent = 0
        self.dropped = 0
        self.failure: Refused | None = None
        """Why the controller refuses this glove for good, if it does."""
        self._hello = hello
        self._address = (host, port)
        self._where = f"{host}:{port}"
        self._say = say
        self._tls = tls
        self._chance = chance or random.Random()  # noqa: S311 - jitter, no secret
        self._clock = clock
        self._waiting: deque[tuple[float, Frame]] = deque()
        self._changed = threading.Condition()
        self._busy = False
        self._number = 0
        self._connected = threading.Event()
        self._stopping = threading.Event()
        self._outage = False
        self._dropped_before = 0
        self._thread = threading.Thread(target=self._run, name="frame sender", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        with self._changed:
            self._changed.notify_all()
        self._thread.join(timeout=2 * _CLOSE_TIMEOUT_S)

    @property
    def connected(self) -> bool:
        """True while the controller has accepted the hello and the connection is open."""
        return self._connected.is_set()

    def send(self, frame: Frame) -> None:
        """Send `frame` soon with the next sequence number; never waits."""
        with self._changed:
            if len(self._waiting) >= MAX_WAITING:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append((self._clock(), replace(frame, seq=self._number)))
            self._number += 1
            self._changed.notify_all()

    def wait_until_connected(self, within_s: float) -> bool:
        """Wait up to `within_s` for the connection; return True if there is one."""
        return self._connected.wait(within_s)

    def finish(self, within_s: float) -> None:
        """Wait up to `within_s` until every frame has been sent or dropped."""
        with self._changed:
            self._changed.wait_for(
                lambda: (not self._waiting and not self._busy) or self.failure is not None, within_s
            )
            self.dropped += len(self._waiting)
            self._waiting.clear()

    def _run(self) -> None:
        waits = self._waits()
        while not self._stopping.is_set():
            began_s = self._clock()
            try:
                self._run_connection()
            except Refused as refused:
                if refused.lasting:
                    self._fail(refused)
                    return
                self._report_outage(str(refused))
            except OSError as error:
                self._report_outage(reason_of(error))
            finally:
                self._connected.clear()
            if self._clock() - began_s >= MIN_STABLE_S:
                waits = self._waits()
            self._wait_before_retry(next(waits))

    def _waits(self) -> Iterator[float]:
        wait_s = INITIAL_RETRY_S
        while True:
            yield wait_s * self._chance.uniform(0.5, 1.0)
            wait_s = min(2 * wait_s, MAX_RETRY_S)

    def _wait_before_retry(self, wait_s: float) -> None:
        """Wait before the next attempt, and drop old frames meanwhile."""
        until_s = time.monotonic() + wait_s
        while not self._stopping.is_set() and (left_s := until_s - time.monotonic()) > 0:
            self._stopping.wait(min(left_s, MAX_FRAME_AGE_S))
            self._drop_old()

    def _run_connection(self) -> None:
        """Connect, send hello and frames until the connection breaks (OSError, `Refused`) or stops."""
        with self._connect() as connection:
            answers = Lines()
            connection.sendall(self._hello.encode())
            self._await_ack(connection, answers)
            self._drop_old()
            self._connected.set()
            self._report_connection()
            while not self._stopping.is_set():
                self._listen(connection, answers)
                self._send_waiting(connection)
            _close(connection)

    def _connect(self) -> socket.socket:
        plain = socket.create_connection(self._address, timeout=CONNECT_TIMEOUT_S)
        try:
            _prepare(plain)
            if self._tls is None:
                return plain
            return self._tls.wrap_socket(plain, server_hostname=self._address[0])
        except BaseException:
            plain.close()
            raise

    def _await_ack(self, connection: socket.socket, answers: Lines) -> None:
        until_s = time.monotonic() + ACK_TIMEOUT_S
        while (left_s := until_s - time.monotonic()) > 0:
            connection.settimeout(left_s)
            data = connection.recv(4096)
            if not data:
                raise ConnectionResetError("it hung up on the hello")
            for answer in answers.feed(data):
                if _read(answer).get("type") == "ack":
                    return
                self._check_error(answer, is_acknowledged=False)
        raise TimeoutError(f"no answer to the hello within {ACK_TIMEOUT_S:g} s; is it a gesture controller?")

    def _listen(self, connection: socket.socket, answers: Lines) -> None:
        """Process messages of the controller without waiting."""
        connection.setblocking(False)
        try:
            while data := connection.recv(4096):
                for answer in answers.feed(data):
                    self._check_error(answer, is_acknowledged=True)
        except (BlockingIOError, ssl.SSLWantReadError):
            return
        raise ConnectionResetError("it hung up")

    def _check_error(self, answer: bytes, *, is_acknowledged: bool) -> None:
        """Raise `Refused` if `answer` is an error.

        The controller may say whether a retry helps (`retry`). Otherwise a refused hello is final, and a
        later error is retried.
        """
        words = _read(answer)
        if words.get("type") != "error":
            return
        reason = str(words.get("reason", "it gave no reason"))[:300]
        retry = words.get("retry")
        if not isinstance(retry, bool):
            retry = is_acknowledged
        raise Refused(f"{self._where} refuses {self._hello.glove}: {reason}", lasting=not retry)

    def _send_waiting(self, connection: socket.socket) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._stopping.is_set(), _CHECK_INTERVAL_S)
            self._remove_old()
            frames = [frame for _, frame in self._waiting]
            self._waiting.clear()
            self._busy = bool(frames)
        if not frames:
            return
        gone = 0
        try:
            connection.settimeout(SEND_TIMEOUT_S)
            connection.sendall(b"".join(frame.encode() for frame in frames))
            gone = len(frames)
        finally:
            with self._changed:
                self.sent += gone
                self.dropped += len(frames) - gone
                self._busy = False
                self._changed.notify_all()

    def _drop_old(self) -> None:
        with self._changed:
            self._remove_old()
            self._changed.notify_all()

    def _remove_old(self) -> None:
        oldest_s = self._clock() - MAX_FRAME_AGE_S
        while self._waiting and self._waiting[0][0] < oldest_s:
            self._waiting.popleft()
            self.dropped += 1

    def _fail(self, refused: Refused) -> None:
        with self._changed:
            self.failure = refused
            self._changed.notify_all()

    def _report_outage(self, reason: str) -> None:
        if not self._outage and not self._stopping.is_set():
            self._say(
                f"{self._where} does not take the glove's frames ({reason}); trying again until it does"
            )
        self._outage = True

    def _report_connection(self) -> None:
        lost = self.dropped - self._dropped_before
        meanwhile = f"; {lost} frames were dropped meanwhile" if lost else ""
        self._say(f"{self._hello.glove} is connected to {self._where}{meanwhile}")
        self._outage = False
        self._dropped_before = self.dropped


def _prepare(connection: socket.socket) -> None:
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(CONNECT_TIMEOUT_S * 1000))


def _close(connection: socket.socket) -> None:
    """Close so that the last frames arrive: shut down our direction, then read until the end."""
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_WR)
        connection.settimeout(_CLOSE_TIMEOUT_S)
        while connection.recv(4096):
            pass


def _read(answer: bytes) -> dict[str, Any]:
    """Return the message of the controller; empty if it is invalid."""
    try:
        return parse_object(answer)
    except BadLine:
        return {}
