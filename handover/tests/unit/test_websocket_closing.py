"""The reason in the closing frame of a WebSocket."""

from collections.abc import MutableMapping
from typing import Any

import pytest
from fastapi import WebSocket

from handover.http.websocket_closing import close_websocket


@pytest.mark.parametrize(
    ("code", "reason", "shown"),
    [
        (4403, "ä" * 200, (4403, "ä" * 61)),  # 122 of the 123 bytes that a frame has room for
        (1006, "the link broke", (1011, "the link broke")),
    ],
)
async def test_a_reason_fits_its_frame_and_a_reserved_code_is_replaced(
    code: int, reason: str, shown: tuple[int, str]
) -> None:
    sent: list[MutableMapping[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "websocket.connect"}

    async def send(message: MutableMapping[str, Any]) -> None:
        sent.append(message)

    socket = WebSocket({"type": "websocket"}, receive, send)
    await socket.accept()
    await close_websocket(socket, code, reason)
    await close_websocket(socket, code, reason)  # a second time is harmless
    assert [(one["code"], one["reason"]) for one in sent[1:]] == [shown]
