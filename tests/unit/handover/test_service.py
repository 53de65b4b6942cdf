"""A service: health, readiness, metrics, and errors as problem details."""

import asyncio
from collections.abc import AsyncIterator

import httpx
import pytest
from fastapi import FastAPI

from handover.errors import Problem
from handover.service import create_app


async def works() -> None:
    return None


async def is_away() -> None:
    raise ConnectionError("the lamp is away")


def an_app() -> FastAPI:
    app = create_app("lamp", description="A lamp.", checks={"power": works, "lamp": is_away})

    @app.get("/problem")
    async def problem() -> None:
        raise Problem(409, "Lit already", "switch it off first")

    @app.get("/broken")
    async def broken() -> None:
        raise ZeroDivisionError("secret of the house")

    @app.get("/number/{number}")
    async def number(number: int) -> int:
        return number

    return app


@pytest.fixture
async def http() -> AsyncIterator[httpx.AsyncClient]:
    transport = httpx.ASGITransport(an_app(), raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://lamp") as client:
        yield client


async def test_a_service_lives_though_what_it_needs_is_away(http: httpx.AsyncClient) -> None:
    assert (await http.get("/healthz")).status_code == 200
    ready = await http.get("/readyz")
    assert ready.status_code == 503
    assert ready.json() == {"status": "not ready", "lamp": "the lamp is away"}


async def test_what_hangs_is_named_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("handover.service.CHECK_TIMEOUT_S", 0.05)
    checks = {"broker": asyncio.Event().wait, "lamp": is_away, "power": works}
    transport = httpx.ASGITransport(create_app("lamp", description="A lamp.", checks=checks))
    async with httpx.AsyncClient(transport=transport, base_url="http://lamp") as client:
        ready = await asyncio.wait_for(client.get("/readyz"), 60)
    assert ready.status_code == 503
    assert ready.json() == {
        "status": "not ready",
        "broker": "no answer within 0.05 s",
        "lamp": "the lamp is away",
    }


async def test_metrics_are_those_of_prometheus(http: httpx.AsyncClient) -> None:
    answer = await http.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain")
    assert "process_resident_memory_bytes" in answer.text


async def test_any_broker_can_fetch_the_context(http: httpx.AsyncClient) -> None:
    answer = await http.get("/context.jsonld")
    assert answer.headers["content-type"] == "application/ld+json"
    assert "@context" in answer.json()


@pytest.mark.parametrize(
    ("path", "status", "words"),
    [
        ("/problem", 409, "switch it off first"),
        ("/nowhere", 404, "Not Found"),
        ("/number/seven", 422, "path.number"),
        ("/broken", 500, "ZeroDivisionError"),
    ],
)
async def test_every_error_is_a_problem_that_says_what_to_change(
    http: httpx.AsyncClient, path: str, status: int, words: str
) -> None:
    answer = await http.get(path)
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    assert words in answer.json()["detail"]
    assert "secret" not in answer.text
