"""The @contexts that readers and writers name their things by, looked up without the network where possible.

What we ship is answered from the package; any other URL is fetched once, kept in the journal, and never
asked for again. One that cannot be fetched is an error now and is tried again at the next request.
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import orjson

from datamodels.contexts import ContextNotAvailable, TermMap, resolve
from services.context_broker.entity import Terms
from services.context_broker.problems import bad_request_data, context_not_available

CORE: Final = "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context-v1.8.jsonld"
LARGEST_CONTEXT: Final = 1024 * 1024
LARGEST_REMEMBERED: Final = 32 * 1024
"""Bytes of a context given in a body that is kept parsed."""
MOST_CONTEXTS: Final = 1000
"""Contexts kept parsed; the least recently made are forgotten first."""
_ACCEPT: Final = {"Accept": "application/ld+json, application/json;q=0.9"}

Keep = Callable[[str, bytes], Awaitable[None]]
"""Stores a fetched context, so that it is there after a restart."""


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """An @context ready for use: `document` as it was given, `link` its URL if it has one."""

    key: int
    terms: Terms
    document: Any
    text: bytes
    link: str | None


class ContextBook:
    """All contexts the broker has met. `keep` stores those that had to be fetched."""

    def __init__(self, keep: Keep, timeout_s: float) -> None:
        self._keep = keep
        self._timeout_s = timeout_s
        self._ready: dict[str | bytes, Context] = {}
        self._fetched: dict[str, Mapping[str, Any]] = {}
        self._made = 0

    def remember(self, url: str, stored: bytes) -> None:
        """Take a context that was fetched before a restart."""
        self._fetched[url] = orjson.loads(stored)

    async def of(self, given: Any) -> Context:
        """Return the context for a URL, an object, a list of them, or None for the core context alone.

        Raises a problem with status 504 when one cannot be loaded, 400 when one is malformed.
        """
        key: str | bytes = given if isinstance(given, str) else orjson.dumps(given)
        ready = self._ready.get(key)
        return ready if ready is not None else await self._make(key, given)

    async def _make(self, key: str | bytes, given: Any) -> Context:
        terms = await self._terms(given)
        if len(self._ready) >= MOST_CONTEXTS:
            del self._ready[next(iter(self._ready))]
        self._made += 1
        document = CORE if given is None else given
        context = Context(self._made, terms, document, orjson.dumps(document), _link(document))
        if len(key) <= LARGEST_REMEMBERED:
            self._ready[key] = context
        return context

    async def _terms(self, given: Any) -> Terms:
        """Return what the names in `given` stand for, once everything it refers to is there."""
        while True:
            try:
                return TermMap(given, self._known)
            except ContextNotAvailable as missing:
                await self._load(missing.url)
            except ValueError as error:
                raise bad_request_data(f"the @context cannot be used: {error}") from None

    def _known(self, url: str) -> Mapping[str, Any] | None:
        return resolve(url) or self._fetched.get(url)

    async def _load(self, url: str) -> None:
        text = await self._fetch(url)
        document = _context_in(text, url)
        await self._keep(url, text)
        self._fetched[url] = document

    async def _fetch(self, url: str) -> bytes:
        import httpx  # noqa: PLC0415 - takes time to load, and most brokers never fetch a context

        if not url.startswith(("http://", "https://")):
            raise bad_request_data(f"the @context {url!r} is no http or https URL")
        try:
            async with (
                asyncio.timeout(self._timeout_s),
                httpx.AsyncClient(follow_redirects=True, timeout=self._timeout_s, trust_env=False) as client,
                client.stream("GET", url, headers=_ACCEPT) as answer,
            ):
                answer.raise_for_status()
                text = bytearray()
                async for chunk in answer.aiter_bytes():
                    text += chunk
                    if len(text) > LARGEST_CONTEXT:
                        raise _unavailable(url, f"it is larger than {LARGEST_CONTEXT} bytes")
                return bytes(text)
        except TimeoutError:
            raise _unavailable(url, f"no answer within {self._timeout_s:g} s") from None
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise _unavailable(url, str(error) or type(error).__name__) from None


def _context_in(text: bytes, url: str) -> Mapping[str, Any]:
    try:
        document = orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise _unavailable(url, f"it is not JSON ({error})") from None
    if not isinstance(document, dict) or "@context" not in document:
        raise _unavailable(url, 'it is no object with an "@context"')
    return document


def _unavailable(url: str, cause: str) -> Exception:
    return context_not_available(
        f"the @context {url} cannot be loaded: {cause}; "
        "make it reachable from the broker and send the request again"
    )


def _link(document: Any) -> str | None:
    """Return the one URL that stands for a context in a Link header, None if none can."""
    if isinstance(document, str):
        return document
    if isinstance(document, list):
        urls = [one for one in document if "ngsi-ld-core-context" not in str(one)]
        if len(urls) == 1 and isinstance(urls[0], str):
            return urls[0]
    return None
