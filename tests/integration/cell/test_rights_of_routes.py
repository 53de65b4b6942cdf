"""Every route of every service asks a permission of its callers or another credential, or is public.

The services are those that `handover up` can start; a new one is included without a change here.
"""

import inspect
import re
from collections.abc import Iterable, Iterator, MutableMapping
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute, APIWebSocketRoute

from handover.extensions import Service, application_of
from handover.security.access_tokens import SigningKey, key_set
from handover.security.guard import PUBLIC_PATHS, requirements, routes_without_requirement
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.services import all_services
from tests.kit.paths import REPOSITORY
from tests.kit.ports import next_free_port

PUBLIC: dict[str, tuple[str, ...]] = {
    "Web UI": (
        "/api/session",  # to sign in, and to learn that it is necessary
        "/api/session/link",
        "/api/session/link-use",
        "/api/session/provider",
        "/api/session/provider/callback",
        "/api/session/request",
        "/{address:path}",  # the files of the page
    )
}
"""The public routes of a service besides those of every service, each with a reason."""
STATUS_SET = re.compile(r"\bresponse\.status_code = (\d{3})\b")
WITHOUT_FASTAPI = {"context-broker"}
"""Services that check their operations by themselves, not by routes of FastAPI."""

SERVICES = [service for service in all_services() if service.name not in WITHOUT_FASTAPI]


@pytest.fixture
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HANDOVER_DATA_DIR", str(tmp_path))
    monkeypatch.setenv("HANDOVER_GLOVE_PORT", str(next_free_port()))
    return tmp_path


@pytest.fixture(params=SERVICES, ids=lambda service: service.name)
def app(request: pytest.FixtureRequest, environment: Path) -> FastAPI:
    service: Service = request.param
    made = application_of(service)
    assert made is not None, (
        f"{service.name} has no FastAPI application; how does it authenticate its callers?"
    )
    return made


@pytest.mark.nightly
def test_every_successful_response_is_described_with_its_media_type_and_the_schema_of_its_json(
    app: FastAPI,
) -> None:
    undescribed = []
    for path, methods in app.openapi()["paths"].items():
        for method, operation in methods.items():
            for status, response in operation["responses"].items():
                content = response.get("content", {})
                is_described = content and content.get("application/json", {"schema": True}).get("schema")
                if status.startswith("2") and status != "204" and not is_described:
                    undescribed.append(f"{method.upper()} {path} {status}")
    assert undescribed == []


@pytest.mark.nightly
def test_every_status_that_a_route_sets_is_described(app: FastAPI) -> None:
    paths = app.openapi()["paths"]
    undescribed = []
    for route in app.routes:
        if isinstance(route, APIRoute) and route.include_in_schema:
            statuses = STATUS_SET.findall(inspect.getsource(inspect.unwrap(route.endpoint)))
            for method in route.methods:
                described = paths[route.path_format][method.lower()]["responses"]
                undescribed += [f"{method} {route.path} {one}" for one in statuses if one not in described]
    assert undescribed == []


@pytest.mark.nightly
def test_every_route_asks_a_permission(app: FastAPI) -> None:
    assert app.state.guard is not None, "give a guard to create_app"
    assert routes_without_requirement(app, PUBLIC.get(app.title, ())) == []


@pytest.mark.parametrize("name", sorted(WITHOUT_FASTAPI))
def test_an_exception_is_listed_only_while_it_is_one(name: str, environment: Path) -> None:
    (service,) = (one for one in all_services() if one.name == name)
    made = application_of(service)
    assert made is None


@pytest.mark.nightly
async def test_with_accounts_no_route_answers_without_credentials(app: FastAPI, environment: Path) -> None:
    set_up_accounts(environment)
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as stranger:
        for method, path in http_routes(app):
            answer = await stranger.request(method, path)
            expected = {403, 503} if "/notifications" in path else {401}  # the key; 503 while it starts
            assert answer.status_code in expected, f"{method} {path}: {answer.status_code} {answer.text}"


@pytest.mark.nightly
async def test_with_accounts_no_stream_opens_without_credentials(app: FastAPI, environment: Path) -> None:
    set_up_accounts(environment)
    for route in app.routes:
        if isinstance(route, APIWebSocketRoute):
            (answer,) = await open_stream(app, filled(route.path))
            assert (answer["type"], answer["code"]) == ("websocket.close", 4401)


@pytest.mark.nightly
def test_the_documentation_names_what_each_route_asks(app: FastAPI) -> None:
    page = (REPOSITORY / "docs/reference/rest.md").read_text(encoding="utf-8")
    for name, asked in requirements(app).items():
        assert (
            f"| `{name}` | {asked.replace('|', chr(92) + '|')} |" in page
            or "{" in asked
            or (
                "," in name.split()[0]  # the proxy of the page server, which is not in the schema
            )
        )


async def open_stream(
    app: FastAPI, path: str, headers: Iterable[tuple[bytes, bytes]] = ()
) -> list[MutableMapping[str, Any]]:
    """Return what the application answers to a client that connects and leaves."""
    received: Iterator[MutableMapping[str, Any]] = iter(
        [{"type": "websocket.connect"}, {"type": "websocket.disconnect", "code": 1000}]
    )
    answers: list[MutableMapping[str, Any]] = []

    async def receive() -> MutableMapping[str, Any]:
        return next(received)

    async def send(message: MutableMapping[str, Any]) -> None:
        answers.append(message)

    path, _, query = path.partition("?")
    scope = {
        "type": "websocket",
        "asgi": {"version": "3.0"},
        "scheme": "ws",
        "path": path,
        "raw_path": path.encode(),
        "query_string": query.encode(),
        "headers": [(b"host", b"localhost"), *headers],
        "client": ("127.0.0.1", 40000),
        "server": ("127.0.0.1", 80),
        "subprotocols": [],
    }
    await app(scope, receive, send)
    return answers


def set_up_accounts(data_dir: Path) -> None:
    (data_dir / "security").mkdir()
    (data_dir / "security" / PUBLIC_KEYS_FILE).write_bytes(key_set(SigningKey.generate()))


def http_routes(app: FastAPI) -> Iterator[tuple[str, str]]:
    for route in app.routes:
        if isinstance(route, APIRoute) and route.path not in {*PUBLIC_PATHS, *PUBLIC.get(app.title, ())}:
            yield from ((method, filled(route.path)) for method in sorted(route.methods))


def filled(path: str) -> str:
    return re.sub(r"\{[^}]*\}", "one", path)
