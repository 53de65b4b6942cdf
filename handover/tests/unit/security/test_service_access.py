"""The credentials of our own requests: none without accounts, a token with them, never a silent omission."""

from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse, Response
from pydantic import SecretStr

from glove_sdk_bridge.controller_client import ACCESS_TOKEN, ControllerClient
from handover.broker import BrokerClient, BrokerUnavailable
from handover.command_line.access import access_headers
from handover.errors import UsageError
from handover.security.access_tokens import SigningKey, key_set
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.secret_tokens import new_token
from handover.security.service_access import ServiceAccess
from handover.serving.service import add_operations
from handover.settings import Settings


def settings_in(folder: Path, **given: Any) -> Settings:
    return Settings(data_dir=folder, _env_file=None, **given)


def set_up_accounts(folder: Path) -> None:
    (folder / "security").mkdir(exist_ok=True)
    (folder / "security" / PUBLIC_KEYS_FILE).write_bytes(key_set(SigningKey.generate()))


def a_broker(received: list[str | None]) -> httpx.ASGITransport:
    app = FastAPI()
    add_operations(app, {})

    @app.get("/ngsi-ld/v1/types")
    async def types(request: Request) -> dict[str, list[str]]:
        received.append(request.headers.get("authorization"))
        return {"typeList": []}

    return httpx.ASGITransport(app)


async def test_without_accounts_requests_to_the_broker_have_no_credentials(tmp_path: Path) -> None:
    settings, received = settings_in(tmp_path), []
    async with ServiceAccess(settings, "lamp") as access:
        await BrokerClient(settings, credentials=access, transport=a_broker(received)).types()
    assert received == [None]


async def test_with_accounts_a_script_sends_its_token_to_the_broker(tmp_path: Path) -> None:
    set_up_accounts(tmp_path)
    token = new_token("script")
    settings, received = settings_in(tmp_path, service_token=SecretStr(token)), []
    async with ServiceAccess(settings, "lamp") as access:
        await BrokerClient(settings, credentials=access, transport=a_broker(received)).types()
    assert received == [f"Bearer {token}"]


async def test_a_component_on_another_machine_sends_its_token(tmp_path: Path) -> None:
    for kind, sent in (("script", True), ("service", False)):
        token = new_token(kind)
        settings, received = settings_in(tmp_path, service_token=SecretStr(token)), []
        async with ServiceAccess(settings, "lamp") as access:
            await BrokerClient(settings, credentials=access, transport=a_broker(received)).types()
        assert received == [f"Bearer {token}" if sent else None]


async def test_a_service_that_has_not_noticed_the_first_account_repeats_what_others_refuse(
    tmp_path: Path,
) -> None:
    token = new_token("script")
    settings = settings_in(tmp_path, service_token=SecretStr(token))
    settings.security_folder.mkdir()
    received: list[str | None] = []
    app = FastAPI()
    add_operations(app, {})

    @app.get("/ngsi-ld/v1/types")
    async def types(request: Request) -> Response:
        received.append(request.headers.get("authorization"))
        return JSONResponse({"typeList": []}, 200 if received[-1] or len(received) == 1 else 401)

    async with ServiceAccess(settings, "lamp") as access:
        broker = BrokerClient(settings, credentials=access, transport=httpx.ASGITransport(app))
        await broker.types()
        set_up_accounts(tmp_path)  # within the second in which the service does not look
        await broker.types()
    assert received == [None, None, f"Bearer {token}"]


async def test_with_accounts_a_request_that_has_no_credentials_is_not_sent(tmp_path: Path) -> None:
    set_up_accounts(tmp_path)
    settings, received = settings_in(tmp_path), []
    async with ServiceAccess(settings, "lamp") as access:
        broker = BrokerClient(settings, credentials=access, transport=a_broker(received))
        with pytest.raises(BrokerUnavailable, match="lamp has no service token"):
            await broker.types()
    assert received == []


def test_the_command_line_sends_the_token_of_its_setting(tmp_path: Path) -> None:
    token = new_token("script")
    assert access_headers(settings_in(tmp_path)) == {}
    set_up_accounts(tmp_path)
    sent = access_headers(settings_in(tmp_path, service_token=SecretStr(token)))
    assert sent == {"Authorization": f"Bearer {token}"}
    with pytest.raises(UsageError, match="handover accounts set-up"):
        access_headers(settings_in(tmp_path))


def test_the_glove_bridge_sends_the_token_of_its_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(ACCESS_TOKEN, raising=False)
    assert ControllerClient("http://127.0.0.1:9")._headers == {}
    monkeypatch.setenv(ACCESS_TOKEN, "a-token")
    assert ControllerClient("http://127.0.0.1:9")._headers == {"Authorization": "Bearer a-token"}
