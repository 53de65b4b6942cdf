"""An HTTP client of the gesture controller."""

import http.client
import json
import os
import socket
from collections.abc import Iterator
from typing import Any
from urllib.parse import quote, urlsplit

from glove_sdk_bridge.errors import BridgeError
from glove_sdk_bridge.frames import MAX_LINE_BYTES
from glove_sdk_bridge.tls import client_context, reason_of

ACCESS_TOKEN = "HANDOVER_SERVICE_TOKEN"  # noqa: S105 - the name of a setting, no secret
RESPONSE_TIMEOUT_S = 5.0
MAX_RESPONSE_BYTES = 1024 * 1024


class Unreachable(BridgeError):
    """The controller does not respond."""


class Declined(BridgeError):
    """The controller rejects a request; `status` is the HTTP status."""

    def __init__(self, message: str, status: int) -> None:
        super().__init__(message)
        self.status = status


class ControllerClient:
    """The controller at `url`, such as `http://127.0.0.1:54210`; raises `BridgeError` if that is no URL.

    Each request carries the token of `HANDOVER_SERVICE_TOKEN`, if there is one.
    """

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")
        token = os.environ.get(ACCESS_TOKEN)
        self._headers = {"Authorization": f"Bearer {token}"} if token else {}
        try:
            parts = urlsplit(self.url)
            self._host, self._port, self._path = parts.hostname or "", parts.port, parts.path
            self._secure = {"http": False, "https": True}[parts.scheme]
        except (ValueError, KeyError):
            self._host = ""
        if not self._host:
            raise BridgeError(f"{url} is no URL of a controller; give one such as http://127.0.0.1:54210")

    def glove(self, name: str) -> dict[str, Any]:
        """Return the view of a glove; raise `Unreachable` or `Declined` (404: unknown)."""
        return self._request("GET", f"/gloves/{quote(name)}")

    def calibrate(self, name: str, fist: list[list[float]], open_hand: list[list[float]]) -> dict[str, Any]:
        """Calibrate a glove from frames of a fist and an open hand; return the result.

        Raises `Unreachable` or `Declined`.
        """
        return self._request("POST", f"/gloves/{quote(name)}/calibration", {"fist": fist, "open": open_hand})

    def lines(self, name: str) -> Iterator[bytes]:
        """Yield the lines of a glove, hello first, until the connection ends; blocks between two lines.

        Raises `Unreachable` or `Declined` before the first line only.
        """
        connection = self._connection()
        try:
            try:
                connection.request("GET", f"{self._path}/gloves/{quote(name)}/frames", headers=self._headers)
                raw_socket = connection.sock
                answer = connection.getresponse()
                if answer.status >= http.client.BAD_REQUEST:
                    raise self._declined(answer.status, answer.read(MAX_RESPONSE_BYTES))
                _disable_timeout(raw_socket)
            except (OSError, http.client.HTTPException) as error:
                raise self._unreachable(error) from None
            try:
                while text := answer.readline(MAX_LINE_BYTES + 1):
                    yield text
            except (OSError, http.client.HTTPException):
                return
        finally:
            connection.close()

    def _request(self, method: str, path: str, body: object = None) -> dict[str, Any]:
        connection = self._connection()
        try:
            body_text = None if body is None else json.dumps(body)
            headers = {"Content-Type": "application/json", **self._headers}
            connection.request(method, self._path + path, body_text, headers)
            answer = connection.getresponse()
            status, text = answer.status, answer.read(MAX_RESPONSE_BYTES)
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
        if not self._secure:
            return http.client.HTTPConnection(self._host, self._port, timeout=RESPONSE_TIMEOUT_S)
        return http.client.HTTPSConnection(
            self._host, self._port, timeout=RESPONSE_TIMEOUT_S, context=client_context()
        )

    def _unreachable(self, error: Exception) -> Unreachable:
        words = reason_of(error) if isinstance(error, OSError) else str(error) or type(error).__name__
        return Unreachable(f"the controller at {self.url} does not answer ({words}); is it running?")

    def _declined(self, status: int, text: bytes) -> Declined:
        detail = (_object(text) or {}).get("detail")
        return Declined(str(detail) if detail else f"{self.url} answers with status {status}", status)


def _disable_timeout(connection: socket.socket | None) -> None:
    """Remove the timeout: a glove that is switched off sends nothing for a long time."""
    if connection is not None:
        connection.settimeout(None)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)


def _object(text: bytes) -> dict[str, Any] | None:
    try:
        said = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return said if isinstance(said, dict) else None
