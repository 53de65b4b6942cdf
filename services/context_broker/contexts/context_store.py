"""The @contexts that are kept: fetched from elsewhere, given to be hosted, or made for a subscription.

Clauses 5.13.1 and 5.13.3: each has a local identifier, and tells how often and when it was last used.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, Final
from urllib.parse import quote, unquote
from uuid import NAMESPACE_URL, uuid4, uuid5

import orjson

from services.context_broker.model.validation import timestamp, timestamp_now
from services.context_broker.storage.entries import DocumentKey

Documents = Mapping[DocumentKey, bytes | None]
"""What is to be written about contexts; None is erased."""

PATH: Final = "/ngsi-ld/v1/jsonldContexts/"
_OURS: Final = re.compile(rf"https?://[^/?#]+{PATH}([^/?#]+)")


class ContextKind(StrEnum):
    """Where an @context came from."""

    CACHED = "Cached"
    HOSTED = "Hosted"
    IMPLICIT = "ImplicitlyCreated"


@dataclass(slots=True, eq=False)
class StoredContext:
    """An @context that is kept. `url` is where a cached one was fetched; hosted ones belong to a tenant.

    `gone` is one that was deleted while a subscription may still need it: nobody sees it any more, and it is
    erased at the next start unless a subscription asks for it then.
    """

    kind: ContextKind
    tenant: str
    id: str
    url: str | None
    document: Mapping[str, Any]
    created_at: str
    expires_s: float = math.inf
    """When a cached one is to be fetched anew, in seconds since 1970."""
    hits: int = 0
    used_s: float | None = None
    """When it was used last, in seconds since 1970; a number, for it is noted with every request."""
    gone: bool = False
    hits_kept: int = 0
    """Uses that the journal knows of."""

    @property
    def key(self) -> str:
        """Return what the journal keeps it under, beside the tenant."""
        return self.url or self.id

    def stored(self) -> bytes:
        """Return the context as the journal keeps it."""
        expires_s = None if math.isinf(self.expires_s) else self.expires_s
        return orjson.dumps([self.kind.value, self.created_at, self.document, self.gone, expires_s])

    def stored_usage(self) -> bytes:
        """Return how it was used, as the journal keeps that."""
        return orjson.dumps([self.hits, self.used_s])

    def address(self, base: str) -> str:
        """Return the URL to get it from: its own if it is cached, else one of the broker at `base`."""
        return self.url or base + PATH + quote(self.id, safe="")

    def details(self, base: str) -> dict[str, Any]:
        """Return what a client is told of it (clause 5.13.3.5)."""
        told = {
            "URL": self.address(base),
            "localId": self.id,
            "kind": self.kind.value,
            "createdAt": self.created_at,
            "numberOfHits": self.hits,
        }
        if not math.isinf(self.expires_s):
            told["expiresAt"] = timestamp(datetime.fromtimestamp(self.expires_s, UTC))
        if self.used_s is not None:
            told["lastUsage"] = timestamp(datetime.fromtimestamp(self.used_s, UTC))
        return told


def cached(
    url: str, document: Mapping[str, Any], expires_s: float = math.inf, created_at: str | None = None
) -> StoredContext:
    """Return a context that was fetched from `url`."""
    own_id = str(uuid5(NAMESPACE_URL, url))
    created_at = created_at or timestamp_now()
    return StoredContext(ContextKind.CACHED, "", own_id, url, document, created_at, expires_s)


def hosted(tenant: str, document: Mapping[str, Any]) -> StoredContext:
    """Return a context that a client gave. Its id cannot be guessed: who knows its URL may read it."""
    return StoredContext(ContextKind.HOSTED, tenant, str(uuid4()), None, document, timestamp_now())


def implicit(tenant: str, document: Mapping[str, Any]) -> StoredContext:
    """Return the context of a subscription that gave it in its body; equal ones have the same id."""
    own_id = str(uuid5(NAMESPACE_URL, f"{tenant}\n{orjson.dumps(document).decode()}"))
    return StoredContext(ContextKind.IMPLICIT, tenant, own_id, None, document, timestamp_now())


def restored(tenant: str, key: str, stored: bytes) -> StoredContext:
    """Return the context that `stored` had been."""
    said = orjson.loads(stored)
    if isinstance(said, dict):  # the first release kept the document and nothing else
        return cached(key, said, expires_s=0.0)
    kind, created_at, document, gone, expires_s = said
    if kind == ContextKind.CACHED:
        one = cached(key, document, math.inf if expires_s is None else expires_s, created_at)
    else:
        one = StoredContext(ContextKind(kind), tenant, key, None, document, created_at)
    one.gone = gone
    return one


class ContextStore:
    """All kept contexts, found by URL or by local identifier."""

    def __init__(self) -> None:
        self._by_id: dict[str, StoredContext] = {}
        self._by_url: dict[str, StoredContext] = {}

    def __iter__(self) -> Iterator[StoredContext]:
        """Yield all of them, those that are gone too."""
        return iter(list(self._by_id.values()))

    def put(self, one: StoredContext) -> None:
        """Keep a context, in place of the one with its identifier."""
        self._by_id[one.id] = one
        if one.url is not None:
            self._by_url[one.url] = one

    def remove(self, one: StoredContext) -> None:
        """Keep a context no longer."""
        self._by_id.pop(one.id, None)
        if one.url is not None:
            self._by_url.pop(one.url, None)

    def at(self, url: str) -> StoredContext | None:
        """Return the context of a URL: where it was fetched, or an address of our own under any name.

        The broker has many names (a port mapped, a proxy before it); an identifier belongs to one broker.
        """
        one = self._by_url.get(url)
        if one is None and (found := _OURS.fullmatch(url)) is not None:
            one = self._by_id.get(unquote(found[1]))
        return one

    def named(self, name: str) -> StoredContext | None:
        """Return the context that a client names by its local identifier or its URL."""
        return self._by_id.get(name) or self.at(name)


def shown_to(tenant: str, contexts: Iterable[StoredContext]) -> list[StoredContext]:
    """Return the contexts that a tenant may see: what was fetched belongs to all (clause 5.5.10)."""
    return [
        one for one in contexts if not one.gone and (one.kind is ContextKind.CACHED or one.tenant == tenant)
    ]
