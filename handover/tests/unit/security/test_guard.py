"""The guard: local requests without accounts, tokens with accounts, and nothing in between."""

import asyncio
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Annotated

import httpx
import pytest
from fastapi import FastAPI

from handover.security.access_tokens import SigningKey
from handover.security.caller import Caller, CallerKind
from handover.security.guard import (
    Guard,
    in_path,
    require,
    require_by_handler,
    routes_without_requirement,
)
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.permissions import Grant, Permission, Role
from handover.security.revocations import FollowedRevocations
from handover.serving.service import create_app
from handover.settings import Settings
from tests.kit.bearer_tokens import KEY, UR10, bearer, set_up_accounts


def an_app(settings: Settings, revocations: FollowedRevocations) -> FastAPI:
    app = create_app("lamp", description="A lamp.", guard=Guard(settings, "lamp", revocations=revocations))

    @app.get("/state", dependencies=[require(Permission.READ)])
    async def state() -> str:
        return "on"

    @app.post(
        "/robots/{robot}/jog", dependencies=[require(Permission.MOVE_ROBOTS, in_path("Device", "robot"))]
    )
    async def jog(robot: str) -> str:
        return robot

    @app.post("/processes")
    async def start(caller: Annotated[Caller, require_by_handler(Permission.RUN_PROCESSES)]) -> str:
        return caller.name

    return app


@pytest.fixture
def revocations() -> FollowedRevocations:
    return FollowedRevocations()


@pytest.fixture
async def http(tmp_path: Path, revocations: FollowedRevocations) -> AsyncIterator[httpx.AsyncClient]:
    app = an_app(Settings(data_dir=tmp_path, _env_file=None), revocations)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost") as client:
        yield client


async def test_without_accounts_a_local_request_may_do_everything(http: httpx.AsyncClient) -> None:
    assert (await http.get("/state")).status_code == 200
    assert (await http.post("/robots/ur10-1/jog")).status_code == 200
    assert (await http.post("/processes")).json() == "local owner"


@pytest.mark.parametrize("headers", [{"Host": "cell.example"}, {"X-Forwarded-For": "10.0.0.7"}])
async def test_without_accounts_any_other_request_is_refused(
    http: httpx.AsyncClient, headers: dict[str, str]
) -> None:
    answer = await http.get("/state", headers=headers)
    assert answer.status_code == 401
    assert answer.headers["www-authenticate"] == "Bearer"
    assert "`handover secure`" in answer.json()["detail"]


async def test_with_accounts_a_local_request_needs_a_token(http: httpx.AsyncClient, tmp_path: Path) -> None:
    set_up_accounts(tmp_path)
    assert (await http.get("/state")).status_code == 401
    assert (await http.get("/state", headers={"Authorization": "Basic eA=="})).status_code == 401
    assert (await http.get("/state", headers=bearer(Grant(Role.VIEWER)))).status_code == 200
    assert (await http.get("/healthz")).status_code == 200


async def test_accounts_that_are_set_up_later_end_local_mode(http: httpx.AsyncClient, tmp_path: Path) -> None:
    assert (await http.get("/state")).status_code == 200
    set_up_accounts(tmp_path)
    async with asyncio.timeout(60):
        while (await http.get("/state")).status_code != 401:
            await asyncio.sleep(0.1)
    (tmp_path / "security" / PUBLIC_KEYS_FILE).unlink()
    await asyncio.sleep(1.1)
    assert (await http.get("/state")).status_code == 401, "a deleted file must not open the service"


async def test_a_grant_for_one_robot_moves_only_that_robot(
    http: httpx.AsyncClient, tmp_path: Path, revocations: FollowedRevocations
) -> None:
    set_up_accounts(tmp_path)
    revocations.apply({"position": 0, "revoked": []})
    token = bearer(Grant(Role.ENGINEER, UR10))
    assert (await http.post("/robots/ur10-1/jog", headers=token)).status_code == 200
    refused = await http.post("/robots/ur10-2/jog", headers=token)
    assert refused.status_code == 403
    assert "moveRobots" in refused.json()["detail"]
    assert (await http.post("/processes", headers=token)).status_code == 200
    assert (await http.get("/state", headers=token)).status_code == 403, "the state of everything"
    viewer = bearer(Grant(Role.VIEWER))
    assert (await http.post("/processes", headers=viewer)).status_code == 403


async def test_without_the_stream_of_revocations_nothing_moves(
    http: httpx.AsyncClient, tmp_path: Path
) -> None:
    set_up_accounts(tmp_path)
    token = bearer(Grant(Role.ENGINEER))
    assert (await http.post("/robots/ur10-1/jog", headers=token)).status_code == 503
    assert (await http.get("/state", headers=token)).status_code == 200


@pytest.mark.parametrize("name", ["subject-1", "session-1"])
async def test_a_revocation_ends_the_tokens_issued_before_it(
    http: httpx.AsyncClient, tmp_path: Path, revocations: FollowedRevocations, name: str
) -> None:
    set_up_accounts(tmp_path)
    token = bearer(Grant(Role.VIEWER), revision=4)
    assert (await http.get("/state", headers=token)).status_code == 200
    revocations.apply({"position": 5, "revoked": [[5, name]]})
    assert (await http.get("/state", headers=token)).status_code == 401
    assert (await http.get("/state", headers=bearer(Grant(Role.VIEWER), revision=5))).status_code == 200
    other = bearer(Grant(Role.VIEWER), subject="subject-2", revision=4)
    assert (await http.get("/state", headers=other)).status_code == (401 if name == "session-1" else 200)


async def test_a_captured_token_is_of_no_use_in_another_cell_or_with_other_content(
    http: httpx.AsyncClient, tmp_path: Path, revocations: FollowedRevocations
) -> None:
    set_up_accounts(tmp_path)
    revocations.apply({"position": 0, "revoked": []})
    owner = Caller(CallerKind.USER, "subject-1", "Anna", (Grant(Role.ENGINEER),))
    of_another_cell = SigningKey.generate().issue(owner, valid_s=60)
    head, body, signature = KEY.issue(owner, valid_s=60).split(".")
    viewer = KEY.issue(Caller(CallerKind.USER, "subject-2", "Vera", (Grant(Role.VIEWER),)), valid_s=60)
    mixed = ".".join((head, body, viewer.rpartition(".")[2]))
    for replayed in (of_another_cell, mixed, f"{head}.{body}."):
        answer = await http.post("/robots/ur10-1/jog", headers={"Authorization": f"Bearer {replayed}"})
        assert answer.status_code == 401, replayed
    whole = {"Authorization": f"Bearer {head}.{body}.{signature}"}
    assert (await http.post("/robots/ur10-1/jog", headers=whole)).status_code == 200


async def test_an_expired_token_is_refused_though_it_was_accepted_before(
    http: httpx.AsyncClient, tmp_path: Path
) -> None:
    set_up_accounts(tmp_path)
    token = bearer(Grant(Role.VIEWER), valid_s=-3)  # within the tolerated difference of clocks
    assert (await http.get("/state", headers=token)).status_code == 200
    until_s = time.time() + 60
    while (await http.get("/state", headers=token)).status_code == 200:
        assert time.time() < until_s
        await asyncio.sleep(0.2)


async def test_a_secret_token_is_refused_while_accounts_cannot_be_asked(
    http: httpx.AsyncClient, tmp_path: Path
) -> None:
    set_up_accounts(tmp_path)
    secret = "hnd_script_" + "a" * 43
    assert (await http.get("/state", headers={"Authorization": f"Bearer {secret}"})).status_code == 503


def test_routes_that_ask_nothing_are_found(tmp_path: Path, revocations: FollowedRevocations) -> None:
    app = an_app(Settings(data_dir=tmp_path, _env_file=None), revocations)
    assert routes_without_requirement(app) == []

    @app.post("/open")
    async def opened() -> None:
        return None

    @app.websocket("/live")
    async def live() -> None:
        return None

    assert routes_without_requirement(app) == ["POST /open", "WebSocket /live"]
    assert routes_without_requirement(app, public=["/open"]) == ["WebSocket /live"]
