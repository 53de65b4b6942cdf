"""A flood of attempts to sign in is refused before anything is done for it, and shuts nobody out."""

from collections import Counter
from typing import Any

import httpx
import pytest
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send

from handover_web.http.sign_in_rate import IN_A_FLOOD, MAX_NETWORKS, OF_ALL, USUAL, SignInRate

PERSON = "192.0.2.7"


class Page:
    """The page server, which counts the attempts that reach it."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.reached: Counter[str] = Counter()
        self.status = 401
        self.rate = SignInRate(self._answer, lambda: self.now_s)

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        self.reached[scope["client"][0]] += 1
        await PlainTextResponse("", self.status)(scope, receive, send)

    async def ask(self, address: str, method: str = "POST", path: str = "/api/session") -> httpx.Response:
        transport: Any = httpx.ASGITransport(self.rate, client=(address, 1))
        async with httpx.AsyncClient(transport=transport, base_url="http://cell") as client:
            return await client.request(method, path)


@pytest.fixture
def page() -> Page:
    return Page()


async def test_an_address_has_enough_for_many_people_and_no_more(page: Page) -> None:
    many = int(USUAL.burst)
    assert {(await page.ask(PERSON)).status_code for _ in range(many)} == {401}
    refused = await page.ask(PERSON)
    assert refused.status_code == 429
    assert int(refused.headers["retry-after"]) >= 1
    assert refused.json()["detailCode"] == "session.too_many_attempts"
    page.now_s += float(refused.headers["retry-after"])
    assert (await page.ask(PERSON)).status_code == 401, "after the time that it was asked to wait"
    assert (await page.ask("192.0.2.8")).status_code == 401, "another address is not concerned"
    assert (await page.ask("2001:db8::1")).status_code == 401


async def test_in_a_flood_from_many_addresses_a_person_signs_in_at_once(page: Page) -> None:
    attackers = [f"203.0.113.{number}" for number in range(100)]
    for number in range(int(3 * OF_ALL.burst)):
        page.now_s += 0.001
        await page.ask(attackers[number % len(attackers)])
    before = page.reached.total()
    for number in range(100):
        page.now_s += 0.001
        await page.ask(attackers[number % len(attackers)])
    assert page.reached.total() - before == 0, "the flood does not reach accounts any more"
    tries = [(await page.ask(PERSON)).status_code for _ in range(int(IN_A_FLOOD.burst) + 1)]
    assert tries == [401] * int(IN_A_FLOOD.burst) + [429]
    page.status = 200
    again = [(await page.ask("192.0.2.8")).status_code for _ in range(int(IN_A_FLOOD.burst) + 2)]
    assert set(again) == {200}, "attempts that succeed do not count"
    page.now_s += 2 * OF_ALL.burst / OF_ALL.per_s
    assert (await page.ask(PERSON)).status_code == 200, "afterwards all is as usual"


async def test_what_is_no_attempt_is_never_refused(page: Page) -> None:
    for _ in range(int(2 * OF_ALL.burst)):
        await page.ask(PERSON)
    assert (await page.ask(PERSON)).status_code == 429
    assert (await page.ask(PERSON, "GET")).status_code == 401
    assert (await page.ask(PERSON, "POST", "/api/live")).status_code == 401


async def test_the_memory_of_a_flood_is_bounded(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("handover_web.http.sign_in_rate.MAX_NETWORKS", 10)
    assert MAX_NETWORKS > 10
    for number in range(50):
        await page.ask(f"203.0.113.{number}")
    assert len(page.rate._networks) == 10
