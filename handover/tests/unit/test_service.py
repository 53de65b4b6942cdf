"""A service: health, readiness, metrics, and errors as problem details."""

import asyncio
import json
import math
from collections.abc import AsyncIterator
from typing import Any

import httpx
import orjson
import pytest
from fastapi import FastAPI, Request
from hypothesis import example, given
from hypothesis import strategies as st

from handover.errors import Problem
from handover.messages import message
from handover.serving.service import create_app


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

    @app.post("/echo")
    async def echo(body: dict[str, Any]) -> dict[str, Any]:
        return body

    @app.post("/refuse")
    async def refuse(request: Request) -> None:
        said = json.loads(await request.body())
        raise Problem(422, "No", message("lamp.no", "no {said}", said=str(said)), extra={"said": said})

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
    monkeypatch.setattr("handover.serving.service.CHECK_TIMEOUT_S", 0.05)
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


ANY_TEXT = st.text(st.characters(exclude_categories=()) | st.sampled_from("\ud800\udfff\0"), max_size=6)
ANY_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.integers(2**62, 2**65) | st.floats() | ANY_TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(ANY_TEXT, inner, max_size=3),
    max_leaves=6,
)


@given(st.dictionaries(ANY_TEXT, ANY_JSON, max_size=3))
@example({"x": "\ud800"})
@example({"\udfff": 1})
@example({"x": [math.nan]})
@example({"x": -math.inf})
@example({"x": 2**63})
@example({"x": "\ud83d\ude00"})
async def test_a_body_is_one_that_every_part_can_store_and_send_or_is_refused(body: dict[str, Any]) -> None:
    transport = httpx.ASGITransport(an_app())
    async with httpx.AsyncClient(transport=transport, base_url="http://lamp") as client:
        text = json.dumps(body).encode()
        headers = {"Content-Type": "application/json"}
        answer = await client.post("/echo", content=text, headers=headers)
        refusal = await client.post("/refuse", content=text, headers=headers)
    assert answer.status_code == (200 if is_portable(text) else 422), answer.text
    if answer.status_code == 200:
        assert answer.json() == json.loads(text)
    else:
        assert answer.json()["detail"].startswith(("body", "a name in body"))
    assert refusal.status_code == 422
    assert orjson.loads(refusal.content)["title"] == "No"


def is_portable(text: bytes) -> bool:
    """Return whether a strict reader of JSON accepts a text, and a database its numbers."""
    try:
        orjson.loads(text)
    except orjson.JSONDecodeError:
        return False
    return all(-(2**63) <= number < 2**63 for number in integers_in(json.loads(text)))


def integers_in(value: Any) -> list[int]:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    own = [value] if isinstance(value, int) else []
    return [*own, *(number for one in inner for number in integers_in(one))]


async def test_a_path_with_several_routes_is_refused_with_the_methods_of_all() -> None:
    app = create_app("shelf", description="A shelf.")

    @app.post("/boxes/test")
    async def test_box() -> None: ...

    for method in ("GET", "PUT", "DELETE"):

        @app.api_route("/boxes/{box}", methods=[method])
        async def box(box: str) -> None: ...

    @app.get("/{page:path}", include_in_schema=False)
    async def page(page: str) -> None: ...

    transport = httpx.ASGITransport(app)
    async with httpx.AsyncClient(transport=transport, base_url="http://shelf") as http:
        for path, allowed in (("/boxes/1", "DELETE, GET, PUT"), ("/boxes/test", "POST"), ("/other", "GET")):
            refused = await http.request("PATCH", path)
            assert (refused.status_code, refused.headers["allow"]) == (405, allowed)
            assert refused.json()["detail"] == f"PATCH is no method of {path}; use {allowed}"
