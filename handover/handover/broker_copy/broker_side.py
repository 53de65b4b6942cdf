"""One broker in one tenant, as the source or the target of a copy.

A broker that does not answer is asked again for some seconds; `BrokerUnavailable` ends the copy then.
"""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, Final, Self, TypeVar
from urllib.parse import quote

import orjson

from handover.broker import (
    JSON_LD,
    MAX_FAULTS,
    BrokerClient,
    BrokerError,
    BrokerFault,
    BrokerUnavailable,
    Credentials,
    NotFound,
    is_presence,
)
from handover.broker.identity import BrokerIdentity
from handover.broker_copy.answers import (
    as_list,
    as_object,
    count_in,
    next_page,
    reason_of,
    refusals_in,
    terms_of,
)
from handover.broker_copy.entity_form import Json, expanded, has_instances, types_of, with_terms
from handover.formats.free_values import with_texts, without_texts
from handover.network.http_client import HttpResponse
from handover.runtime.retry import backoff_delay_s
from handover.settings import Settings
from handover_datamodels.contexts import CORE_URL
from handover_datamodels.contexts.term_map import DEFAULT_VOCAB

CONTEXTS: Final = "/jsonldContexts"
PAGE: Final = 100
FIRST_PAGE: Final = 20
PAGE_BYTES: Final = 8 * 1024 * 1024
"""Limits of a page; the first one shows how large the entities are."""
MAX_BATCH: Final = 100
MAX_BATCH_BYTES: Final = 512 * 1024
"""Limits of one batch; Orion-LD refuses bodies of more than 1 MiB."""
MAX_IDS: Final = 50
MAX_IDS_LENGTH: Final = 3000
"""Limits of a query by ids, which are in its URL."""
MAX_ATTEMPTS: Final = 6
"""Attempts of a request while the broker does not answer."""
TIMEOUT_S: Final = 60.0
_NO_LOCAL: Final = frozenset({HTTPStatus.BAD_REQUEST, HTTPStatus.NOT_IMPLEMENTED})

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class BrokerPlace:
    """A broker: the settings with its URL and the credentials for it, and which one it is."""

    settings: Settings
    identity: BrokerIdentity
    credentials: Credentials | None = None

    @property
    def url(self) -> str:
        """Its URL."""
        return self.settings.broker_url


class BrokerSide:
    """A broker in a tenant (None: the default one); an asynchronous context manager."""

    def __init__(self, place: BrokerPlace, tenant: str | None) -> None:
        self.place = place
        self.tenant = tenant
        self.listed = 0
        """Entities that `entities` has yielded."""
        self.expected: int | None = None
        """Entities that the broker counted when `entities` began, where it says so."""
        self.missed = 0
        """By how many the lists of `entities` were shorter than the broker had counted."""
        # Our broker has all core contexts; of others the one that they use themselves is never absent.
        self._context_url = CORE_URL if place.identity.is_ours else ""
        self._stack = AsyncExitStack()
        self._lists_local = True
        self._types: tuple[str, ...] = ()

    async def __aenter__(self) -> Self:
        await self._stack.__aenter__()
        self._broker = await self._stack.enter_async_context(self._client(self._context_url))
        try:
            await self.read("/entities", {"local": "true", "limit": 1})
        except NotFound:
            pass  # there is no such tenant yet
        except BrokerError as error:
            if error.status not in _NO_LOCAL:
                await self._stack.aclose()
                raise
            self._lists_local = False
        return self

    async def __aexit__(self, *reason: Any) -> None:
        await self._stack.__aexit__(*reason)

    def _client(self, context_url: str) -> BrokerClient:
        place = self.place
        settings = place.settings.model_copy(
            update={"broker_tenant": self.tenant, "context_url": context_url}
        )
        return BrokerClient(settings, credentials=place.credentials, timeout_s=TIMEOUT_S, accept=JSON_LD)

    @property
    def local(self) -> Json:
        """The parameter that keeps a request in this broker, away from its context sources."""
        return {"local": "true"} if self._lists_local else {}

    # Reading

    async def read(self, path: str, params: Mapping[str, Any] | None = None) -> HttpResponse:
        """GET a path of the API."""
        return await self._patiently(lambda: self._broker.request("GET", path, params=params))

    async def read_in(self, context_url: str, path: str) -> Json:
        """Return a document with the names of an @context."""
        async with self._client(context_url) as client:
            answer = await self._patiently(lambda: client.request("GET", path))
        return as_object(answer)

    async def entities(self) -> AsyncIterator[list[Json]]:
        """Yield all entities of the tenant page by page, expanded, each once."""
        self.listed, self.expected, self.missed = 0, None, 0
        self._types = await self.types()
        seen: set[str] = set()
        if self._lists_local:
            async for page in self._entities_of({"local": "true"}):
                self.listed += len(page)
                seen.update(kind for entity in page for kind in types_of(entity))
                yield page
        for kind in self._types:
            if kind in seen:
                continue
            async for page in self._entities_of({"type": kind, **self.local}):
                # an entity of several types is in the list of each
                own = [
                    entity
                    for entity in page
                    if min(set(types_of(entity)) & set(self._types), default=kind) == kind
                ]
                self.listed += len(own)
                yield own

    async def _entities_of(self, params: Json) -> AsyncIterator[list[Json]]:
        """Yield pages of entities, without those by which clients see whether the broker has its data."""
        asked = {**params, "options": "sysAttrs", "count": "true"}
        async for page in self.pages("/entities", asked):
            yield [self._read_form(entity) for entity in page if not is_presence(str(entity.get("id")))]

    async def types(self) -> tuple[str, ...]:
        """Return the types of all entities as IRIs."""
        try:
            answer = as_object(
                await self.read("/types", {"local": "true"} if self.place.identity.is_ours else {})
            )
        except NotFound:
            return ()
        names = answer.get("typeList", [])
        terms = terms_of(answer, self.place.url)
        return tuple(sorted({terms.expand(name) for name in ([names] if isinstance(names, str) else names)}))

    async def count(self) -> int | None:
        """Return how many entities there are; None if the broker does not say it."""
        if not self._lists_local:
            return None
        try:
            answer = await self.read("/entities", {**self.local, "limit": 1, "count": "true"})
        except NotFound:
            return 0
        return count_in(answer)

    async def pages(self, path: str, params: Mapping[str, Any]) -> AsyncIterator[list[Json]]:
        """Yield the pages of a list, by the links of the broker or by offsets."""
        limit = FIRST_PAGE
        asked: Json = {**params, "limit": limit}
        seen, total, has_links = 0, None, False
        while True:
            try:
                answer = await self.read(path, asked)
            except NotFound:  # there is no such tenant
                return
            page = as_list(answer)
            if not seen:
                total = count_in(answer)
                if path == "/entities" and self.expected is None:
                    self.expected = total
            yield page
            seen += len(page)
            is_full = len(page) >= limit
            if page:
                limit = max(1, min(PAGE, PAGE_BYTES * len(page) // len(answer.body)))
            following = next_page(answer.headers.get("link", ""))
            if following is not None and following != asked:
                asked, has_links = {**following, "limit": limit}, True
            elif page and not has_links and (is_full if total is None else seen < total):
                asked = {**asked, "offset": seen, "limit": limit}
            else:
                self.missed += max(0, (total or 0) - seen)
                return

    async def lookup(self, entities: Sequence[Json]) -> dict[str, Json]:
        """Return the entities with these ids, expanded, by id."""
        by_id: dict[str, Json] = {}
        for ids in _in_urls([entity["id"] for entity in entities if "," not in entity["id"]]):
            kinds = sorted({kind for entity in entities for kind in types_of(entity)})
            selection = self.local or {"type": ",".join(kinds)}
            asked = {**selection, "id": ",".join(ids), "limit": len(ids), "options": "sysAttrs"}
            try:
                page = as_list(await self.read("/entities", asked))
            except NotFound:  # there is no such tenant
                return {}
            by_id |= {read_entity["id"]: self._read_form(read_entity) for read_entity in page}
        for entity in entities:
            if "," in entity["id"] and (retrieved := await self.retrieve(entity["id"])) is not None:
                by_id[entity["id"]] = retrieved
        return by_id

    async def retrieve(self, entity_id: str) -> Json | None:
        """Return one entity, expanded; None if there is none."""
        asked = {"options": "sysAttrs", **self.local}
        try:
            entity = as_object(await self.read(f"/entities/{in_path(entity_id)}", asked))
        except NotFound:
            return None
        return self._read_form(entity)

    def _read_form(self, entity: Json) -> Json:
        """Return an entity that was read, expanded; parameters of Tasks have the values of their texts."""
        return without_texts(expanded(entity, terms_of(entity, self.place.url)), prefix=DEFAULT_VOCAB)

    # Writing

    def _written_form(self, entity: Json) -> Json:
        """Return an expanded entity as this broker gets it: with texts of what another one may change."""
        return entity if self.place.identity.is_ours else dict(with_texts(entity, prefix=DEFAULT_VOCAB))

    async def create(self, entities: Sequence[Json]) -> dict[str, str]:
        """Create entities; return the reasons for those that were refused, by id.

        Those with several instances are created one by one where a batch may damage them, and those that need
        an @context.
        """
        entities = list(map(self._written_form, entities))
        alone = list(filter(self._is_alone, entities))
        single = {entity["id"] for entity in alone}
        refused: dict[str, str] = {}
        for batch in batches([candidate for candidate in entities if candidate["id"] not in single]):
            refused |= await self._batch("/entityOperations/create", {}, batch)
        for entity in alone:
            refused |= await self._alone(entity)
        return refused

    async def replace(self, pairs: Sequence[tuple[Json, Json]]) -> dict[str, str]:
        """Replace entities, given as wanted and present ones; return the reasons of refusals, by id."""
        pairs = [(self._written_form(wanted), present) for wanted, present in pairs]
        refused: dict[str, str] = {}
        again = [
            wanted
            for wanted, present in pairs
            if set(types_of(wanted)) != set(types_of(present))
            or self._is_alone(wanted)
            or self._is_alone(present)
        ]
        single = {entity["id"] for entity in again}
        for batch in batches([wanted for wanted, _ in pairs if wanted["id"] not in single]):
            refused |= await self._batch("/entityOperations/upsert", {"options": "replace"}, batch)
        for entity in again:
            path = f"/entities/{in_path(entity['id'])}"
            try:
                await self._write("DELETE", path)
            except NotFound:
                pass
            except BrokerError as error:
                refused[entity["id"]] = reason_of(error)
                continue
            refused |= await self._alone(entity)
        return refused

    def _is_alone(self, entity: Json) -> bool:
        """Return whether an entity is no part of a batch."""
        is_damaged = not self.place.identity.keeps_instances and has_instances(entity)
        return is_damaged or "@context" in with_terms(entity)

    async def post(self, path: str, document: Json) -> HttpResponse:
        """Create a document."""
        return await self._patiently(lambda: self._broker.request("POST", path, body=document))

    async def delete(self, path: str) -> None:
        """Delete a document."""
        await self._patiently(lambda: self._broker.request("DELETE", path))

    async def _write(
        self, method: str, path: str, params: Json | None = None, body: Any = None
    ) -> HttpResponse:
        asked = {**(params or {}), **({"local": "true"} if self.place.identity.is_ours else {})}
        return await self._patiently(lambda: self._broker.request(method, path, params=asked, body=body))

    async def _alone(self, entity: Json) -> dict[str, str]:
        try:
            await self._write("POST", "/entities", body=with_terms(entity))
        except BrokerUnavailable as error:
            if not isinstance(error, BrokerFault):
                raise
            return {entity["id"]: reason_of(error)}
        except BrokerError as error:
            return {entity["id"]: reason_of(error)}
        return {}

    async def _batch(self, path: str, params: Json, batch: Sequence[Json]) -> dict[str, str]:
        try:
            answer = await self._write("POST", path, params, batch)
        except BrokerUnavailable as error:
            if not isinstance(error, BrokerFault):
                raise
            return await self._halves(path, params, batch, error)
        except BrokerError as error:
            return await self._halves(path, params, batch, error)
        if answer.status != HTTPStatus.MULTI_STATUS:
            return {}
        return dict(refusals_in(answer, batch))

    async def _halves(
        self, path: str, params: Json, batch: Sequence[Json], error: BrokerError
    ) -> dict[str, str]:
        """Send the halves of a batch that was refused as a whole: it was too large, or one part spoils it."""
        if error.status in {HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN}:
            raise error
        if len(batch) == 1:
            return {batch[0]["id"]: reason_of(error)}
        middle = len(batch) // 2
        return await self._batch(path, params, batch[:middle]) | await self._batch(
            path, params, batch[middle:]
        )

    async def _patiently(self, act: Callable[[], Awaitable[T]]) -> T:
        attempts = faults = 0
        while True:
            try:
                return await act()
            except BrokerUnavailable as error:
                attempts += 1
                faults += isinstance(error, BrokerFault)
                if attempts >= MAX_ATTEMPTS or faults >= MAX_FAULTS:
                    raise
            await asyncio.sleep(backoff_delay_s(attempts, 0.2, 5.0))


def batches(entities: Sequence[Json]) -> Iterator[list[Json]]:
    """Yield entities in batches within the limits; one that is larger is alone."""
    brackets = 2
    return _parts(
        entities, lambda entity: len(orjson.dumps(entity)) + 1, MAX_BATCH, MAX_BATCH_BYTES - brackets
    )


def in_path(name: str) -> str:
    """Return a name as a part of a path."""
    return quote(name, safe=":")


def _in_urls(ids: Sequence[str]) -> Iterator[list[str]]:
    return _parts(ids, lambda entity_id: len(quote(entity_id, safe=":")) + 1, MAX_IDS, MAX_IDS_LENGTH)


def _parts(
    items: Iterable[T], length_of: Callable[[T], int], most: int, most_length: int
) -> Iterator[list[T]]:
    """Yield items in lists limited by number and sum of lengths; one that is longer is alone."""
    part: list[T] = []
    length = 0
    for item in items:
        added = length_of(item)
        if part and (len(part) >= most or length + added > most_length):
            yield part
            part, length = [], 0
        part.append(item)
        length += added
    if part:
        yield part
