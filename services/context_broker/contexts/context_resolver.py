"""The @contexts that readers and writers name their things by, looked up without the network where possible.

What we ship is answered from the package; any other URL is fetched once, kept in the journal, and asked for
again when its time is over, beside the requests that use what there is. One that cannot be fetched is an
error, and is tried again later.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import orjson

from datamodels.contexts import ContextNotAvailable, TermMap, is_core, resolve
from handover.errors import Problem
from handover.telemetry import get_logger
from services.context_broker.contexts.context_store import (
    ContextStore,
    Documents,
    StoredContext,
    cached,
    hosted,
    implicit,
    restored,
    shown_to,
)
from services.context_broker.contexts.fetching import MAX_CONTEXT_BYTES, Fetcher, unavailable
from services.context_broker.contexts.own_address import OwnAddress
from services.context_broker.contexts.usage import Usage
from services.context_broker.model.context import Context
from services.context_broker.model.entity import Terms
from services.context_broker.model.problems import bad_request_data, too_large
from services.context_broker.model.validation import moment
from services.context_broker.storage.entries import DocumentKey, Kind

log = get_logger(__name__)

CORE: Final = "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context-v1.8.jsonld"
LARGEST_REMEMBERED: Final = 32 * 1024
"""Bytes of a context given in a body that is kept parsed."""
MAX_CONTEXTS: Final = 1000
"""Contexts kept parsed; the least recently made are forgotten first."""
MAX_FETCHED: Final = 5000
"""Contexts that were fetched and are kept; beyond it the one not used for longest makes room."""
PUT_OFF_S: Final = 600.0
"""When a context whose time is over is asked for again if it could not be fetched anew."""

Keep = Callable[[Documents], Awaitable[None]]
"""Writes documents and returns once they are safe; raises a problem (507) if the disk refuses."""


@dataclass(frozen=True, slots=True, eq=False)
class _ResolvedContext(Context):
    """A context with the stored contexts that it was made of."""

    uses: tuple[StoredContext, ...] = ()


class ContextResolver:
    """All contexts the broker has met.

    `keep` writes those that must survive, `keep_later` how they were used, in passing.
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
        """The URL of the context of who gives none (clause 5.5.5); None is the core context alone."""
        self.on_renewal: Callable[[str], Awaitable[None]] = _nobody
        """Is told the local identifier of a context that was fetched anew and is another now."""
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
        """Return where the asker of a request with these headers reaches the broker."""
        return self._own.told or self._own.called(headers.get(b"host", b""))

    def is_ours(self, url: str) -> bool:
        """Say whether a URL without a path leads to this broker."""
        return self._own.is_at(url)

    # What the journal holds

    def remember(self, tenant: str, key: str, stored: bytes) -> str:
        """Take a context as the journal has it, from before a restart or from another process.

        Returns its local identifier.
        """
        one = restored(tenant, key, stored)
        if (before := self._shelf.named(one.id)) is not None:
            one.hits, one.used_s, one.hits_kept = before.hits, before.used_s, before.hits_kept
            self._unready(before)
        self._shelf.put(one)
        return one.id

    def forget(self, key: str) -> None:
        """Forget a context that the journal no longer has."""
        one = self._shelf.named(key)
        if one is not None:
            self._unready(one)
            self._shelf.remove(one)

    async def tidy(self) -> None:
        """Erase what was deleted and is needed no longer; call it once all subscriptions are taken up."""
        gone = [one for one in self._shelf if one.gone and one.id not in self._needed]
        self._needed.clear()
        self._ready = {
            key: ready for key, ready in self._ready.items() if not any(one.gone for one in ready.uses)
        }
        for one in gone:
            self._shelf.remove(one)
        if gone:
            await self._keep(_erasing(gone))

    # What requests need

    async def of(self, given: Any) -> Context:
        """Return the context for a URL, an object, a list of them, or None for the core context alone.

        Raises a problem with status 504 when one cannot be loaded, 400 when one is malformed.
        """
        key: str | bytes = given if isinstance(given, str) else orjson.dumps(given)
        return self.at_hand(key) or self._noted(await self._make(key, given))

    def at_hand(self, key: str | bytes) -> Context | None:
        """Return the context of a URL, or of a document as JSON, if it can be used without waiting."""
        ready = self._ready.get(key)
        return None if ready is None else self._noted(ready)

    def _noted(self, context: _ResolvedContext) -> _ResolvedContext:
        """Return a context that is used now."""
        if context.uses:
            self.usage.note(context.uses)
        return context

    async def as_before(self, given: Any) -> Context:
        """Return a context that was in use before a restart, be it deleted since; never fetches.

        One that is not there any more is the core context: what was made with it has its names expanded.
        """
        key: str | bytes = given if isinstance(given, str) else orjson.dumps(given)
        ready = self._ready.get(key)
        if ready is not None:
            return ready
        met: list[StoredContext] = []
        try:
            terms = TermMap(given, lambda url: self._met(url, met, of_before=True))
            self._needed.update(one.id for one in met)
        except ValueError as error:
            log.warning("a context in use is not there any more", context=str(given)[:200], why=str(error))
            return await self.of(None)
        return self._remembered(key, given, terms, met)

    async def linked(self, context: Context, tenant: str, base: str) -> Context:
        """Return the context with a URL that a Link header can name, of the broker at `base` if need be.

        One that was given in a body is kept as implicitly created for that (clause 5.8.1.4).
        """
        if context.link is not None:
            return context
        one = implicit(tenant, {"@context": context.document})
        known = self._shelf.named(one.id)
        if known is None or known.gone:
            await self._keep_one(one)
        return await self.of((known or one).address(base))

    async def _make(self, key: str | bytes, given: Any) -> _ResolvedContext:
        """Return a context once everything it refers to is there."""
        while True:
            met: list[StoredContext] = []
            try:
                terms = TermMap(given, partial(self._met, met=met))
            except ContextNotAvailable as missing:
                await self._fetch(missing.url)
            except ValueError as error:
                raise bad_request_data(f"the @context cannot be used: {error}") from None
            else:
                return self._remembered(key, given, terms, met)

    def _remembered(
        self, key: str | bytes, given: Any, terms: Terms, met: list[StoredContext]
    ) -> _ResolvedContext:
        if len(self._ready) >= MAX_CONTEXTS:
            del self._ready[next(iter(self._ready))]
        self._made += 1
        document = CORE if given is None else given
        text = orjson.dumps(document)
        uses = tuple(dict.fromkeys(met))
        parts = frozenset(one.id for one in uses)
        context = _ResolvedContext(self._made, terms, document, text, _link(document), parts, uses)
        if len(key) <= LARGEST_REMEMBERED:
            self._ready[key] = context
        return context

    def _met(
        self, url: str, met: list[StoredContext], *, of_before: bool = False
    ) -> Mapping[str, Any] | None:
        """Return the document of a URL if it is there, and note in `met` what it belongs to."""
        one = self._at(url, of_before=of_before)
        if one is None:
            return None
        met.append(one)
        return one.document

    def _at(self, url: str, *, of_before: bool = False) -> StoredContext | None:
        one = self._shelf.at(url)
        if one is not None and (of_before or not one.gone):
            return one
        return self._of_package(url)

    def _of_package(self, url: str) -> StoredContext | None:
        """Return a context that is shipped with the broker; it is there without being kept."""
        one = self._shipped.get(url)
        if one is None and (document := resolve(url)) is not None:
            one = self._shipped[url] = cached(url, document)
        return one

    async def _fetch(self, url: str) -> None:
        fetched = await self._fetcher.fetch(url)
        if self._at(url) is not None:  # others waited for the same
            return
        others = [one for one in self._shelf if one.url is not None]
        if len(others) >= MAX_FETCHED:
            oldest = min(others, key=lambda one: one.used_s or moment(one.created_at) or 0.0)
            await self._keep(_erasing([oldest]))
            self._unready(oldest)
            self._shelf.remove(oldest)
        await self._keep_one(cached(url, fetched.document, time.time() + fetched.kept_s))

    def _refresh(self, one: StoredContext) -> None:
        """Fetch a context anew whose time is over, beside the requests that use what there is."""
        one.expires_s = time.time() + PUT_OFF_S
        task = asyncio.get_running_loop().create_task(self._refreshed(one))
        self._refreshing.add(task)
        task.add_done_callback(self._refreshing.discard)

    async def _refreshed(self, one: StoredContext) -> None:
        url = one.url or ""
        try:
            fresh = await self._fetched(url)
            if self._shelf.at(url) is not one or one.gone:
                return
            if fresh.document == one.document:
                one.expires_s = fresh.expires_s
                await self._keep({(Kind.CONTEXT, one.tenant, one.key): one.stored()})
            else:
                await self._replace(one, fresh)
        except Problem as problem:
            log.info("a context is kept beyond its time", url=url, why=problem.detail)
        except Exception:
            log.exception("a context was not fetched anew", url=url)

    async def _fetched(self, url: str) -> StoredContext:
        """Return what is published at `url` now; raise a problem (504) if it is no context."""
        try:
            fetched = await self._fetcher.fetch(url, again=True)
            TermMap(fetched.document, lambda _: {"@context": {}})
        except ValueError as error:
            raise unavailable(url, str(error)) from None
        except Problem as problem:
            raise unavailable(url, problem.detail) if problem.status == 400 else problem from None
        return cached(url, fetched.document, time.time() + fetched.kept_s)

    async def _replace(self, one: StoredContext, fresh: StoredContext) -> None:
        fresh.hits, fresh.used_s = one.hits, one.used_s
        await self._keep_one(fresh)
        self._unready(one)
        await self.on_renewal(one.id)

    async def _keep_one(self, one: StoredContext) -> None:
        await self._keep({(Kind.CONTEXT, one.tenant, one.key): one.stored()})
        self._shelf.put(one)

    def _unready(self, one: StoredContext) -> None:
        """Forget what was made of a context that is another now."""
        ours = {one.id}
        self._ready = {
            key: ready
            for key, ready in self._ready.items()
            if ours.isdisjoint(each.id for each in ready.uses)
        }

    # What clients do with them (clause 5.13)

    def all(self, tenant: str) -> list[StoredContext]:
        """Return the contexts that a tenant may see, and the core context."""
        kept = shown_to(tenant, self._shelf)
        urls = {one.url for one in kept}
        core = self._of_package(CORE)
        used = [one for one in self._shipped.values() if one is core or one.hits]
        return [*(one for one in used if one.url not in urls), *kept]

    def named(self, name: str, tenant: str) -> StoredContext | None:
        """Return the context that a tenant names by its local identifier or its URL, None if it sees none."""
        one = self._shelf.named(name)
        if one is not None and shown_to(tenant, [one]):
            return one
        shipped = next((each for each in self._shipped.values() if each.id == name), None)
        return shipped or self._of_package(name)

    def served(self, own_id: str) -> StoredContext | None:
        """Return the context of a local identifier, whoever it belongs to."""
        one = self._shelf.named(own_id)
        return None if one is None or one.gone else one

    async def add(self, tenant: str, given: Any) -> StoredContext:
        """Keep a context that a client gave; raise a problem: 400 if it is none, 413 if it is too large."""
        one = hosted(tenant, {"@context": given})
        try:
            TermMap(given, lambda _: {"@context": {}})  # what it refers to is loaded when it is used
        except ValueError as error:
            raise bad_request_data(f"the @context cannot be used: {error}") from None
        stored = one.stored()
        if len(stored) > MAX_CONTEXT_BYTES:
            raise too_large(f"the @context has {len(stored)} bytes; {MAX_CONTEXT_BYTES} are kept")
        await self._keep_one(one)
        return one

    async def delete(self, one: StoredContext) -> None:
        """Let go of a context. Subscriptions that were made with it go on with it."""
        one.gone = True
        try:
            await self._keep(
                {
                    (Kind.CONTEXT, one.tenant, one.key): one.stored(),
                    (Kind.CONTEXT_USAGE, one.tenant, one.key): None,
                }
            )
        except Problem:
            one.gone = False
            raise
        self._unready(one)

    async def reload(self, one: StoredContext) -> None:
        """Fetch a cached context anew; what there is stays if that fails (problem 504, clause 5.13.5.4)."""
        await self._replace(one, await self._fetched(one.url or ""))

    def is_shipped(self, one: StoredContext) -> bool:
        """Say whether a context comes with the broker, and is not kept in another version."""
        return self._shipped.get(one.url or "") is one

    @staticmethod
    def is_core(one: StoredContext) -> bool:
        """Say whether a context is the core context, of whichever version."""
        return one.url is not None and is_core(one.url)


async def _nobody(_: str) -> None:
    """Nobody has anything to do with a context that is another now."""


def _erasing(gone: list[StoredContext]) -> dict[DocumentKey, bytes | None]:
    kinds = (Kind.CONTEXT, Kind.CONTEXT_USAGE)
    return {(kind, one.tenant, one.key): None for one in gone for kind in kinds}


def _link(document: Any) -> str | None:
    """Return the one URL that stands for a context in a Link header, None if none can."""
    if isinstance(document, str):
        return document
    if isinstance(document, list):
        urls = [one for one in document if not (isinstance(one, str) and is_core(one))]
        if len(urls) == 1 and isinstance(urls[0], str):
            return urls[0]
    return None
