"""Copies hosted @contexts, subscriptions and registrations of a tenant, and compares both sides.

The services of Handover create their subscriptions at each start, with keys that nobody reads; they are
skipped. Keys of others that the source does not show cannot be copied: such a document is reported until
somebody has made it in the target. A subscription is created with its own @context, since its notifications
have the names of it; an @context that the source itself serves is copied or sent with the subscription.
"""

import hashlib
from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import urljoin, urlsplit

import orjson

from handover.broker import BrokerError, BrokerUnavailable, NotFound
from handover.broker_copy.answers import as_json, as_object
from handover.broker_copy.broker_side import CONTEXTS, BrokerSide, in_path
from handover.broker_copy.entity_form import Json
from handover.broker_copy.report import Counts, TenantReport
from handover.settings import STARS
from handover.subscriptions.notifications import KEY_HEADER

API: Final = "/ngsi-ld/v1"
HOSTED: Final = "Hosted"
_NOT_OFFERED: Final = frozenset({HTTPStatus.BAD_REQUEST, HTTPStatus.NOT_IMPLEMENTED})
_OF_THE_BROKER: Final = frozenset(
    {"@context", "createdAt", "modifiedAt", "deletedAt", "status", "timesSent", "timesFailed", "origin",
     "lastNotification", "lastSuccess", "lastFailure", "jsonldContext"}
)  # fmt: skip
_DEFAULTS: Final = {"isActive": True, "format": "normalized", "mode": "inclusive"}
"""Members that some brokers add with these values."""


@dataclass(frozen=True, slots=True)
class DocumentKind:
    """A kind of documents: its name, the path of its list, and the parameters that select all."""

    name: str
    path: str
    params: Mapping[str, Any]
    names_context: bool
    """Whether `jsonldContext` says which names it uses for its receiver."""


SUBSCRIPTIONS: Final = DocumentKind("subscription", "/subscriptions", {}, True)
SOURCE_SUBSCRIPTIONS: Final = DocumentKind("registration subscription", "/csourceSubscriptions", {}, True)
REGISTRATIONS: Final = DocumentKind("registration", "/csourceRegistrations", {"idPattern": ".*"}, False)


class DocumentCopy:
    """The copy of documents from `source` to `target`."""

    def __init__(
        self, source: BrokerSide, target: BrokerSide, report: TenantReport, *, overwrites: bool
    ) -> None:
        self._source, self._target, self._report = source, target, report
        self._overwrites = overwrites

    # @contexts

    async def copy_contexts(self) -> None:
        """Host the @contexts in the target that clients have added to the source; note their addresses."""
        counts = self._report.documents.setdefault("contexts", Counts())
        urls = {digest: url async for digest, url, _ in self._hosted(self._target)}
        async for digest, url, content in self._hosted(self._source):
            counts.found += 1
            if digest in urls:
                counts.present += 1
            else:
                try:
                    answer = await self._target.post(CONTEXTS, content)
                except BrokerUnavailable:
                    raise
                except BrokerError as error:
                    self._report.problem("@context", url, f"not copied: {error}")
                    continue
                location = answer.headers.get("location", "")
                urls[digest] = urljoin(f"{self._target.place.url}/", location)
                counts.created += 1
            counts.equal += 1
            self._report.contexts[url] = urls[digest]
        for old, new in self._report.contexts.items():
            self._report.note(f"@context {old} is now {new}: change the clients that use it")

    async def _hosted(self, side: BrokerSide) -> AsyncIterator[tuple[str, str, Json]]:
        """Yield digest, URL and document of the hosted @contexts of a broker."""
        try:
            listed = as_json(await side.read(CONTEXTS, {"details": "true", "kind": HOSTED}))
        except BrokerUnavailable:
            raise
        except BrokerError as error:
            if error.status != HTTPStatus.NOT_FOUND:
                self._report.note(f"the @contexts of {side.place.url} cannot be listed: {error}")
            return
        for part in listed if isinstance(listed, list) else ():
            if isinstance(part, dict) and part.get("kind", part.get("type")) == HOSTED:
                url = str(part.get("URL") or part.get("url"))
                local_id = str(part.get("localId") or part.get("id") or urlsplit(url).path.rpartition("/")[2])
                content = as_object(await side.read(f"{CONTEXTS}/{in_path(local_id)}"))
                document = {"@context": content.get("@context")}
                content_text = orjson.dumps(document, option=orjson.OPT_SORT_KEYS)
                yield hashlib.sha256(content_text).hexdigest(), url, document

    # Subscriptions and registrations

    async def copy(self, kind: DocumentKind) -> None:
        """Copy and compare all documents of a kind."""
        counts = self._report.documents.setdefault(f"{kind.name.replace(' ', '_')}s", Counts())
        try:
            async for page in self._source.pages(kind.path, kind.params):
                for document in page:
                    counts.found += 1
                    await self._copy(kind, document, counts)
        except BrokerError as error:
            if error.status not in _NOT_OFFERED or isinstance(error, BrokerUnavailable):
                raise
            self._report.note(f"{self._source.place.url} has no {kind.name}s: {error}")

    async def _copy(self, kind: DocumentKind, document: Json, counts: Counts) -> None:
        name = str(document.get("id"))
        if (reason := _reason_to_skip(document)) is not None:
            counts.skipped += 1
            self._report.note(f"{kind.name} {name} is skipped: {reason}")
            return
        present = await self._present(kind, name)
        unequal = None if present is None else _difference(document, present)
        if present is not None and unequal is None:
            counts.present += 1
            counts.equal += 1
        elif (obstacle := self._obstacle(document, unequal)) is not None:
            self._report.problem(kind.name, name, obstacle)
        else:
            await self._create(kind, document, counts, replaces=present is not None)

    def _obstacle(self, document: Json, unequal: str | None) -> str | None:
        """Return why a document cannot be copied; `unequal` is in what that of the target differs."""
        difference = "" if unequal is None else f"; the one in the target differs in {unequal}"
        if hidden := ", ".join(_hidden(document)):
            return f"must be made by hand, since {hidden} cannot be read{difference}"
        endpoint = document.get("endpoint")
        if isinstance(endpoint, str) and _origin(endpoint) == _origin(self._target.place.url):
            return f"must be made by hand, since its endpoint is the target itself{difference}"
        if unequal is not None and not self._overwrites:
            return f"differs in the target: {unequal}"
        return None

    async def _create(self, kind: DocumentKind, document: Json, counts: Counts, *, replaces: bool) -> None:
        name = str(document["id"])
        try:
            wanted = await self._wanted(kind, document)
            if replaces:
                await self._target.delete(f"{kind.path}/{in_path(name)}")
            await self._target.post(kind.path, wanted)
        except BrokerUnavailable:
            raise
        except BrokerError as error:
            self._report.problem(kind.name, name, f"not copied: {error}")
            return
        if replaces:
            counts.replaced += 1
        else:
            counts.created += 1
        present = await self._present(kind, name)
        unequal = "it is absent" if present is None else _difference(document, present)
        if unequal is None:
            counts.equal += 1
        else:
            self._report.problem(kind.name, name, f"differs in the target: {unequal}")

    async def _present(self, kind: DocumentKind, name: str) -> Json | None:
        try:
            return as_object(await self._target.read(f"{kind.path}/{in_path(name)}"))
        except NotFound:
            return None
        except BrokerUnavailable:
            raise
        except BrokerError:  # creating it says why
            return None

    async def _wanted(self, kind: DocumentKind, document: Json) -> Json:
        """Return what to create in the target."""
        context = document.get("jsonldContext")
        if not kind.names_context or not isinstance(context, str):
            return _own_members(document)
        path = f"{kind.path}/{in_path(str(document['id']))}"
        named = await self._source.read_in(context, path)
        return {"@context": await self._context_for_target(context), **_own_members(named)}

    async def _context_for_target(self, url: str) -> Any:
        """Return an @context that the target can use when the source is gone."""
        if url in self._report.contexts:
            return self._report.contexts[url]
        parts = urlsplit(url)
        prefix = f"{API}{CONTEXTS}/"
        if parts.netloc != urlsplit(self._source.place.url).netloc or prefix not in parts.path:
            return url
        local_id = parts.path.partition(prefix)[2]
        return as_object(await self._source.read(f"{CONTEXTS}/{local_id}")).get("@context")


def _own_members(document: Json) -> Json:
    own = {name: value for name, value in document.items() if name not in _OF_THE_BROKER}
    if isinstance(own.get("notification"), dict):
        own["notification"] = {
            name: value for name, value in own["notification"].items() if name not in _OF_THE_BROKER
        }
    return own


def _difference(source: Json, target: Json) -> str | None:
    """Return the names of the members in which two documents differ; None if they do not."""
    before, after = dict(_members(source)), dict(_members(target))
    names = sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name))
    return ", ".join(names) or None


def _members(document: Json, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in document.items():
        if name in _OF_THE_BROKER or (name in _DEFAULTS and _DEFAULTS[name] == value):
            continue
        if name in {"notification", "endpoint"} and isinstance(value, dict):
            yield from _members(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _endpoint(document: Json) -> Json:
    notification = document.get("notification")
    endpoint = notification.get("endpoint") if isinstance(notification, dict) else None
    return endpoint if isinstance(endpoint, dict) else {}


def _reason_to_skip(document: Json) -> str | None:
    if _is_of_service(document):
        return "its service creates it at its start"
    return "it has expired" if _is_expired(document) else None


def _is_of_service(document: Json) -> bool:
    pairs = _endpoint(document).get("receiverInfo")
    return any(
        isinstance(pair, dict) and str(pair.get("key")).lower() == KEY_HEADER.lower()
        for pair in (pairs if isinstance(pairs, list) else ())
    )


def _is_expired(document: Json) -> bool:
    try:
        ends = datetime.fromisoformat(str(document.get("expiresAt")))
    except ValueError:
        return document.get("status") == "expired"
    return (ends if ends.tzinfo else ends.replace(tzinfo=UTC)) <= datetime.now(UTC)


def _hidden(document: Json) -> Iterator[str]:
    """Yield where a document has a secret that its broker does not show."""
    for holder, address in ((_endpoint(document), "uri"), (document, "endpoint")):
        if isinstance(uri := holder.get(address), str) and STARS in uri:
            yield f"the secret in its address {uri}"
        for pairs in ("receiverInfo", "notifierInfo", "contextSourceInfo"):
            for pair in holder.get(pairs) or ():
                if isinstance(pair, dict) and pair.get("value") == STARS:
                    yield f"{pairs} {pair.get('key')}"


def _origin(url: str) -> tuple[str | None, int]:
    parts = urlsplit(url)
    return parts.hostname, parts.port or (443 if parts.scheme == "https" else 80)
