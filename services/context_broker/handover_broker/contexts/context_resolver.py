"""Resolves the @contexts that clients use, without the network where possible.

Contexts that are shipped with the broker are read from the package. Any other URL is fetched once, stored in
the journal, and fetched again in the background when it expires. A context that cannot be fetched is an
error, and is tried again later.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import orjson

from handover.errors import Problem
from handover.telemetry import get_logger
from handover_broker.contexts.context_store import (
    ContextStore,
    Documents,
    StoredContext,
    cached,
    hosted,
    implicit,
    restored,
    shown_to,
)
from handover_broker.contexts.fetching import MAX_CONTEXT_BYTES, Fetcher, unavailable
from handover_broker.contexts.own_address import OwnAddress
from handover_broker.contexts.usage import Usage
from handover_broker.model.context import Context
from handover_broker.model.entity import Terms
from handover_broker.model.problems import bad_request_data, too_large
from handover_broker.model.validation import moment
from handover_broker.storage.entries import DocumentKey, DocumentKind
from handover_datamodels.contexts import (
    HANDOVER_URL,
    SHOP4CF_URL,
    SMART_DATA_MODELS_URL,
    ContextNotAvailable,
    TermMap,
    is_core,
    resolve,
)

log = get_logger(__name__)

CORE: Final = "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context-v1.8.jsonld"
SHIPPED: Final = (HANDOVER_URL, SHOP4CF_URL, SMART_DATA_MODELS_URL)
"""@contexts that are looked at first for a name."""
LARGEST_REMEMBERED: Final = 32 * 1024
"""Maximum size of a context in a body that is cached."""
MAX_CONTEXTS: Final = 1000
"""Maximum parsed contexts; the oldest are removed first."""
MAX_FETCHED: Final = 5000
"""Maximum fetched contexts; the least recently used one is replaced."""
PUT_OFF_S: Final = 600.0
"""Delay before an expired context is fetched again after a failure."""

Keep = Callable[[Documents], Awaitable[None]]
"""Writes documents and returns once they are durable; raises a problem (507) if the disk refuses."""


@dataclass(frozen=True, slots=True, eq=False)
class _ResolvedContext(Context):
    """A context with the stored contexts that it was made of."""

    uses: tuple[StoredContext, ...] = ()


class ContextResolver:
    """All contexts that the broker knows.

    `keep` writes documents that must be durable, `keep_later` statistics of their use.
    """

    def __init__(
        self,
        keep: Keep,
        keep_later: Callable[[Documents], None],
        fetcher: Fetcher,
        own: OwnAddress,
        default: str | None = None,
    ) -> None:
        self.default = default
        """The URL of the context of requests without one (clause 5.5.5); None is the core context alone."""
        self.on_renewal: Callable[[str], Awaitable[None]] = _nobody
        """Called with the local identifier of a context whose content has changed."""
        self._keep = keep
        self._fetcher = fetcher
        self._own = own
        self._shelf = ContextStore()
        self.usage = Usage(self._shelf, keep_later, self._refresh)
        self._shipped: dict[str, StoredContext] = {}
        self._ready: dict[str | bytes, _ResolvedContext] = {}
        self._made = 0
        self._needed: set[str] = set()
        self._refreshing: set[asyncio.Task[None]] = set()

    def base(self, headers: Mapping[bytes, bytes]) -> str:
        """Return the URL of the broker for the client of a request with these headers."""
        return self._own.configured or self._own.called(headers.get(b"host", b""))

    def is_ours(self, url: str) -> bool:
        """Return whether a URL without a path is that of this broker."""
        return self._own.is_at(url)

    # Stored contexts

    def remember(self, tenant: str, key: str, stored: bytes) -> str:
        """Load a stored context, and return its local identifier."""
        context = restored(tenant, key, stored)
        if (before := self._shelf.named(context.id)) is not None:
            context.hits, context.used_s, context.hits_kept = before.hits, before.used_s, before.hits_kept
            self._unready(before)
        self._shelf.put(context)
        return context.id

    def forget(self, key: str) -> None:
        """Remove a context."""
        context = self._shelf.named(key)
        if context is not None:
            self._unready(context)
            self._shelf.remove(context)

    async def tidy(self) -> None:
        """Delete contexts that are not needed any more; call it once all subscriptions are loaded."""
        gone = [stored for stored in self._shelf if stored.gone and stored.id not in self._needed]
        self._needed.clear()
        self._ready = {
            key: ready for key, ready in self._ready.items() if not any(use.gone for use in ready.uses)
        }
        for context in gone:
            self._shelf.remove(context)
        if gone:
            await self._keep(_erasing(gone))

    # For requests

    async def of(self, document: Any) -> Context:
        """Return the context for a URL, an object, a list of them, or None for the core context alone.

        Raises a problem with status 504 when one cannot be loaded, 400 when one is malformed.
        """
        key: str | bytes = document if isinstance(document, str) else orjson.dumps(document)
        return self.at_hand(key) or self._noted(await self._make(key, document))

    async def link_with(self, name: str, iri: str) -> str | None:
        """Return the URL of an @context that gives a name this IRI, of those at hand; None if none does."""
        for url in SHIPPED:
            if url not in self._ready:
                await self._make(url, url)
        ready = [self._ready[url] for url in SHIPPED if url in self._ready]
        candidates = (resolved for resolved in (*ready, *self._ready.values()) if resolved.link is not None)
        return next((resolved.link for resolved in candidates if resolved.terms.expand(name) == iri), None)

    def at_hand(self, key: str | bytes) -> Context | None:
        """Return the context of a URL, or of a document as JSON, if it is cached."""
        ready = self._ready.get(key)
        return None if ready is None else self._noted(ready)

    def _noted(self, context: _ResolvedContext) -> _ResolvedContext:
        """Count the use of a context, and return it."""
        if context.uses:
            self.usage.note(context.uses)
        return context

    async def as_before(self, document: Any) -> Context:
        """Return a context that was in use before a restart, even if it was deleted since; never fetches.

        A missing one is replaced by the core context: stored names are expanded already.
        """
        key: str | bytes = document if isinstance(document, str) else orjson.dumps(document)
        ready = self._ready.get(key)
        if ready is not None:
            return ready
        met: list[StoredContext] = []
        try:
            terms = TermMap(document, lambda url: self._met(url, met, of_before=True))
            self._needed.update(stored.id for stored in met)
        except ValueError as error:
            log.warning("a context in use is missing", context=str(document)[:200], why=str(error))
            return await self.of(None)
        return self._remembered(key, document, terms, met)

    async def linked(self, context: Context, tenant: str, base: str) -> Context:
        """Return the context with a URL for a Link header, of the broker at `base` if it has none.

        One that was given in a body is stored as implicitly created (clause 5.8.1.4).
        """
        if context.link is not None:
            return context
        linked = implicit(tenant, {"@context": context.document})
        stored = self._shelf.named(linked.id)
        if stored is None or stored.gone:
            await self._keep_one(linked)
        return await self.of((stored or linked).address(base))

    async def _make(self, key: str | bytes, document: Any) -> _ResolvedContext:
        """Return a context once everything it refers to is loaded."""
        while True:
            met: list[StoredContext] = []
            try:
                terms = TermMap(document, partial(self._met, met=met))
            except ContextNotAvailable as missing:
                await self._fetch(missing.url)
            except ValueError as error:
                raise bad_request_data(f"the @context cannot be used: {error}") from None
            else:
                return self._remembered(key, document, terms, met)

    def _remembered(
        self, key: str | bytes, reference: Any, terms: Terms, met: list[StoredContext]
    ) -> _ResolvedContext:
        if len(self._ready) >= MAX_CONTEXTS:
            del self._ready[next(iter(self._ready))]
        self._made += 1
        document = CORE if reference is None else reference
        text = orjson.dumps(document)
        uses = tuple(dict.fromkeys(met))
        parts = frozenset(use.id for use in uses)
        context = _ResolvedContext(self._made, terms, document, text, _link(document), parts, uses)
        if len(key) <= LARGEST_REMEMBERED:
            self._ready[key] = context
        return context

    def _met(
        self, url: str, met: list[StoredContext], *, of_before: bool = False
    ) -> Mapping[str, Any] | None:
        """Return the document of a URL if it is loaded, and add its context to `met`."""
        stored = self._at(url, of_before=of_before)
        if stored is None:
            return None
        met.append(stored)
        return stored.document

    def _at(self, url: str, *, of_before: bool = False) -> StoredContext | None:
        stored = self._shelf.at(url)
        if stored is not None and (of_before or not stored.gone):
            return stored
        return self._of_package(url)

    def _of_package(self, url: str) -> StoredContext | None:
        """Return a context that is shipped with the broker."""
        shipped = self._shipped.get(url)
        if shipped is None and (document := resolve(url)) is not None:
            shipped = self._shipped[url] = cached(url, document)
        return shipped

    async def _fetch(self, url: str) -> None:
        fetched = await self._fetcher.fetch(url)
        if self._at(url) is not None:  # another request fetched it
            return
        others = [stored for stored in self._shelf if stored.url is not None]
        if len(others) >= MAX_FETCHED:
            oldest = min(others, key=lambda stored: stored.used_s or moment(stored.created_at) or 0.0)
            await self._keep(_erasing([oldest]))
            self._unready(oldest)
            self._shelf.remove(oldest)
        await self._keep_one(cached(url, fetched.document, time.time() + fetched.kept_s))

    def _refresh(self, context: StoredContext) -> None:
        """Fetch an expired context again in the background."""
        context.expires_s = time.time() + PUT_OFF_S
        task = asyncio.get_running_loop().create_task(self._refreshed(context))
        self._refreshing.add(task)
        task.add_done_callback(self._refreshing.discard)

    async def _refreshed(self, context: StoredContext) -> None:
        url = context.url or ""
        try:
            fresh = await self._fetched(url)
            if self._shelf.at(url) is not context or context.gone:
                return
            if fresh.document == context.document:
                context.expires_s = fresh.expires_s
                await self._keep({(DocumentKind.CONTEXT, context.tenant, context.key): context.stored()})
            else:
                await self._replace(context, fresh)
        except Problem as problem:
            log.info("an expired context could not be fetched; it stays in use", url=url, why=problem.detail)
        except Exception:
            log.exception("a context could not be fetched again", url=url)

    async def _fetched(self, url: str) -> StoredContext:
        """Return what is published at `url` now; raise a problem (504) if it is not a context."""
        try:
            fetched = await self._fetcher.fetch(url, again=True)
            TermMap(fetched.document, lambda _: {"@context": {}})
        except ValueError as error:
            raise unavailable(url, str(error)) from None
        except Problem as problem:
            raise unavailable(url, problem.detail) if problem.status == 400 else problem from None
        return cached(url, fetched.document, time.time() + fetched.kept_s)

    async def _replace(self, context: StoredContext, fresh: StoredContext) -> None:
        fresh.hits, fresh.used_s = context.hits, context.used_s
        await self._keep_one(fresh)
        self._unready(context)
        await self.on_renewal(context.id)

    async def _keep_one(self, context: StoredContext) -> None:
        await self._keep({(DocumentKind.CONTEXT, context.tenant, context.key): context.stored()})
        self._shelf.put(context)

    def _unready(self, context: StoredContext) -> None:
        """Remove everything that was made of a changed context from the cache."""
        ours = {context.id}
        self._ready = {
            key: ready for key, ready in self._ready.items() if ours.isdisjoint(use.id for use in ready.uses)
        }

    # For clients (clause 5.13)

    def all(self, tenant: str) -> list[StoredContext]:
        """Return the contexts that a tenant may see, and the core context."""
        contexts = shown_to(tenant, self._shelf)
        urls = {context.url for context in contexts}
        core = self._of_package(CORE)
        used = [shipped for shipped in self._shipped.values() if shipped is core or shipped.hits]
        return [*(shipped for shipped in used if shipped.url not in urls), *contexts]

    def named(self, name: str, tenant: str) -> StoredContext | None:
        """Return the context with a local identifier or URL, None if the tenant sees none."""
        context = self._shelf.named(name)
        if context is not None and shown_to(tenant, [context]):
            return context
        shipped = next((stored for stored in self._shipped.values() if stored.id == name), None)
        return shipped or self._of_package(name)

    def served(self, own_id: str) -> StoredContext | None:
        """Return the context of a local identifier, of any tenant."""
        context = self._shelf.named(own_id)
        return None if context is None or context.gone else context

    async def add(self, tenant: str, document: Any) -> StoredContext:
        """Store a context of a client; raise a problem: 400 if it is not one, 413 if it is too large."""
        context = hosted(tenant, {"@context": document})
        try:
            TermMap(document, lambda _: {"@context": {}})  # what it refers to is loaded when it is used
        except ValueError as error:
            raise bad_request_data(f"the @context cannot be used: {error}") from None
        stored = context.stored()
        if len(stored) > MAX_CONTEXT_BYTES:
            raise too_large(f"the @context has {len(stored)} bytes; the maximum is {MAX_CONTEXT_BYTES}")
        await self._keep_one(context)
        return context

    async def delete(self, context: StoredContext) -> None:
        """Delete a context. Subscriptions that were made with it continue to use it."""
        context.gone = True
        try:
            await self._keep(
                {
                    (DocumentKind.CONTEXT, context.tenant, context.key): context.stored(),
                    (DocumentKind.CONTEXT_USAGE, context.tenant, context.key): None,
                }
            )
        except Problem:
            context.gone = False
            raise
        self._unready(context)

    async def reload(self, context: StoredContext) -> None:
        """Fetch a cached context again; the present one stays if that fails (problem 504, clause
        5.13.5.4)."""
        await self._replace(context, await self._fetched(context.url or ""))

    def is_shipped(self, context: StoredContext) -> bool:
        """Return whether a context is shipped with the broker, and not stored in another version."""
        return self._shipped.get(context.url or "") is context

    @staticmethod
    def is_core(context: StoredContext) -> bool:
        """Return whether a context is the core context, of any version."""
        return context.url is not None and is_core(context.url)


async def _nobody(_: str) -> None:
    """Do nothing."""


def _erasing(gone: list[StoredContext]) -> dict[DocumentKey, bytes | None]:
    kinds = (DocumentKind.CONTEXT, DocumentKind.CONTEXT_USAGE)
    return {(kind, stored.tenant, stored.key): None for stored in gone for kind in kinds}


def _link(document: Any) -> str | None:
    """Return the one URL that represents a context in a Link header, None if there is none."""
    if isinstance(document, str):
        return document
    if isinstance(document, list):
        urls = [part for part in document if not (isinstance(part, str) and is_core(part))]
        if len(urls) == 1 and isinstance(urls[0], str):
            return urls[0]
    return None
