"""Closes a WebSocket with a reason that its closing frame has room for."""

from contextlib import suppress
from typing import Final

from fastapi import WebSocket
from starlette.websockets import WebSocketDisconnect

MAX_REASON_BYTES: Final = 123  # RFC 6455, 5.5
INTERNAL_ERROR: Final = 1011
_OPEN_CODES: Final = range(3000, 5000)
"""The codes that are not reserved for the protocol itself."""


async def close_websocket(socket: WebSocket, code: int, reason: str) -> None:
    """Close a socket that may be closed already; a reserved code, as another link may have, becomes 1011."""
    shown = reason.encode()[:MAX_REASON_BYTES].decode(errors="ignore")
    with suppress(RuntimeError, WebSocketDisconnect):
        await socket.close(code if code in _OPEN_CODES else INTERNAL_ERROR, shown)
