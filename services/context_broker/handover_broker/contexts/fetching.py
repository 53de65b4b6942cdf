"""Fetches an @context over HTTP: once for all requests that wait for it, and not repeatedly while it fails.

A failure is remembered for twice the time that it took, so that ten requests do not wait ten times.
"""

import asyncio
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any, Final
from urllib.parse import urljoin, urlsplit

import orjson

from handover.errors import Problem
from handover.network.http_client import BodyReadingHttpClient, SendError
from handover.network.outbound_policy import OutboundPolicy
from handover.settings import PASSWORD_IN_URL, STARS
from handover_broker.model.problems import bad_request_data, context_not_available
from handover_broker.model.validation import shown

MAX_CONTEXT_BYTES: Final = 1024 * 1024
"""Maximum size of an inflated @context: twice that of the largest published ones."""
MAX_REDIRECTS: Final = 5
LEAST_PAUSE_S: Final = 1.0
"""How long a URL that failed at once is not requested again."""
MAX_FAILURES: Final = 1000
"""URLs whose failure is remembered; further ones are requested again at once."""
MIN_KEPT_S: Final = 60.0
"""Minimum time that a context is cached, whatever its server says."""
USUALLY_KEPT_S: Final = 86_400.0
"""How long a context is cached whose server does not say."""
MAX_KEPT_S: Final = 30 * 86_400.0
_MAX_AGE: Final = re.compile(r"(?:^|[\s,])max-age=\"?([0-9]{1,10})")
_HEADERS: Final = (
    ("Accept", "application/ld+json, application/json;q=0.9"),
    ("Accept-Encoding", "gzip"),
    ("User-Agent", "handover-context-broker"),
    ("Connection", "close"),
)
_REDIRECTS: Final = frozenset({301, 302, 303, 307, 308})


@dataclass(frozen=True, slots=True)
class Fetched:
    """A document, and how long it may be cached."""

    document: Mapping[str, Any]
    kept_s: float


class Fetcher:
    """Fetches documents from addresses that `policy` allows."""

    def __init__(self, timeout_s: float, policy: OutboundPolicy, ca_files: Sequence[Path] = ()) -> None:
        self._timeout_s = timeout_s
        self._asker = BodyReadingHttpClient(policy, ca_files, MAX_CONTEXT_BYTES)
        self._on_their_way: dict[str, asyncio.Task[Fetched]] = {}
        self._failed: dict[str, tuple[float, Problem]] = {}

    async def fetch(self, url: str, *, again: bool = False) -> Fetched:
        """Return the document at `url`, an object with an "@context".

        Raises a problem: 504 when it is not available (for a while without a request, unless `again`), 400
        when it is not a context (clause 5.5.6).
        """
        if (fault := fault_of_url(url)) is not None:
            raise bad_request_data(f"the @context {_printed(url)} {fault}")
        if not again:
            self._raise_remembered(url)
        task = self._on_their_way.get(url)
        if task is None:
            task = asyncio.get_running_loop().create_task(self._attempt(url))
            self._on_their_way[url] = task
            task.add_done_callback(lambda _: self._on_their_way.pop(url, None))
        return await asyncio.shield(task)  # a client that disconnects does not stop it for the others

    def _raise_remembered(self, url: str) -> None:
        failed = self._failed.get(url)
        if failed is None:
            return
        until_s, problem = failed
        if until_s <= time.monotonic():
            del self._failed[url]
            return
        raise Problem(problem.status, problem.title, problem.detail, problem.type)

    async def _attempt(self, url: str) -> Fetched:
        began_s = time.monotonic()
        try:
            text, kept_s = await self._download(url)
            document = _context_in(text, url)
        except Problem as problem:
            took_s = time.monotonic() - began_s
            if len(self._failed) >= MAX_FAILURES:
                del self._failed[next(iter(self._failed))]
            self._failed[url] = time.monotonic() + max(LEAST_PAUSE_S, 2 * took_s), problem
            raise
        self._failed.pop(url, None)
        return Fetched(document, kept_s)

    async def _download(self, url: str) -> tuple[bytes, float]:
        """Return the text at `url`, and for how many seconds it may be cached.

        Each redirect is a new request: its URL is checked, and its host resolved and checked, like the first.
        """
        at = url
        try:
            async with asyncio.timeout(self._timeout_s):
                for _ in range(MAX_REDIRECTS + 1):
                    reply = await self._asker.request("GET", at, _HEADERS, b"", self._timeout_s)
                    if reply.status not in _REDIRECTS:
                        break
                    at = _redirected(at, reply.headers.get("location", ""))
                    if (fault := fault_of_url(at)) is not None:
                        raise unavailable(url, f"it redirects to {_printed(at)}, which {fault}")
                else:
                    raise unavailable(url, f"it is redirected more than {MAX_REDIRECTS} times")
        except TimeoutError:
            raise unavailable(url, f"no response within {self._timeout_s:g} s") from None
        except SendError as error:
            cause = str(error) if at == url else f"it redirects to {_printed(at)}: {error}"
            raise unavailable(url, cause) from None
        if reply.status != 200:
            raise unavailable(url, f"the server answers {reply.status}")
        return reply.body, kept_for_s(reply.headers)


def fault_of_url(url: str) -> str | None:
    """Return why the broker does not fetch a URL, None if it may."""
    try:
        parts = urlsplit(url)
        is_usable = parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:
        is_usable = False
    if not is_usable or not url.isascii() or not url.isprintable() or " " in url:
        return "is not an http or https URL of plain characters"
    if parts.username is not None or parts.password is not None:
        return "carries credentials; publish the @context where none are needed"
    return None


def _redirected(at: str, location: str) -> str:
    try:
        return urljoin(at, location)
    except ValueError:
        return location


def _printed(url: str) -> str:
    return shown(PASSWORD_IN_URL.sub(rf"\1{STARS}@", url))


def kept_for_s(headers: Mapping[str, str]) -> float:
    """Return for how many seconds a response with these headers may be cached (RFC 9111, clauses 4.2,
    5.2)."""
    wanted: float | None = None
    control = headers.get("cache-control", "").lower()
    if match := _MAX_AGE.search(control):
        wanted = float(match[1])
    elif "no-cache" in control or "no-store" in control:
        wanted = 0.0
    elif (expires := headers.get("expires")) is not None:
        try:
            wanted = parsedate_to_datetime(expires).timestamp() - time.time()
        except (ValueError, OverflowError):
            wanted = 0.0  # RFC 9111: an invalid time is in the past
    return min(max(USUALLY_KEPT_S if wanted is None else wanted, MIN_KEPT_S), MAX_KEPT_S)


def _context_in(text: bytes, url: str) -> Mapping[str, Any]:
    try:
        document = orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise _unusable(url, f"it is not JSON ({error})") from None
    if not isinstance(document, dict) or "@context" not in document:
        raise _unusable(url, 'it is no object with an "@context"')
    return document


def _unusable(url: str, cause: str) -> Problem:
    return bad_request_data(
        f"the document at {url} is not an @context: {cause}; give the URL of a JSON-LD context, or correct it"
    )


def unavailable(url: str, cause: str) -> Problem:
    """The @context at a URL is not available."""
    return context_not_available(
        f"the @context {url} cannot be loaded: {cause}; "
        "make it reachable from the broker and send the request again"
    )
