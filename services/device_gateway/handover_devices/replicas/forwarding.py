"""Requests that a replica passes on to the leader, which alone knows all devices, commands and alarms.

A replica answers for its own health, and receives messages of devices (`/ingest/NAME`) as it does over TCP.
Everything else is passed on with the credentials of the caller, and the leader decides. WebSockets are passed
on as they are. One that drives a robot ends with the leader, and so the robot stops.
"""

import asyncio
import re
from collections.abc import Awaitable, Mapping
from typing import Any, Final
from urllib.parse import urlsplit

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus

from handover.errors import Problem
from handover.http.origin_guard import send_problem
from handover.http.websocket_closing import close_websocket
from handover.network.http_client import Address, SendError, StreamingHttpClient
from handover.network.tls_trust import client_context
from handover.security.guard import PUBLIC_PATHS
from handover.telemetry import get_logger
from handover_devices.gateway import DeviceGateway
from handover_devices.refusals import WrongToken
from handover_devices.replicas.following import Following
from handover_devices.settings import GatewaySettings
from handover_devices.storage.leader_store import Leader

log = get_logger(__name__)

MAX_BODY_BYTES: Final = 32 * 1024 * 1024
"""More than any route accepts."""
TIMEOUT_S: Final = 60.0
OPEN_TIMEOUT_S: Final = 3.0
MAX_WAITING_MESSAGES: Final = 4
PASSED_ON: Final = b"handover-replica"
"""The header of a request that was passed on, so that it is passed on once."""
AWAY_CODE: Final = 4502
_INGEST: Final = re.compile(r"^/ingest/([^/]+)$")
_OWN_HEADERS: Final = frozenset(
    {
        b"host", b"origin", b"connection", b"keep-alive", b"te", b"trailer", b"transfer-encoding", b"upgrade",
        b"content-length", b"expect", PASSED_ON,
    }
)  # fmt: skip


class ToLeader:
    """ASGI middleware: passes requests on to the leader while another process leads."""

    def __init__(
        self, app: ASGIApp, settings: GatewaySettings, gateway: DeviceGateway, following: Following
    ) -> None:
        self._app = app
        self._gateway = gateway
        self._following = following
        self._service = urlsplit(settings.device_gateway)
        self._has_name = settings.gateway_url is not None
        self._ca_files = settings.ca_files
        self._http = StreamingHttpClient(ca_files=settings.ca_files)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] not in {"http", "websocket"} or not self._is_for_leader(scope):
            await self._app(scope, receive, send)
            return
        try:
            leader = self._leader(dict(scope["headers"]))
            if scope["type"] == "http":
                await self._pass_on(Request(scope, receive), leader, send)
        except Problem as problem:
            if scope["type"] == "http":
                await send_problem(send, problem)
                return
            socket = WebSocket(scope, receive, send)
            await socket.accept()
            await close_websocket(socket, 4000 + problem.status, str(problem.detail))
            return
        if scope["type"] == "websocket":
            await self._pass_on_stream(WebSocket(scope, receive, send), leader)

    def _is_for_leader(self, scope: Scope) -> bool:
        if not self._following.is_active or scope["path"] in PUBLIC_PATHS:
            return False
        ingest = _INGEST.match(scope["path"])
        if ingest is None or scope["type"] == "websocket":
            return True
        scheme, _, token = dict(scope["headers"]).get(b"authorization", b"").decode("latin-1").partition(" ")
        try:
            self._gateway.with_token(ingest[1], token.strip() if scheme.lower() == "bearer" else "")
        except WrongToken:
            return True  # it may have been registered a moment ago
        return False

    def _leader(self, headers: Mapping[bytes, bytes]) -> Leader:
        leader = self._following.leader
        if leader is None or PASSED_ON in headers:
            raise _no_leader()
        return leader

    async def _pass_on(self, request: Request, leader: Leader, send: Send) -> None:
        body = bytearray()
        async for chunk in request.stream():
            body += chunk
            if len(body) > MAX_BODY_BYTES:
                raise _too_large()
        where = Address(
            leader.host,
            leader.rest_port,
            self._service.scheme == "https",
            _target(request.scope),
            self._service.netloc,
            str(self._service.hostname) if self._has_name else "",
        )
        headers = [
            (name.decode("latin-1"), value.decode("latin-1"))
            for name, value in request.headers.raw
            if name not in _OWN_HEADERS and not name.startswith(b"sec-")
        ]
        headers.append((PASSED_ON.decode(), "1"))
        try:
            response = await self._http.stream(request.method, where, headers, bytes(body), TIMEOUT_S)
        except SendError as error:
            log.warning("leader does not answer", leader=leader.host, error=str(error))
            raise _no_leader() from None
        kept = [
            (name.lower(), value)
            for name, value in response.headers
            if name.lower() not in {b"connection", b"keep-alive", b"transfer-encoding", b"server", b"date"}
        ]
        try:
            await send({"type": "http.response.start", "status": response.status, "headers": kept})
            async for chunk in response.chunks(TIMEOUT_S):
                await send({"type": "http.response.body", "body": chunk, "more_body": True})
            await send({"type": "http.response.body", "body": b"", "more_body": False})
        finally:
            response.close()

    async def _pass_on_stream(self, socket: WebSocket, leader: Leader) -> None:
        await socket.accept()
        scheme = "wss" if self._service.scheme == "https" else "ws"
        tls: dict[str, Any] = {}
        if scheme == "wss":
            tls = {
                "ssl": client_context(*self._ca_files),
                "server_hostname": self._service.hostname if self._has_name else leader.host,
            }
        headers = {PASSED_ON.decode(): "1"}
        if authorization := socket.headers.get("authorization"):
            headers["Authorization"] = authorization
        try:
            async with connect(
                f"{scheme}://{self._service.netloc}{_target(socket.scope)}",
                host=leader.host,
                port=leader.rest_port,
                additional_headers=headers,
                proxy=None,
                compression=None,
                open_timeout=OPEN_TIMEOUT_S,
                close_timeout=1.0,
                max_queue=MAX_WAITING_MESSAGES,
                **tls,
            ) as link:
                await _first_of(_to_leader(socket, link), _from_leader(socket, link))
                code, reason = link.close_code or AWAY_CODE, link.close_reason or ""
        except InvalidStatus as refused:
            code, reason = 4000 + refused.response.status_code, "the leader refused"
        except (OSError, TimeoutError, InvalidHandshake, ConnectionClosed) as error:
            log.warning("leader does not answer", leader=leader.host, error=str(error))
            code, reason = AWAY_CODE, "the gateway that leads does not answer"
        await close_websocket(socket, code, reason)


async def _first_of(*work: Awaitable[None]) -> None:
    """Run until one ends."""
    tasks = [asyncio.ensure_future(job) for job in work]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _to_leader(socket: WebSocket, link: ClientConnection) -> None:
    while (event := await socket.receive())["type"] != "websocket.disconnect":
        await link.send(event["text"] if event.get("text") is not None else event["bytes"])


async def _from_leader(socket: WebSocket, link: ClientConnection) -> None:
    async for text in link:
        await (socket.send_text(text) if isinstance(text, str) else socket.send_bytes(text))


def _target(scope: Scope) -> str:
    path: bytes = scope.get("raw_path") or scope["path"].encode()
    query: bytes = scope.get("query_string", b"")
    return (path.partition(b"?")[0] + (b"?" + query if query else b"")).decode("latin-1")


def _too_large() -> Problem:
    return Problem.translated(
        413,
        "Too large",
        "device.body_too_large",
        "a body has at most {maximum} bytes",
        maximum=MAX_BODY_BYTES,
    )


def _no_leader() -> Problem:
    return Problem.translated(
        503,
        "No leader",
        "device.no_leader",
        "no device gateway leads at the moment; another one takes over, try again in a second",
    )
