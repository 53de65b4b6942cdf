"""Operations on subscriptions (clauses 5.8.1 to 5.8.5, 6.10 and 6.11)."""

import asyncio
import time
from typing import Any, Final
from urllib.parse import quote
from uuid import uuid4

import orjson

from handover.errors import Problem
from services.context_broker.contexts import Context, ContextBook
from services.context_broker.exchange import JSON_LD, PREFIX, Answer, Exchange
from services.context_broker.journal import Entries, NotStored
from services.context_broker.notifier import Notifier
from services.context_broker.problems import already_exists, not_found, not_stored
from services.context_broker.reading import (
    PAGE_PARAMETERS,
    json_headers,
    options_of,
    page_links,
    window_of,
)
from services.context_broker.store import Store
from services.context_broker.subscriptions import (
    Counts,
    Subscription,
    kept_document,
    shown_document,
    subscription,
    updated_document,
)
from services.context_broker.words import require_uri, timestamp_now

DONE: Final = Answer(204)
_VIEW: Final = frozenset({"options"})
_SYS_ATTRS: Final = frozenset({"sysAttrs", "count"})


class SubscriptionOperations:
    """What can be done to subscriptions. Changes are rare and made one after the other."""

    def __init__(self, store: Store, notifier: Notifier, contexts: ContextBook) -> None:
        self._store = store
        self._notifier = notifier
        self._contexts = contexts
        self._one_at_a_time = asyncio.Lock()

    async def restore(self) -> list[Subscription]:
        """Return the subscriptions of before; their contexts are in the journal too."""
        found: list[Subscription] = []
        for body, told in self._store.journal.subscriptions():
            document = orjson.loads(body)
            one = subscription(document, await self._contexts.of(document["context"]))
            if told is not None:
                one.counts = Counts(*orjson.loads(told))
            found.append(one)
        return found

    async def create(self, exchange: Exchange) -> Answer:
        """POST subscriptions."""
        exchange.require_known(frozenset({"local"}))
        given, context = await exchange.body()
        document = kept_document(given, context)
        document["id"] = require_uri(
            document.get("id", f"urn:ngsi-ld:Subscription:{uuid4()}"), "the subscription id"
        )
        at = timestamp_now()
        used = await self._used_context(document, context)
        made = subscription({**document, "createdAt": at, "modifiedAt": at, "context": used.document}, used)
        async with self._one_at_a_time:
            if self._notifier.get(made.id) is not None:
                raise already_exists(
                    f"there is a subscription {made.id} already; update it, or choose another id"
                )
            await self._keep(made)
            self._notifier.put(made)
        location = f"{PREFIX}subscriptions/{quote(made.id, safe=':')}".encode()
        return Answer(201, b"", [(b"location", location)])

    async def update(self, exchange: Exchange) -> Answer:
        """PATCH subscriptions/{id}."""
        exchange.require_known(frozenset({"local"}))
        given, context = await exchange.body()
        change = kept_document(given, context)
        async with self._one_at_a_time:
            before = self._existing(exchange)
            used = await self._used_context(change, context) if _names_things(change) else before.context
            document = {
                **updated_document(before.document, change),
                "modifiedAt": timestamp_now(),
                "context": used.document,
            }
            made = subscription(document, used)
            await self._keep(made)
            self._notifier.put(made)
        return DONE

    async def delete(self, exchange: Exchange) -> Answer:
        """DELETE subscriptions/{id}."""
        exchange.require_known(frozenset({"local"}))
        async with self._one_at_a_time:
            before = self._existing(exchange)
            await self._write(Entries(subscriptions={before.id: None}))
            self._notifier.remove(before.id)
        return DONE

    async def retrieve(self, exchange: Exchange) -> Answer:
        """GET subscriptions/{id}."""
        exchange.require_known(_VIEW)
        media_type, context = exchange.accept(), await exchange.reader_context()
        document = self._shown(self._existing(exchange), exchange, context)
        return _answer(_with_context(document, media_type, context), media_type, context)

    async def list(self, exchange: Exchange) -> Answer:
        """GET subscriptions."""
        exchange.require_known(PAGE_PARAMETERS)
        media_type, context = exchange.accept(), await exchange.reader_context()
        window = window_of(exchange)
        found = self._notifier.all()
        page = found[window.offset : window.offset + window.limit]
        documents = [_with_context(self._shown(one, exchange, context), media_type, context) for one in page]
        answer = _answer(documents, media_type, context)
        if window.count:
            answer.headers.append((b"ngsild-results-count", str(len(found)).encode()))
        more = window.offset + window.limit < len(found)
        answer.headers += page_links(exchange, window, media_type, more=more)
        return answer

    def _existing(self, exchange: Exchange) -> Subscription:
        subscription_id = require_uri(exchange.names[0], "the subscription id in the path")
        found = self._notifier.get(subscription_id)
        if found is None:
            raise _absent(subscription_id)
        return found

    async def _used_context(self, document: dict[str, Any], context: Context) -> Context:
        """Return the context that notifications are written in: jsonldContext if the subscriber names one."""
        named = document.get("jsonldContext")
        return context if named is None else await self._contexts.of(require_uri(named, '"jsonldContext"'))

    async def _keep(self, made: Subscription) -> None:
        await self._write(Entries(subscriptions={made.id: orjson.dumps(made.document)}))

    async def _write(self, entries: Entries) -> None:
        try:
            await self._store.commits.store(entries)
        except NotStored as error:
            raise not_stored(str(error)) from error

    @staticmethod
    def _shown(one: Subscription, exchange: Exchange, context: Context) -> dict[str, Any]:
        sys_attrs = "sysAttrs" in options_of(exchange, _SYS_ATTRS)
        return shown_document(one, context, time.time(), sys_attrs=sys_attrs)


def _names_things(change: dict[str, Any]) -> bool:
    """Say whether a change holds names, so that the context it came with becomes the subscription's."""
    return any(name in change for name in ("entities", "watchedAttributes", "q", "jsonldContext"))


def _with_context(document: dict[str, Any], media_type: str, context: Context) -> dict[str, Any]:
    return {"@context": context.document, **document} if media_type == JSON_LD else document


def _answer(body: Any, media_type: str, context: Context) -> Answer:
    headers = json_headers(context)
    if media_type == JSON_LD:
        headers = [(b"content-type", JSON_LD.encode())]
    return Answer(200, orjson.dumps(body), headers)


def _absent(subscription_id: str) -> Problem:
    return not_found(f"there is no subscription {subscription_id}; create it first")
