"""Stored contexts: how long they are cached, what is fetched again, what a restart loads."""

import asyncio
from collections.abc import Mapping
from email.utils import formatdate
from typing import Any

import pytest

from handover.errors import Problem
from handover.network.outbound_policy import OutboundPolicy
from handover_broker.contexts.context_resolver import CORE, ContextResolver
from handover_broker.contexts.fetching import (
    MAX_KEPT_S,
    MIN_KEPT_S,
    USUALLY_KEPT_S,
    Fetched,
    Fetcher,
    kept_for_s,
)
from handover_broker.contexts.own_address import OwnAddress
from handover_broker.model.problems import context_not_available
from handover_broker.storage.entries import DocumentKey, DocumentKind

URL = "https://a.example/context.jsonld"


class Published(Fetcher):
    """Published contexts, without a network; one with `kept_s` below zero expires at once."""

    def __init__(self, document: Mapping[str, Any] | None, kept_s: float) -> None:
        super().__init__(1.0, OutboundPolicy())
        self.document, self.kept_s, self.asked = document, kept_s, 0

    async def fetch(self, url: str, *, again: bool = False) -> Fetched:
        self.asked += 1
        if self.document is None:
            raise context_not_available(f"{url} is not there")
        return Fetched(self.document, self.kept_s)


class Shelf:
    """A context resolver with a journal that is a dictionary."""

    def __init__(self, published: Published) -> None:
        self.published = published
        self.kept: dict[DocumentKey, bytes] = {}
        self.book = self.opened()

    def opened(self) -> ContextResolver:
        async def keep(documents: Mapping[DocumentKey, bytes | None]) -> None:
            note(documents)

        def note(documents: Mapping[DocumentKey, bytes | None]) -> None:
            for key, body in documents.items():
                if body is None:
                    self.kept.pop(key, None)
                else:
                    self.kept[key] = body

        book = ContextResolver(keep, note, self.published, OwnAddress(None, "http://127.0.0.1:1026"))
        for (kind, tenant, key), body in list(self.kept.items()):
            if kind is DocumentKind.CONTEXT:
                book.remember(tenant, key, body)
        for (kind, _, key), body in list(self.kept.items()):
            if kind is DocumentKind.CONTEXT_USAGE:
                book.usage.remember(key, body)
        return book


def context(**terms: str) -> dict[str, Any]:
    return {"@context": {term: f"https://a.example/{iri}" for term, iri in terms.items()}}


async def settled() -> None:
    """Wait until background fetches are done."""
    for _ in range(20):
        await asyncio.sleep(0)


@pytest.mark.parametrize(
    ("headers", "kept_s"),
    [
        ({}, USUALLY_KEPT_S),
        ({"cache-control": "public, max-age=3600"}, 3600),
        ({"cache-control": 'MAX-AGE="7200"'}, 7200),
        ({"cache-control": "s-maxage=9000"}, USUALLY_KEPT_S),
        ({"cache-control": "max-age=1"}, MIN_KEPT_S),
        ({"cache-control": "max-age=9999999999"}, MAX_KEPT_S),
        ({"cache-control": "no-cache"}, MIN_KEPT_S),
        ({"cache-control": "no-store", "expires": formatdate(4_000_000_000, usegmt=True)}, MIN_KEPT_S),
        ({"expires": formatdate(4_000_000_000, usegmt=True)}, MAX_KEPT_S),
        ({"expires": formatdate(0, usegmt=True)}, MIN_KEPT_S),
        ({"expires": "0"}, MIN_KEPT_S),
    ],
)
def test_response_headers_determine_how_long_a_context_is_cached(
    headers: dict[str, str], kept_s: float
) -> None:
    assert kept_for_s(headers) == kept_s


async def test_a_context_is_fetched_once_while_its_time_lasts() -> None:
    shelf = Shelf(Published(context(speed="speed"), 3600))
    for _ in range(3):
        assert (await shelf.book.of(URL)).terms.expand("speed") == "https://a.example/speed"
    shelf.book = shelf.opened()
    assert (await shelf.book.of([URL, CORE])).link == URL
    assert shelf.published.asked == 1
    (one,) = [one for one in shelf.book.all("") if one.url == URL]
    assert "expiresAt" in one.details("http://x")


async def test_an_expired_context_is_fetched_again_in_the_background() -> None:
    shelf = Shelf(Published(context(speed="old"), -1))
    before = await shelf.book.of(URL)
    shelf.published.document = context(speed="new")
    shelf.published.kept_s = 3600
    await settled()
    assert before.terms.expand("speed") == "https://a.example/old", "what is in use stays what it was"
    assert (await shelf.book.of(URL)).terms.expand("speed") in {
        "https://a.example/old",
        "https://a.example/new",
    }
    await settled()
    assert (await shelf.book.of(URL)).terms.expand("speed") == "https://a.example/new"
    assert shelf.published.asked == 2
    assert (await shelf.opened().as_before(URL)).terms.expand("speed") == "https://a.example/new"


async def test_an_expired_context_that_cannot_be_fetched_stays_in_use() -> None:
    shelf = Shelf(Published(context(speed="old"), -1))
    for document in (context(speed="old"), None, {"@context": 5}):
        await shelf.book.of(URL)
        shelf.published.document = document
        await settled()
    for _ in range(3):
        assert (await shelf.book.of(URL)).terms.expand("speed") == "https://a.example/old"
        await settled()
    assert shelf.published.asked <= 4, "and not asked for at every request"


async def test_a_missing_context_is_missing_after_a_restart_too() -> None:
    shelf = Shelf(Published(None, 3600))
    with pytest.raises(Problem, match=URL):
        await shelf.book.of(URL)
    assert (await shelf.book.as_before(URL)).document == CORE
    assert shelf.published.asked == 1, "a start asks nobody"
    with pytest.raises(Problem, match=URL):
        await shelf.book.of(URL)


async def test_a_deleted_context_serves_its_subscriptions_and_is_then_erased() -> None:
    shelf = Shelf(Published(None, 3600))
    one = await shelf.book.add("", {"speed": "https://a.example/speed"})
    url = one.address("http://127.0.0.1:1026")
    await shelf.book.of(url)
    shelf.book.usage.write()
    assert {kind for kind, _, _ in shelf.kept} == {DocumentKind.CONTEXT, DocumentKind.CONTEXT_USAGE}
    await shelf.book.delete(one)
    with pytest.raises(Problem):
        await shelf.book.of(url)
    shelf.book = shelf.opened()
    assert (await shelf.book.as_before(url)).terms.expand("speed") == "https://a.example/speed"
    await shelf.book.tidy()
    assert shelf.kept, "a subscription has it"
    with pytest.raises(Problem):
        await shelf.book.of(url)
    shelf.book = shelf.opened()
    await shelf.book.tidy()
    assert not shelf.kept
