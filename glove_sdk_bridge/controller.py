"""The gesture controller as its screen and its recorder see it: over HTTP."""

import http.client
import json
import socket
from collections.abc import Iterator
from typing import Any
from urllib.parse import quote, urlsplit

from glove_sdk_bridge.errors import BridgeError
from glove_sdk_bridge.frames import MAX_LINE_BYTES

ANSWER_WITHIN_S = 5.0
LARGEST_ANSWER_BYTES = 1024 * 1024


class Unreachable(BridgeError):
    """The controller does not answer at the moment."""


class Declined(BridgeError):
    """The controller answers that it cannot do this; `status` is that of HTTP."""

    def __init__(self, message: str, status: int) -> None:
        super().__init__(message)
        self.status = status


class Controller:
    """The controller at `url`, such as `http://127.0.0.1:54210`; raises `BridgeError` if that is no URL."""

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")
        try:
            parts = urlsplit(self.url)
            self._host, self._port, self._path = parts.hostname or "", parts.port, parts.path
            self._secure = {"http": False, "https": True}[parts.scheme]
        except (ValueError, KeyError):
            self._host = ""
        if not self._host:
            raise BridgeError(f"{url} is no URL of a controller; give one such as http://127.0.0.1:54210")

    def glove(self, name: str) -> dict[str, Any]:
        """Return what the screen shows for a glove; raise `Unreachable` or `Declined` (404: not known)."""
        return self._ask("GET", f"/gloves/{quote(name)}")

    def calibrate(self, name: str, fist: list[list[float]], open_hand: list[list[float]]) -> dict[str, Any]:
        """Have thresholds made from frames of a fist and an open hand, and return what was made.

        Raises `Unreachable` or `Declined`.
        """
        return self._ask("POST", f"/gloves/{quote(name)}/calibration", {"fist": fist, "open": open_hand})

    def lines(self, name: str) -> Iterator[bytes]:
        """Yield what a glove sends, hello first, until the connection ends; may block between two lines.

        Raises `Unreachable` or `Declined` before the first line only.
        """
        connection = self._connection()
        try:
            try:
                connection.request("GET", f"{self._path}/gloves/{quote(name)}/frames")
                line = connection.sock
                answer = connection.getresponse()
                if answer.status >= http.client.BAD_REQUEST:
                    raise self._declined(answer.status, answer.read(LARGEST_ANSWER_BYTES))
                _wait_for_ever(line)
            except (OSError, http.client.HTTPException) as error:
                raise self._unreachable(error) from None
            try:
                while text := answer.readline(MAX_LINE_BYTES + 1):
                    yield text
            except (OSError, http.client.HTTPException):
                return
        finally:
            connection.close()

    def _ask(self, method: str, path: str, body: object = None) -> dict[str, Any]:
        connection = self._connection()
        try:
            given = None if body is None else json.dumps(body)
            connection.request(method, self._path + path, given, {"Content-Type": "application/json"})
            answer = connection.getresponse()
            status, text = answer.status, answer.read(LARGEST_ANSWER_BYTES)
        except (OSError, http.client.HTTPException) as error:
            raise self._unreachable(error) from None
        finally:
            connection.close()
        if status >= http.client.BAD_REQUEST:
            raise self._declined(status, text)
        said = _object(text)
        if said is None:
            raise Declined(f"{self.url} answers, but not as a gesture controller does", status)
        return said

    def _connection(self) -> http.client.HTTPConnection:
        kind = http.client.HTTPSConnection if self._secure else http.client.HTTPConnection
        return kind(self._host, self._port, timeout=ANSWER_WITHIN_S)

    def _unreachable(self, error: Exception) -> Unreachable:
        words = getattr(error, "strerror", None) or str(error) or type(error).__name__
        return Unreachable(f"the controller at {self.url} does not answer ({words}); is it running?")

    def _declined(self, status: int, text: bytes) -> Declined:
        detail = (_object(text) or {}).get("detail")
        return Declined(str(detail) if detail else f"{self.url} answers with status {status}", status)


def _wait_for_ever(line: socket.socket | None) -> None:
    """Let reads last: a hand at rest, or a glove that is switched off, sends nothing for a long time."""
    if line is not None:
        line.settimeout(None)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)


def _object(text: bytes) -> dict[str, Any] | None:
    try:
        said = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return said if isinstance(said, dict) else None
