"""Stored @contexts: fetched from a URL, added by a client, or created for a subscription.

Clauses 5.13.1 and 5.13.3: each has a local identifier, and counts of its uses.
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

from handover_broker.model.validation import timestamp, timestamp_now
from handover_broker.storage.entries import DocumentKey

Documents = Mapping[DocumentKey, bytes | None]
"""Context documents to be written; None deletes."""

PATH: Final = "/ngsi-ld/v1/jsonldContexts/"
_OURS: Final = re.compile(rf"https?://[^/?#]+{PATH}([^/?#]+)")


class ContextKind(StrEnum):
    """The origin of an @context."""

    CACHED = "Cached"
    HOSTED = "Hosted"
    IMPLICIT = "ImplicitlyCreated"


@dataclass(slots=True, eq=False)
class StoredContext:
    """A stored @context. `url` is the source of a cached one; hosted ones belong to a tenant.

    `gone` marks one that was deleted while a subscription may still need it: clients do not see it any more,
    and it is deleted at the next start unless a subscription needs it then.
    """

    kind: ContextKind
    tenant: str
    id: str
    url: str | None
    document: Mapping[str, Any]
    created_at: str
    expires_s: float = math.inf
    """When a cached one has to be fetched again, in seconds since 1970."""
    hits: int = 0
    used_s: float | None = None
    """Its last use, in seconds since 1970; a number, because every request sets it."""
    gone: bool = False
    hits_kept: int = 0
    """Uses that are in the journal."""

    @property
    def key(self) -> str:
        """Return its key in the journal, beside the tenant."""
        return self.url or self.id

    def stored(self) -> bytes:
        """Return it as the journal stores it."""
        expires_s = None if math.isinf(self.expires_s) else self.expires_s
        return orjson.dumps(
            {
                "kind": self.kind.value,
                "createdAt": self.created_at,
                "document": self.document,
                "gone": self.gone,
                "expires_s": expires_s,
            }
        )

    def stored_usage(self) -> bytes:
        """Return its use as the journal stores it."""
        return orjson.dumps({"hits": self.hits, "used_s": self.used_s})

    def address(self, base: str) -> str:
        """Return its URL: that of a cached one, else one of the broker at `base`."""
        return self.url or base + PATH + quote(self.id, safe="")

    def details(self, base: str) -> dict[str, Any]:
        """Return its description for clients (clause 5.13.3.5)."""
        description = {
            "URL": self.address(base),
            "localId": self.id,
            "kind": self.kind.value,
            "createdAt": self.created_at,
            "numberOfHits": self.hits,
        }
        if not math.isinf(self.expires_s):
            description["expiresAt"] = timestamp(datetime.fromtimestamp(self.expires_s, UTC))
        if self.used_s is not None:
            description["lastUsage"] = timestamp(datetime.fromtimestamp(self.used_s, UTC))
        return description


def cached(
    url: str, document: Mapping[str, Any], expires_s: float = math.inf, created_at: str | None = None
) -> StoredContext:
    """Return a context that was fetched from `url`."""
    own_id = str(uuid5(NAMESPACE_URL, url))
    created_at = created_at or timestamp_now()
    return StoredContext(ContextKind.CACHED, "", own_id, url, document, created_at, expires_s)


def hosted(tenant: str, document: Mapping[str, Any]) -> StoredContext:
    """Return a context that a client added. Its id cannot be guessed: a client that knows its URL may read
    it."""
    return StoredContext(ContextKind.HOSTED, tenant, str(uuid4()), None, document, timestamp_now())


def implicit(tenant: str, document: Mapping[str, Any]) -> StoredContext:
    """Return the context that a subscription gave in its body; equal ones have the same id."""
    own_id = str(uuid5(NAMESPACE_URL, f"{tenant}\n{orjson.dumps(document).decode()}"))
    return StoredContext(ContextKind.IMPLICIT, tenant, own_id, None, document, timestamp_now())


def restored(tenant: str, key: str, stored: bytes) -> StoredContext:
    """Return the context of a stored document."""
    fields = orjson.loads(stored)
    kind, document, created_at = ContextKind(fields["kind"]), fields["document"], fields["createdAt"]
    if kind is ContextKind.CACHED:
        expires_s = fields["expires_s"]
        context = cached(key, document, math.inf if expires_s is None else expires_s, created_at)
    else:
        context = StoredContext(kind, tenant, key, None, document, created_at)
    context.gone = fields["gone"]
    return context


class ContextStore:
    """All stored contexts, found by URL or by local identifier."""

    def __init__(self) -> None:
        self._by_id: dict[str, StoredContext] = {}
        self._by_url: dict[str, StoredContext] = {}

    def __iter__(self) -> Iterator[StoredContext]:
        """Yield all of them, including those that are gone."""
        return iter(list(self._by_id.values()))

    def put(self, context: StoredContext) -> None:
        """Add a context, or replace the one with its identifier."""
        self._by_id[context.id] = context
        if context.url is not None:
            self._by_url[context.url] = context

    def remove(self, context: StoredContext) -> None:
        """Remove a context."""
        self._by_id.pop(context.id, None)
        if context.url is not None:
            self._by_url.pop(context.url, None)

    def at(self, url: str) -> StoredContext | None:
        """Return the context of a URL: its source, or an address of this broker under any host name.

        The broker has many names (a mapped port, a proxy); an identifier belongs to one broker.
        """
        context = self._by_url.get(url)
        if context is None and (match := _OURS.fullmatch(url)) is not None:
            context = self._by_id.get(unquote(match[1]))
        return context

    def named(self, name: str) -> StoredContext | None:
        """Return the context with a local identifier or a URL."""
        return self._by_id.get(name) or self.at(name)


def shown_to(tenant: str, contexts: Iterable[StoredContext]) -> list[StoredContext]:
    """Return the contexts that a tenant may see: fetched ones belong to all (clause 5.5.10)."""
    return [
        context
        for context in contexts
        if not context.gone and (context.kind is ContextKind.CACHED or context.tenant == tenant)
    ]
