"""A body that is too large is refused before it is parsed, whether it says its length or not."""

from collections.abc import AsyncIterator

import httpx
import pytest

from handover.http.body_limit import DEFAULT_MAX_BODY_BYTES, max_body
from handover.serving.service import MAX_FAULTS_LISTED, create_app

TOO_LARGE = b"[" + b"1," * (DEFAULT_MAX_BODY_BYTES // 2) + b"1]"


@pytest.fixture
async def client() -> AsyncIterator[httpx.AsyncClient]:
    app = create_app("Sums", description="")

    @app.post("/sums")
    async def add(numbers: list[int]) -> int:
        return sum(numbers)

    @app.post("/large")
    @max_body(2 * len(TOO_LARGE))
    async def add_many(numbers: list[int]) -> int:
        return sum(numbers)

    @app.post("/notifications/{rule}")
    async def notify(rule: str, numbers: list[int]) -> int:
        return len(numbers)

    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://sums") as made:
        yield made


async def in_pieces(body: bytes) -> AsyncIterator[bytes]:
    for start in range(0, len(body), 65_536):
        yield body[start : start + 65_536]


async def test_a_large_body_is_refused_with_the_limit(client: httpx.AsyncClient) -> None:
    assert (await client.post("/sums", json=[1, 2])).json() == 3
    headers = {"content-type": "application/json"}
    for body in (TOO_LARGE, in_pieces(TOO_LARGE)):
        refused = await client.post("/sums", content=body, headers=headers)
        assert refused.status_code == 413
        assert refused.headers["content-type"] == "application/problem+json"
        assert f"more than {DEFAULT_MAX_BODY_BYTES} bytes" in refused.json()["detail"]


async def test_a_route_may_take_more_and_a_notification_is_larger(client: httpx.AsyncClient) -> None:
    headers = {"content-type": "application/json"}
    for path in ("/large", "/notifications/rule"):
        answer = await client.post(path, content=TOO_LARGE, headers=headers)
        assert answer.is_success, answer.text
    refused = await client.post("/large", content=TOO_LARGE * 2 + b" ", headers=headers)
    assert refused.status_code == 413


async def test_of_very_many_faults_the_answer_names_the_first(client: httpx.AsyncClient) -> None:
    refused = await client.post("/sums", json=["x"] * 1000)
    assert refused.status_code == 422
    detail = refused.json()["detail"]
    assert detail.count("unable to parse") == MAX_FAULTS_LISTED
    assert detail.endswith(f"and {1000 - MAX_FAULTS_LISTED} more")
