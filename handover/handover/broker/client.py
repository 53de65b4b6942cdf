"""An asynchronous NGSI-LD client for any context broker.

It uses only ETSI GS CIM 009. The Link header of every request has the @context, so that types and attributes
have the same meaning for all clients.

A broker that is not ours gets no credentials of ours. Some brokers answer without their database that nothing
is there: before something counts as missing at a broker that is not ours, an entity that this client has
written is read (`_PRESENCE`).
"""

import time
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import suppress
from email.utils import parsedate_to_datetime
from typing import Any, Final, TypeVar
from urllib.parse import quote

import httpx

from handover.broker.answers import (
    NgsiLd,
    batch_error,
    document_of,
    failures_of,
    finds_nothing,
    is_not_found,
    not_updated,
    refused_ids,
    require_all_done,
)
from handover.broker.connection import JSON, BrokerConnection, Credentials
from handover.broker.errors import AlreadyExists, BrokerError, BrokerFault, BrokerUnavailable, NotFound
from handover.formats.free_values import FREE_VALUES, with_texts, without_texts
from handover.network.http_client import HttpResponse
from handover.settings import Settings
from handover.telemetry import get_logger
from handover_datamodels.entities import Entity

log = get_logger(__name__)

PAGE = 500
"""Entities per page; many brokers refuse more than 1000."""
MAX_FAULTS: Final = 3
"""A request at which the broker has failed so often (`BrokerFault`) is not repeated."""

_ENTITIES: Final = ("/entities", "/entityOperations")
_PRESENCE: Final = "BrokerPresence"
"""Type of the entity that is read before another one counts as missing: one for each cell and tenant."""
_PURPOSE: Final = "While it cannot be read, the broker is without its data, and nothing counts as missing."

AnEntity = TypeVar("AnEntity", bound=Entity)

_OF_THE_BROKER: Final = frozenset(
    {"id", "type", "@context", "jsonldContext", "status", "origin", "createdAt", "modifiedAt"}
)
"""Members of a subscription that brokers add by themselves."""


def is_presence(entity_id: str) -> bool:
    """Return whether an entity is one that clients have written to see that the broker has its data."""
    return entity_id.startswith(f"urn:ngsi-ld:{_PRESENCE}:")


def fault_delay_s(faults: int) -> float:
    """Return the pause before a request is repeated at which the broker has failed `faults` times."""
    return 2.0**faults


class BrokerClient(BrokerConnection):
    """A client of the broker of `settings`; an asynchronous context manager.

    Every method raises `BrokerUnavailable` when the broker does not answer, or not as a broker that has its
    data, and another `BrokerError` when it refuses the request. A broker of ours gets the `credentials`,
    another one those of the settings. `transport` replaces the HTTP client, for example by the ASGI transport
    of httpx. `accept` is the media type of answers. Without a `context_url` in the settings there is no Link
    header; an object with an "@context" is sent as JSON-LD.
    """

    def __init__(
        self,
        settings: Settings,
        *,
        credentials: Credentials | None = None,
        transport: httpx.AsyncBaseTransport | None = None,
        timeout_s: float = 10.0,
        accept: str = JSON,
    ) -> None:
        super().__init__(
            settings, credentials=credentials, transport=transport, timeout_s=timeout_s, accept=accept
        )
        self._presence_id = settings.entity_id(_PRESENCE, settings.broker_tenant or "cell")

    async def probe(self) -> float | None:
        """Send a small query; return by how many s the broker's clock differs from ours.

        It is None where the broker does not say its time, positive where that is ahead, and right to about a
        second. Raises `BrokerUnavailable` if the broker does not answer.
        """
        answer = await self._call("GET", "/entities", params={"type": "Device", "limit": 1})
        try:
            return parsedate_to_datetime(answer.headers["date"]).timestamp() - time.time()
        except (KeyError, ValueError):
            return None

    async def request(
        self, method: str, path: str, *, params: Mapping[str, Any] | None = None, body: Any = None
    ) -> HttpResponse:
        """Send a request of the API, with `path` below /ngsi-ld/v1; return the answer as it is.

        A partial success (207) is for the caller to read.
        """
        return await self._call(method, path, params=params, body=body)

    async def create(self, entity: Entity | NgsiLd) -> None:
        """Create an entity; raise `AlreadyExists` if its id is taken."""
        await self._call("POST", "/entities", body=await self._written(entity))

    async def retrieve(self, entity_id: str) -> dict[str, Any]:
        """Return an entity in normalized form; raise `NotFound` if there is none."""
        response = await self._call("GET", f"/entities/{_in_path(entity_id)}")
        return without_texts(document_of(response, dict, self.url))

    async def get(self, entity_id: str, model: type[AnEntity]) -> AnEntity:
        """Return an entity as `model`."""
        return model.from_ngsild(await self.retrieve(entity_id))

    async def query(self, **selection: Any) -> list[dict[str, Any]]:
        """Return all entities that match, of all pages, in normalized form.

        `selection` holds the query parameters of NGSI-LD (clause 6.4.3.2): `type`, `id`, `id_pattern`,
        `attrs`, `q`; lists are joined with commas.
        """
        return [without_texts(entity) async for page in self._pages(selection) for entity in page]

    async def count(self, **selection: Any) -> int | None:
        """Return how many entities match; None if the broker does not say it.

        `selection` is that of `query`.
        """
        params = {_parameter(name): _joined(value) for name, value in selection.items() if value is not None}
        response = await self._call("GET", "/entities", params={**params, "count": "true", "limit": 0})
        total = response.headers.get("ngsild-results-count", "")
        return int(total) if total.isdecimal() else None

    async def evolution(self, since: str, **selection: Any) -> list[dict[str, Any]]:
        """Return the temporal evolution, normalized and with times, of entities that changed since a time.

        Raises `BrokerError` if the broker has no temporal API.
        """
        times = {"timerel": "after", "timeAt": since, "timeproperty": "modifiedAt", "options": "sysAttrs"}
        pages = self._pages({**selection, **times}, "/temporal/entities")
        return [entity async for page in pages for entity in page]

    async def find(self, model: type[AnEntity], **selection: Any) -> list[AnEntity]:
        """Return all entities of `model` that match; an invalid one is logged and skipped."""
        instances: list[AnEntity] = []
        for entity in await self.query(type=model.ngsi_type(), **selection):
            try:
                instances.append(model.from_ngsild(entity))
            except ValueError as error:
                log.warning("entity does not match the data model", entity=entity.get("id"), error=str(error))
        return instances

    async def update(self, entity_id: str, attributes: NgsiLd) -> None:
        """Overwrite attributes (PATCH …/attrs); some brokers add missing attributes, others refuse them.

        Raises `NotFound` if the entity does not exist, `BrokerError` with the reasons for refused attributes.
        """
        body = await self._written(attributes)
        answer = await self._call("PATCH", f"/entities/{_in_path(entity_id)}/attrs", body=body)
        require_all_done(answer, "notUpdated", not_updated)

    async def append(self, entity_id: str, attributes: NgsiLd) -> None:
        """Overwrite or add attributes (POST …/attrs); raise `NotFound` if the entity does not exist."""
        body = await self._written(attributes)
        await self._call("POST", f"/entities/{_in_path(entity_id)}/attrs", body=body)

    async def delete_attribute(self, entity_id: str, name: str) -> None:
        """Delete an attribute, of a name or an IRI; raise `NotFound` if there is none."""
        await self._call("DELETE", f"/entities/{_in_path(entity_id)}/attrs/{quote(name, safe='')}")

    async def upsert(self, entities: Sequence[Entity | NgsiLd]) -> None:
        """Create the entities, or update the given attributes of existing ones, in one batch."""
        require_all_done(await self._send_upsert(entities), "errors", batch_error)

    async def replace(self, entities: Sequence[Entity | NgsiLd]) -> None:
        """Create the entities, or replace existing ones with all their attributes, in one batch."""
        require_all_done(await self._send_upsert(entities, "replace"), "errors", batch_error)

    async def upsert_batch(self, entities: Sequence[Entity | NgsiLd]) -> frozenset[str]:
        """Create or update entities as `upsert` does; return the ids of those that were refused."""
        return refused_ids(await self._send_upsert(entities))

    async def _send_upsert(self, entities: Sequence[Entity | NgsiLd], option: str = "update") -> HttpResponse:
        body = [await self._written(entity) for entity in entities]
        return await self._call("POST", "/entityOperations/upsert", params={"options": option}, body=body)

    async def create_batch(self, entities: Sequence[Entity | NgsiLd]) -> frozenset[str]:
        """Create entities in one request; return the ids of those that exist already or were refused."""
        body = [await self._written(entity) for entity in entities]
        return refused_ids(await self._call("POST", "/entityOperations/create", body=body))

    async def delete(self, entity_id: str) -> None:
        """Delete an entity; raise `NotFound` if there is none."""
        await self._call("DELETE", f"/entities/{_in_path(entity_id)}")

    async def delete_evolution(self, entity_id: str) -> None:
        """Delete the temporal evolution of an entity; raise `NotFound` if there is none.

        Raises `BrokerError` if the broker has no temporal API.
        """
        await self._call("DELETE", f"/temporal/entities/{_in_path(entity_id)}")

    async def delete_batch(self, entity_ids: Sequence[str]) -> None:
        """Delete entities in one request; missing ones are ignored."""
        path = "/entityOperations/delete"
        with suppress(NotFound):  # some brokers answer so when none exists
            answer = await self._call("POST", path, body=list(entity_ids))
            is_missing = any(map(is_not_found, failures_of(answer, "errors")))
            if is_missing and await self._has_to_repeat():
                answer = await self._request("POST", path, body=list(entity_ids))
            require_all_done(answer, "errors", batch_error, is_ignored=is_not_found)

    async def ensure_subscription(self, subscription: NgsiLd) -> None:
        """Create this subscription (with its `id`), or update the existing one; idempotent.

        One that has members which this one does not have, as an end or a filter that somebody added, is
        deleted and created again, since an update would keep them.
        """
        subscription_id = str(subscription["id"])
        try:
            await self._call("POST", "/subscriptions", body=subscription)
        except AlreadyExists:
            present = await self.subscription(subscription_id)
            added = present.keys() - subscription.keys() - _OF_THE_BROKER
            if added - {name for name in added if (name, present[name]) == ("isActive", True)}:
                with suppress(NotFound):
                    await self.delete_subscription(subscription_id)
                await self._call("POST", "/subscriptions", body=subscription)
                return
            change = {key: value for key, value in subscription.items() if key not in {"id", "@context"}}
            await self._call("PATCH", f"/subscriptions/{_in_path(subscription_id)}", body=change)

    async def types(self) -> list[str]:
        """Return the types of all entities."""
        response = await self._call("GET", "/types")
        return [str(name) for name in document_of(response, dict, self.url).get("typeList", [])]

    async def subscriptions(self) -> list[dict[str, Any]]:
        """Return all subscriptions, with the times of their changes."""
        pages = self._pages({"options": "sysAttrs"}, "/subscriptions")
        return [subscription async for page in pages for subscription in page]

    async def subscription(self, subscription_id: str) -> dict[str, Any]:
        """Return a subscription, with the times of its changes; raise `NotFound` if there is none."""
        path = f"/subscriptions/{_in_path(subscription_id)}"
        response = await self._call("GET", path, params={"options": "sysAttrs"})
        return document_of(response, dict, self.url)

    async def delete_subscription(self, subscription_id: str) -> None:
        """Delete a subscription; raise `NotFound` if there is none."""
        await self._call("DELETE", f"/subscriptions/{_in_path(subscription_id)}")

    async def _pages(
        self, selection: Mapping[str, Any], path: str = "/entities"
    ) -> AsyncIterator[list[dict[str, Any]]]:
        params = {_parameter(name): _joined(value) for name, value in selection.items() if value is not None}
        offset = 0
        while True:
            page = await self._call("GET", path, params={**params, "limit": PAGE, "offset": offset})
            entities: list[dict[str, Any]] = document_of(page, list, self.url)
            yield entities
            if len(entities) < PAGE:
                return
            offset += PAGE

    async def _call(
        self, method: str, path: str, *, params: Mapping[str, Any] | None = None, body: Any = None
    ) -> HttpResponse:
        """Send a request; where another broker finds nothing, or fails, ask first whether it has its data."""
        try:
            response = await self._request(method, path, params, body)
        except NotFound:
            if not path.startswith(_ENTITIES) or not await self._has_to_repeat():
                raise
        except BrokerFault:
            await self._has_to_repeat()
            raise
        else:
            if not finds_nothing(method, path, params, response) or not await self._has_to_repeat():
                return response
        return await self._request(method, path, params, body)

    async def _written(self, entity: Entity | NgsiLd) -> NgsiLd:
        """Return an entity or attributes as they are written to this broker. Raises `BrokerUnavailable`."""
        document = entity.to_normalized() if isinstance(entity, Entity) else entity
        if document.keys().isdisjoint(FREE_VALUES) or (await self.identity()).is_ours:
            return document
        return with_texts(document)

    async def _has_to_repeat(self) -> bool:
        """Return whether the same request may be answered otherwise now: by a broker that is not ours.

        Raises `BrokerUnavailable` if it cannot read what this client has written.
        """
        if (await self.identity()).is_ours:
            return False
        path = f"/entities/{_in_path(self._presence_id)}"
        try:
            await self._request("GET", path)
        except NotFound:
            await self._write_presence()
            try:
                await self._request("GET", path)
            except NotFound as error:
                raise self._without_data(error) from None
        except BrokerFault as error:
            raise self._without_data(error) from None
        return True

    async def _write_presence(self) -> None:
        try:
            presence = {
                "id": self._presence_id,
                "type": _PRESENCE,
                "purpose": {"type": "Property", "value": _PURPOSE},
            }
            await self._request("POST", "/entities", body=presence)
        except AlreadyExists:
            return
        except BrokerError as error:
            raise self._without_data(error) from None

    def _without_data(self, error: BrokerError) -> BrokerUnavailable:
        return BrokerUnavailable(
            503,
            "Broker without its data",
            f"{self.url} can neither read nor store {self._presence_id}: is its database away, or is it no "
            f"NGSI-LD broker? Until then nothing counts as missing ({error.status} {error.title}: "
            f"{error.detail})",
        )


def _in_path(entity_id: str) -> str:
    return quote(entity_id, safe=":")


def _parameter(name: str) -> str:
    return "idPattern" if name == "id_pattern" else name


def _joined(value: Any) -> Any:
    if isinstance(value, bool):
        return str(value).lower()
    return ",".join(value) if isinstance(value, list | tuple | set | frozenset) else value
