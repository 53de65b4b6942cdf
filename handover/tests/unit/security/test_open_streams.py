"""Streams that are open end when their caller may not have them any more."""

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI, WebSocket
from fastapi.responses import StreamingResponse
from starlette.requests import HTTPConnection

from handover.security import revocations as module
from handover.security.access_tokens import SigningKey, key_set
from handover.security.caller import Caller, CallerKind
from handover.security.guard import Guard, in_path, require, require_by_request
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.permissions import Grant, Permission, Role
from handover.security.revocations import FollowedRevocations
from handover.security.secret_tokens import new_token
from handover.serving.service import create_app
from handover.settings import Settings

KEY = SigningKey.generate()
UR10 = "urn:ngsi-ld:Device:demo:ur10-1"
BOUND_S = 60.0


def of_role(connection: HTTPConnection) -> Permission:
    return Permission.MOVE_ROBOTS if "helper" in connection.query_params else Permission.READ


class Lamp:
    """An application with streams, and what `accounts` says about its callers."""

    def __init__(self, folder: Path, *, has_accounts: bool = True) -> None:
        self._security = folder / "security"
        self._security.mkdir()
        if has_accounts:
            self.set_up_accounts()
        self.revocations = FollowedRevocations()
        self.revocations.apply({"position": 1, "revoked": []})
        self.introspection: dict[str, Any] = {"active": False}
        guard = Guard(
            Settings(data_dir=folder, _env_file=None),
            "lamp",
            revocations=self.revocations,
            introspect=self.introspect,
        )
        self.app: FastAPI = create_app("lamp", description="A lamp.", guard=guard)
        of_robot = in_path("Device", "robot")

        @self.app.websocket("/robots/{robot}/state", dependencies=[require(Permission.READ, of_robot)])
        @self.app.websocket("/robots/{robot}/jog", dependencies=[require(Permission.MOVE_ROBOTS, of_robot)])
        @self.app.websocket(
            "/robots/{robot}/walk",
            dependencies=[require_by_request(of_role, of_robot, least=Permission.READ, shown="")],
        )
        async def stream(socket: WebSocket, robot: str) -> None:
            await socket.accept()
            while True:
                await socket.send_text(await socket.receive_text())

        @self.app.get("/lines", dependencies=[require(Permission.READ)])
        async def lines() -> StreamingResponse:
            return StreamingResponse(self._lines())

    def set_up_accounts(self) -> None:
        (self._security / PUBLIC_KEYS_FILE).write_bytes(key_set(KEY))

    async def _lines(self) -> AsyncIterator[bytes]:
        while True:
            yield b"line\n"
            await asyncio.sleep(0.01)

    async def introspect(self, _: str) -> Mapping[str, Any]:
        return self.introspection

    def revoke(self, name: str) -> None:
        position = self.revocations.position + 1
        self.revocations.apply({"position": position, "revoked": [[position, name]]})

    @asynccontextmanager
    async def open(self, path: str, token: str | None, kind: str = "websocket") -> AsyncIterator["Opened"]:
        incoming: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        sent: asyncio.Queue[Any] = asyncio.Queue()
        credentials = [] if token is None else [(b"authorization", f"Bearer {token}".encode())]
        scope = {
            "type": kind,
            "path": path.partition("?")[0],
            "raw_path": path.partition("?")[0].encode(),
            "root_path": "",
            "query_string": path.partition("?")[2].encode(),
            "headers": [(b"host", b"localhost"), *credentials],
            "client": ("127.0.0.1", 5),
            "scheme": "ws" if kind == "websocket" else "http",
            "method": "GET",
            "http_version": "1.1",
            "subprotocols": [],
            "asgi": {"version": "3.0"},
        }
        serving = asyncio.create_task(self.app(scope, incoming.get, sent.put))
        if kind == "websocket":
            await incoming.put({"type": "websocket.connect"})
        try:
            yield Opened(incoming, sent, serving)
        finally:
            if not serving.done():
                await incoming.put({"type": f"{kind}.disconnect"})
            async with asyncio.timeout(BOUND_S):
                await asyncio.gather(serving, return_exceptions=True)


@dataclass
class Opened:
    """One connection, as its client sees it."""

    incoming: asyncio.Queue[dict[str, Any]]
    sent: asyncio.Queue[Any]
    serving: asyncio.Task[None]

    async def until(self, kind: str) -> dict[str, Any]:
        async with asyncio.timeout(BOUND_S):
            while (message := await self.sent.get())["type"] != kind:
                pass
        return dict(message)

    async def echoes(self) -> None:
        await self.incoming.put({"type": "websocket.receive", "text": "still there"})
        assert (await self.until("websocket.send"))["text"] == "still there"


@pytest.fixture
def lamp(tmp_path: Path) -> Lamp:
    return Lamp(tmp_path)


def token_of(*grants: Grant, kind: CallerKind = CallerKind.USER) -> str:
    caller = Caller(kind, "anna", "Anna", grants, revision=1, session="session-1")
    return KEY.issue(caller, valid_s=60)


@pytest.mark.parametrize("revoked", ["anna", "session-1"])
@pytest.mark.parametrize("path", ["/robots/ur10-1/state", "/robots/ur10-1/jog"])
async def test_a_websocket_ends_when_its_session_or_user_is_revoked(
    lamp: Lamp, path: str, revoked: str
) -> None:
    async with lamp.open(path, token_of(Grant(Role.ENGINEER))) as opened:
        await opened.until("websocket.accept")
        lamp.revoke("somebody else")
        await opened.echoes()
        lamp.revoke(revoked)
        assert (await opened.until("websocket.close"))["code"] == 4401


async def test_a_streamed_response_ends_when_its_caller_is_revoked(lamp: Lamp) -> None:
    async with lamp.open("/lines", token_of(Grant(Role.VIEWER)), "http") as opened:
        await opened.until("http.response.body")
        lamp.revoke("anna")
        async with asyncio.timeout(BOUND_S):
            await opened.serving


@pytest.mark.parametrize(("path", "kind"), [("/robots/ur10-1/jog", "websocket"), ("/lines", "http")])
async def test_accounts_that_are_set_up_later_end_the_streams_of_local_mode(
    tmp_path: Path, path: str, kind: str
) -> None:
    lamp = Lamp(tmp_path, has_accounts=False)
    async with lamp.open(path, None, kind) as stream:
        await stream.until("websocket.accept" if kind == "websocket" else "http.response.body")
        lamp.set_up_accounts()
        if kind == "websocket":
            assert (await stream.until("websocket.close"))["code"] == 4401
        async with asyncio.timeout(BOUND_S):
            await asyncio.wait({stream.serving})


async def test_a_token_whose_grant_is_removed_keeps_the_streams_of_its_other_grants(lamp: Lamp) -> None:
    secret = new_token("script")

    def known(*roles: str) -> dict[str, Any]:
        grants = [{"role": role, "resource": UR10} for role in roles]
        found = {"active": True, "kind": "script", "subject": "script-1", "name": "plotter", "grants": grants}
        return found | {"revision": lamp.revocations.position}

    lamp.introspection = known("viewer", "engineer")
    async with (
        lamp.open("/robots/ur10-1/state", secret) as state,
        lamp.open("/robots/ur10-1/jog", secret) as jog,
    ):
        await state.until("websocket.accept")
        await jog.until("websocket.accept")
        lamp.revoke("script-1")
        lamp.introspection = known("viewer")
        assert (await jog.until("websocket.close"))["code"] == 4403
        await state.echoes()
        lamp.revoke("script-1")
        lamp.introspection = {"active": False}
        assert (await state.until("websocket.close"))["code"] == 4401


async def test_a_stream_keeps_the_permission_and_resource_that_its_parameters_chose(lamp: Lamp) -> None:
    secret = new_token("script")

    def known(*grants: tuple[str, str]) -> dict[str, Any]:
        held = [{"role": role, "resource": resource} for role, resource in grants]
        found = {"active": True, "kind": "script", "subject": "script-1", "name": "plotter", "grants": held}
        return found | {"revision": lamp.revocations.position}

    other = ("engineer", "urn:ngsi-ld:Device:demo:ur10-2")
    lamp.introspection = known(other, ("engineer", UR10))
    async with (
        lamp.open("/robots/ur10-1/walk", secret) as watching,
        lamp.open("/robots/ur10-1/walk?helper", secret) as helping,
    ):
        await watching.until("websocket.accept")
        await helping.until("websocket.accept")
        lamp.revoke("script-1")
        lamp.introspection = known(other, ("viewer", UR10))
        assert (await helping.until("websocket.close"))["code"] == 4403
        await watching.echoes()


async def test_without_the_stream_of_revocations_only_what_moves_ends(
    lamp: Lamp, monkeypatch: pytest.MonkeyPatch
) -> None:
    anna = token_of(Grant(Role.ENGINEER))
    service = token_of(Grant(Role.SERVICE), kind=CallerKind.SERVICE)
    async with (
        lamp.open("/robots/ur10-1/state", anna) as state,
        lamp.open("/robots/ur10-1/jog", anna) as jog,
        lamp.open("/robots/ur10-1/jog", service) as of_service,
    ):
        for one in (state, jog, of_service):
            await one.until("websocket.accept")
        monkeypatch.setattr(module, "MAX_SILENCE_S", -1.0)
        assert (await jog.until("websocket.close"))["code"] == 4503
        await state.echoes()
        await of_service.echoes()
