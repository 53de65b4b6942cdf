"""Credentials for a broker of others, and that ours never go there."""

import asyncio
import inspect
import json
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import SecretStr
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.types import Receive, Scope, Send

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.errors import UsageError
from handover.settings import HEADERS_OF_REQUESTS, Settings, headers_in
from handover_datamodels.contexts import handover_context
from handover_datamodels.entities import Device
from tests.kit.openid_provider import openid_provider

LAMP = "urn:ngsi-ld:Device:demo:lamp-1"
OWN = "Bearer a-token-of-this-service"


class OwnCredentials:
    """Those of a service of ours."""

    async def headers(self) -> Mapping[str, str]:
        return {"Authorization": OWN}

    def renew(self, refused: Mapping[str, str]) -> bool:
        return True


class Server:
    """An HTTP server in the place of a broker, which keeps what it receives."""

    def __init__(self, answer: Callable[[Request], Response], *, is_ours: bool = False) -> None:
        self._answer = answer
        self._is_ours = is_ours
        self.received: list[Request] = []

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        request = Request(scope, receive)
        self.received.append(request)
        response = self._answer(request)
        if request.url.path == "/context.jsonld" and self._is_ours:
            response = JSONResponse(handover_context())
        await response(scope, receive, send)

    def tokens(self) -> list[str | None]:
        """Return the Authorization of the requests for NGSI-LD data."""
        data = (one for one in self.received if one.url.path.startswith("/ngsi-ld/v1/"))
        return [one.headers.get("authorization") for one in data]


@asynccontextmanager
async def client_of(
    server: Server, own: OwnCredentials | None = None, **given: Any
) -> AsyncIterator[BrokerClient]:
    settings = Settings.load(_env_file=None, broker_url="https://orion.example", **given)
    transport = httpx.ASGITransport(server)
    async with BrokerClient(settings, credentials=own, transport=transport) as client:
        yield client


def lamp(_: Request) -> Response:
    return JSONResponse({"id": LAMP, "type": "Device"})


def operations() -> list[str]:
    """Return the names of all operations of the client."""
    found = inspect.getmembers(BrokerClient, inspect.iscoroutinefunction)
    return [name for name, _ in found if not name.startswith("_")]


ARGUMENTS: dict[str, Any] = {
    "entity_id": LAMP,
    "entity_ids": [LAMP],
    "entities": [{"id": LAMP, "type": "Device"}],
    "entity": {"id": LAMP, "type": "Device"},
    "attributes": {"state": {"type": "Property", "value": "on"}},
    "model": Device,
    "name": "state",
    "since": "2026-01-01T00:00:00Z",
    "subscription": {"id": "urn:ngsi-ld:Subscription:demo:1", "type": "Subscription"},
    "subscription_id": "urn:ngsi-ld:Subscription:demo:1",
    "method": "GET",
    "path": "/types",
}


async def call(client: BrokerClient, operation: str) -> None:
    method = getattr(client, operation)
    named = [
        one.name
        for one in inspect.signature(method).parameters.values()
        if one.kind is not one.VAR_KEYWORD and one.default is one.empty
    ]
    with suppress(BrokerError):
        await method(**{name: ARGUMENTS[name] for name in named})


@pytest.mark.parametrize("operation", operations())
@pytest.mark.parametrize("status", [200, 401, 404, 500])
async def test_no_operation_sends_our_credentials_to_another_broker(operation: str, status: int) -> None:
    other = Server(lambda _: JSONResponse([], status))
    async with client_of(other, OwnCredentials()) as client:
        await call(client, operation)
    assert other.received
    assert all("authorization" not in one.headers for one in other.received)


@pytest.mark.parametrize("operation", operations())
async def test_each_operation_sends_our_credentials_to_our_broker(operation: str) -> None:
    ours = Server(lambda _: JSONResponse([], 200), is_ours=True)
    async with client_of(ours, OwnCredentials()) as client:
        await call(client, operation)
    assert set(ours.tokens()) <= {OWN}
    assert ours.tokens() or operation == "identity"


async def test_a_broker_that_replaces_ours_gets_no_credentials_of_ours() -> None:
    ours, other = Server(lamp, is_ours=True), Server(lamp)
    serving: list[Server | None] = [ours]

    async def current(scope: Scope, receive: Receive, send: Send) -> None:
        if serving[0] is None:
            raise httpx.ConnectError("refused")
        await serving[0](scope, receive, send)

    settings = Settings.load(_env_file=None)
    transport = httpx.ASGITransport(current)  # type: ignore[arg-type]
    async with BrokerClient(settings, credentials=OwnCredentials(), transport=transport) as client:
        await client.retrieve(LAMP)
        serving[0] = None
        with pytest.raises(BrokerUnavailable):
            await client.retrieve(LAMP)
        serving[0] = other
        await client.retrieve(LAMP)
    assert (ours.tokens(), other.tokens()) == ([OWN], [None])


@pytest.mark.parametrize(
    "answer",
    [
        HTMLResponse("<html>Sign in</html>"),
        RedirectResponse("https://id.example/login"),
        HTMLResponse("<html>Sign in</html>", 401),
        JSONResponse({"title": "denied"}, 403),
        JSONResponse({"title": "Internal Server Error"}, 500),
    ],
)
async def test_a_broker_behind_a_proxy_that_recovers_is_recognized(
    answer: Response, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("handover.broker.connection.UNCERTAIN_IDENTITY_S", 0.0)
    ours = Server(lamp, is_ours=True)
    serving = [Server(lambda _: answer)]

    async def current(scope: Scope, receive: Receive, send: Send) -> None:
        await serving[0](scope, receive, send)

    transport = httpx.ASGITransport(current)  # type: ignore[arg-type]
    settings = Settings.load(_env_file=None)
    async with BrokerClient(settings, credentials=OwnCredentials(), transport=transport) as client:
        assert not (await client.identity()).is_ours
        with suppress(BrokerError):
            await client.retrieve(LAMP)
        assert set(serving[0].tokens()) == {None}
        serving[0] = ours
        await client.retrieve(LAMP)
        assert (await client.identity()).is_ours
    assert ours.tokens() == [OWN]


async def test_a_broker_of_others_is_asked_once_which_one_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("handover.broker.connection.UNCERTAIN_IDENTITY_S", 0.0)
    other = Server(lambda one: lamp(one) if "v1" in one.url.path else JSONResponse({}, 404))
    async with client_of(other, OwnCredentials()) as client:
        for _ in range(3):
            await client.retrieve(LAMP)
    asked = [one.url.path for one in other.received if "/entities/" not in one.url.path]
    assert asked == ["/context.jsonld", "/ngsi-ld/ex/v1/version"]


async def test_the_token_in_a_file_is_sent_and_a_replaced_one_used(tmp_path: Path) -> None:
    file = tmp_path / "token"
    valid = ["one"]
    other = Server(
        lambda request: (
            lamp(request)
            if request.headers.get("authorization") == f"Bearer {valid[0]}"
            else JSONResponse({"title": "no"}, 401)
        )
    )
    async with client_of(other, OwnCredentials(), broker_token_file=file) as client:
        with pytest.raises(BrokerUnavailable, match=f"HANDOVER_BROKER_TOKEN_FILE is {file}, .*No such file"):
            await client.retrieve(LAMP)
        file.write_text("one\n")
        await client.retrieve(LAMP)
        valid[0] = "two"
        with pytest.raises(BrokerUnavailable, match="wants credentials: set HANDOVER_BROKER_TOKEN_FILE"):
            await client.retrieve(LAMP)
        (tmp_path / "new").write_text("two")
        (tmp_path / "new").replace(file)
        await client.retrieve(LAMP)
        file.write_text("two words")
        with pytest.raises(BrokerUnavailable, match="holds no token"):
            await client.retrieve(LAMP)


async def test_headers_of_the_setting_are_sent() -> None:
    other = Server(lamp)
    given = SecretStr('{"X-Auth-Token": "a b", "fiware-service": "cell"}')
    async with client_of(other, OwnCredentials(), broker_headers=given) as client:
        await client.retrieve(LAMP)
    assert other.received[-1].headers["x-auth-token"] == "a b"
    assert other.received[-1].headers["fiware-service"] == "cell"
    assert "a b" not in str(Settings.load(_env_file=None, broker_headers=given))


@given(st.dictionaries(st.text(max_size=20), st.text(max_size=20), max_size=4))
def test_headers_that_are_accepted_make_a_valid_request(headers: dict[str, str]) -> None:
    try:
        accepted = headers_in(json.dumps(headers))
    except ValueError:
        return
    assert accepted == headers
    sent = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    assert sent.isascii()
    assert sent.count("\r\n") == len(headers) == sent.count("\n")
    assert not {name.lower() for name in headers} & HEADERS_OF_REQUESTS


@pytest.mark.parametrize(
    ("given", "fault"),
    [
        ({"broker_headers": "x"}, "JSON object of headers"),
        ({"broker_headers": '{"Link": "x"}'}, "'Link'"),
        ({"broker_headers": '{"X": "a\\nb"}'}, "'X'"),
        ({"broker_oauth_url": "id.example"}, "no address of a token endpoint"),
        ({"broker_oauth_url": "https://id.example/token"}, "needs broker_oauth_client"),
        ({"broker_token_file": "t", "broker_headers": '{"Authorization": "x"}'}, "set one of them"),
        (
            {
                "broker_token_file": "t",
                "broker_oauth_url": "https://id.example/token",
                "broker_oauth_client": "x",
                "broker_oauth_secret": "y",
            },
            "set one of them",
        ),
    ],
)
def test_settings_that_cannot_be_right_are_named(given: dict[str, str], fault: str) -> None:
    with pytest.raises(UsageError, match=fault):
        Settings.load(_env_file=None, **given)


def test_settings_without_a_value_are_not_set() -> None:
    names = ("broker_token_file", "broker_headers", "broker_oauth_url", "broker_oauth_secret")
    empty: dict[str, Any] = dict.fromkeys(names, "")
    assert Settings.load(_env_file=None, **empty).other_broker_headers() == {}


@pytest.mark.nightly
async def test_tokens_of_a_provider_are_requested_renewed_and_repeated_when_they_are_refused() -> None:
    provider = openid_provider()
    program = provider.add_program()
    other = Server(
        lambda request: (
            lamp(request)
            if provider.accepts(request.headers.get("authorization", "").removeprefix("Bearer "))
            else JSONResponse({"title": "no"}, 401)
        )
    )
    given = {
        "broker_oauth_url": f"{provider.issuer}/token/",
        "broker_oauth_client": program.client_id,
        "broker_oauth_secret": SecretStr(program.secret or ""),
        "broker_oauth_scope": "profile",
    }
    async with client_of(other, OwnCredentials(), **given) as client:
        await client.retrieve(LAMP)
        await client.retrieve(LAMP)
        (first,) = set(other.tokens())
        provider.revoke((first or "").removeprefix("Bearer "))
        with suppress(BrokerUnavailable):  # a token that was just issued is not renewed
            await client.retrieve(LAMP)
        for _ in range(600):
            with suppress(BrokerUnavailable):
                await client.retrieve(LAMP)
                break
            await asyncio.sleep(0.1)
    assert other.tokens()[-1] not in {None, OWN, first}


async def test_what_a_provider_refuses_names_the_setting() -> None:
    provider = openid_provider()
    given = {
        "broker_oauth_url": f"{provider.issuer}/token/",
        "broker_oauth_client": "nobody",
        "broker_oauth_secret": SecretStr("x"),
    }
    other = Server(lamp)
    async with client_of(other, OwnCredentials(), **given) as client:
        with pytest.raises(BrokerUnavailable, match=r"invalid_client.*HANDOVER_BROKER_OAUTH_CLIENT"):
            await client.retrieve(LAMP)
    given["broker_oauth_url"] = f"{provider.issuer}/nothing/"
    async with client_of(other, OwnCredentials(), **given) as client:
        with pytest.raises(BrokerUnavailable, match="no JSON object; set the address of the token endpoint"):
            await client.retrieve(LAMP)
    assert other.received == []


@pytest.mark.parametrize(
    ("answer", "fault"),
    [
        (HTMLResponse("<html>Sign in</html>"), "text/html.*set HANDOVER_BROKER_URL"),
        (
            RedirectResponse("https://id.example/login"),
            "redirects to https://id.example/login.*HANDOVER_BROKER_",
        ),
        (JSONResponse("a text"), "no NGSI-LD"),
        (HTMLResponse("<html>Sign in</html>", 401), "wants credentials: set HANDOVER_BROKER_TOKEN_FILE"),
    ],
)
@pytest.mark.parametrize("operation", ["retrieve", "query", "subscriptions", "subscription", "types"])
async def test_a_server_that_is_no_broker_is_named_and_nothing_is_missing(
    answer: Response, fault: str, operation: str
) -> None:
    async with client_of(Server(lambda _: answer)) as client:
        method = getattr(client, operation)
        with pytest.raises(BrokerUnavailable, match=fault):
            await (method(LAMP) if operation in {"retrieve", "subscription"} else method())


@pytest.mark.parametrize("operation", ["create", "update", "upsert", "delete", "ensure_subscription"])
async def test_a_sign_in_page_is_no_success(operation: str) -> None:
    async with client_of(Server(lambda _: HTMLResponse("<html>Sign in</html>"))) as client:
        method = getattr(client, operation)
        named = list(inspect.signature(method).parameters)
        with pytest.raises(BrokerUnavailable, match="text/html"):
            await method(**{name: ARGUMENTS[name] for name in named})
