"""The link: carries the frames of a glove to the gesture controller, and mends itself.

Whoever has frames never waits for it. A frame that has waited half a second is dropped and counted: a
stale hand is worse than none, for it would show what the person has long ceased to do.
"""

import contextlib
import random
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Self

from glove_sdk_bridge.errors import BadLine, BridgeError, Say
from glove_sdk_bridge.frames import Frame, Hello, parse_object
from glove_sdk_bridge.lines import Lines

FIRST_WAIT_S, LAST_WAIT_S = 0.2, 5.0
STALE_S = 0.5
MOST_WAITING = 2048
"""Frames kept at most, however quickly they come."""

CONNECT_WITHIN_S = 5.0
ACK_WITHIN_S = 5.0
SEND_WITHIN_S = 2.0
SETTLED_S = 5.0
"""A connection that lasted so long was a good one: the next wait is short again."""

SEND_BUFFER_BYTES = 16 * 1024
"""Small, so that frames for a dead controller grow old here, where they are dropped, not in the system."""

_LOOK_EVERY_S = 0.05
_PART_WITHIN_S = 0.5


class Refused(BridgeError):
    """The controller does not want this glove; `lasting` when trying again would not help."""

    def __init__(self, reason: str, *, lasting: bool) -> None:
        super().__init__(reason)
        self.lasting = lasting


class Link:
    """A connection that is held while the context lasts; `say` gets a line when a person should know."""

    def __init__(
        self,
        hello: Hello,
        host: str,
        port: int,
        *,
        say: Say,
        chance: random.Random | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.sent = 0
        self.dropped = 0
        self.failure: Refused | None = None
        """Why the controller does not want this glove, once it has said so."""
        self._hello = hello
        self._address = (host, port)
        self._where = f"{host}:{port}"
        self._say = say
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
        self._thread = threading.Thread(target=self._run, name="glove link", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        with self._changed:
            self._changed.notify_all()
        self._thread.join(timeout=2 * _PART_WITHIN_S)

    @property
    def connected(self) -> bool:
        """Say whether the controller has welcomed the glove and is still there."""
        return self._connected.is_set()

    def send(self, frame: Frame) -> None:
        """Take `frame`, give it the next number, and send it soon; never waits."""
        with self._changed:
            if len(self._waiting) >= MOST_WAITING:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append((self._clock(), replace(frame, seq=self._number)))
            self._number += 1
            self._changed.notify_all()

    def wait_until_connected(self, within_s: float) -> bool:
        """Wait until the glove is welcome, `within_s` at most; return whether it is."""
        return self._connected.wait(within_s)

    def finish(self, within_s: float) -> None:
        """Wait until every frame has been sent or dropped, `within_s` at most."""
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
                self._hold()
            except Refused as refused:
                if refused.lasting:
                    self._fail(refused)
                    return
                self._tell_outage(str(refused))
            except OSError as error:
                self._tell_outage(error.strerror or str(error) or type(error).__name__)
            finally:
                self._connected.clear()
            if self._clock() - began_s >= SETTLED_S:
                waits = self._waits()
            self._rest(next(waits))

    def _waits(self) -> Iterator[float]:
        wait_s = FIRST_WAIT_S
        while True:
            yield wait_s * self._chance.uniform(0.5, 1.0)
            wait_s = min(2 * wait_s, LAST_WAIT_S)

    def _rest(self, wait_s: float) -> None:
        """Wait before the next try; what grows stale meanwhile is dropped."""
        until_s = time.monotonic() + wait_s
        while not self._stopping.is_set() and (left_s := until_s - time.monotonic()) > 0:
            self._stopping.wait(min(left_s, STALE_S))
            self._drop_stale()

    def _hold(self) -> None:
        """Connect, say hello and send frames until the link breaks (OSError, `Refused`) or is to stop."""
        with socket.create_connection(self._address, timeout=CONNECT_WITHIN_S) as line:
            _prepare(line)
            answers = Lines()
            line.sendall(self._hello.encode())
            self._await_welcome(line, answers)
            self._drop_stale()
            self._connected.set()
            self._tell_connection()
            while not self._stopping.is_set():
                self._listen(line, answers)
                self._send_waiting(line)
            _part(line)

    def _await_welcome(self, line: socket.socket, answers: Lines) -> None:
        until_s = time.monotonic() + ACK_WITHIN_S
        while (left_s := until_s - time.monotonic()) > 0:
            line.settimeout(left_s)
            data = line.recv(4096)
            if not data:
                raise ConnectionResetError("it hung up on the hello")
            for answer in answers.feed(data):
                if _read(answer).get("type") == "ack":
                    return
                self._heed(answer, welcome=False)
        raise TimeoutError(f"no answer to the hello within {ACK_WITHIN_S:g} s; is it a gesture controller?")

    def _listen(self, line: socket.socket, answers: Lines) -> None:
        """Take what the controller says, without waiting for it."""
        line.setblocking(False)
        try:
            while data := line.recv(4096):
                for answer in answers.feed(data):
                    self._heed(answer, welcome=True)
        except BlockingIOError:
            return
        raise ConnectionResetError("it hung up")

    def _heed(self, answer: bytes, *, welcome: bool) -> None:
        """Raise `Refused` if the controller says that something is wrong.

        It may say itself whether trying again helps (`retry`); otherwise a hello that is refused is refused
        for good, while what goes wrong later is worth another try.
        """
        words = _read(answer)
        if words.get("type") != "error":
            return
        reason = str(words.get("reason", "it gave no reason"))[:300]
        retry = words.get("retry")
        if not isinstance(retry, bool):
            retry = welcome
        raise Refused(f"{self._where} refuses {self._hello.glove}: {reason}", lasting=not retry)

    def _send_waiting(self, line: socket.socket) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._stopping.is_set(), _LOOK_EVERY_S)
            self._forget_stale()
            frames = [frame for _, frame in self._waiting]
            self._waiting.clear()
            self._busy = bool(frames)
        if not frames:
            return
        gone = 0
        try:
            line.settimeout(SEND_WITHIN_S)
            line.sendall(b"".join(frame.encode() for frame in frames))
            gone = len(frames)
        finally:
            with self._changed:
                self.sent += gone
                self.dropped += len(frames) - gone
                self._busy = False
                self._changed.notify_all()

    def _drop_stale(self) -> None:
        with self._changed:
            self._forget_stale()
            self._changed.notify_all()

    def _forget_stale(self) -> None:
        oldest_s = self._clock() - STALE_S
        while self._waiting and self._waiting[0][0] < oldest_s:
            self._waiting.popleft()
            self.dropped += 1

    def _fail(self, refused: Refused) -> None:
        with self._changed:
            self.failure = refused
            self._changed.notify_all()

    def _tell_outage(self, reason: str) -> None:
        if not self._outage and not self._stopping.is_set():
            self._say(
                f"{self._where} does not take the glove's frames ({reason}); trying again until it does"
            )
        self._outage = True

    def _tell_connection(self) -> None:
        lost = self.dropped - self._dropped_before
        meanwhile = f"; {lost} frames were dropped meanwhile" if lost else ""
        self._say(f"{self._hello.glove} is connected to {self._where}{meanwhile}")
        self._outage = False
        self._dropped_before = self.dropped


def _prepare(line: socket.socket) -> None:
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    line.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(CONNECT_WITHIN_S * 1000))


def _part(line: socket.socket) -> None:
    """Hang up so that the last frames arrive: close our half, and hear the other side out."""
    with contextlib.suppress(OSError):
        line.shutdown(socket.SHUT_WR)
        line.settimeout(_PART_WITHIN_S)
        while line.recv(4096):
            pass


def _read(answer: bytes) -> dict[str, Any]:
    """Return what the controller said; nothing, if it makes no sense."""
    try:
        return parse_object(answer)
    except BadLine:
        return {}
