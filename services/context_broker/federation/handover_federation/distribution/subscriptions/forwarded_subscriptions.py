"""Subscriptions that are forwarded to context sources, with the broker as the subscriber.

A forwarded subscription is stored before the source receives it, and deleted after the source has deleted it.
After a crash in between, the broker still knows which subscriptions may exist and can delete them.
"""

from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any, Final

import orjson

from handover_broker.contexts.context_resolver import ContextResolver
from handover_broker.delivery.subscription import Subscription
from handover_broker.delivery.subscription_documents import NAMES_IN, shown_document
from handover_broker.query.parameters import FILTER_MEMBERS
from handover_broker.query.type_selection import TypeSelection
from handover_federation.distribution.forwarding.forwarder import SourceDialect
from handover_federation.registrations.registration import EntityTarget, Registration
from handover_federation.registrations.registration_parser import registration

PATH: Final = "sourceNotifications"
_NOT_PASSED_ON: Final = (
    "id", "status", "isActive", "jsonldContext", "csf", "throttling", "lang", "datasetId", "localOnly",
    "notification", "createdAt", "modifiedAt", "watchedAttributes", "splitEntities", "ngsildConformance",
)  # fmt: skip
"""Members that only this broker evaluates, or that it sets itself."""


@dataclass(frozen=True, slots=True)
class ForwardedSubscription:
    """One subscription at one source. `token` is part of its id there and of the notification endpoint here.

    `document_digest` changes with the forwarded document, `base` is the address of this broker in the
    notification endpoint. `is_confirmed`: the source has accepted the subscription.
    """

    token: str
    tenant: str
    subscription: str
    registration: Registration
    document_digest: str
    base: str
    is_confirmed: bool

    @property
    def id(self) -> str:
        """Return the id of the subscription at the source."""
        return f"urn:ngsi-ld:Subscription:{self.token}"

    @property
    def key(self) -> tuple[str, str]:
        """Return the ids of the subscription and of the registration."""
        return self.subscription, self.registration.id

    def confirmed(self) -> "ForwardedSubscription":
        """Return the forwarded subscription as confirmed by its source."""
        return replace(self, is_confirmed=True)

    def stored(self) -> bytes:
        """Return the document for the journal."""
        source = self.registration
        return orjson.dumps(
            {
                "subscription": self.subscription,
                "registration": source.document,
                "context": source.context.document,
                "digest": self.document_digest,
                "base": self.base,
                "isConfirmed": self.is_confirmed,
            }
        )


async def restored(
    token: str, tenant: str, stored: bytes, contexts: ContextResolver
) -> ForwardedSubscription:
    """Return the forwarded subscription of a stored document. Raises a problem for an invalid source."""
    fields = orjson.loads(stored)
    source = registration(fields["registration"], await contexts.as_before(fields["context"]))
    return ForwardedSubscription(
        token,
        tenant,
        fields["subscription"],
        source,
        fields["digest"],
        fields["base"],
        is_confirmed=fields["isConfirmed"],
    )


def questions(subscription: Subscription) -> list[EntityTarget]:
    """Return the entities and attributes of a subscription, for matching registrations."""
    watched = subscription.triggers.watched
    names = None if watched is None else frozenset(watched)
    if not subscription.selectors:
        return [EntityTarget(attributes=names)]
    result = []
    for selector in subscription.selectors:
        types = None
        if selector.types is not None and not selector.types.is_every:
            types = frozenset(selector.types.names())
        ids = None if selector.ids is None else tuple(sorted(selector.ids))
        result.append(EntityTarget(ids, selector.id_pattern, types, names))
    return result


def forwarded_document(
    subscription: Subscription, source: Registration, dialect: SourceDialect
) -> dict[str, Any]:
    """Return the document to forward to a source, without its notification endpoint.

    Filters apply to whole entities, so this broker evaluates them. They are forwarded as well if the source
    has whole entities and uses the names in the filters.
    """
    document = shown_document(subscription, dialect.context, 0.0, sys_attrs=False)
    for name in _NOT_PASSED_ON:
        document.pop(name, None)
    if (entities := _entities(subscription, source, dialect)) is not None:
        document["entities"] = entities
    is_whole = not subscription.document.get("splitEntities") and all(
        piece.attributes is None for piece in source.information
    )
    if not is_whole or dialect.context.key != subscription.names.key or NAMES_IN in subscription.document:
        for name in FILTER_MEMBERS:
            document.pop(name, None)
    names = _watched(subscription, source)
    if names is not None and subscription.interval_s is None:
        document["watchedAttributes"] = sorted(dialect.name(name) for name in names)
    if subscription.shows_changes:
        document["notification"] = {"showChanges": True}
    if dialect.link is not None:
        document["jsonldContext"] = dialect.link
    return document


def _entities(
    subscription: Subscription, source: Registration, dialect: SourceDialect
) -> list[dict[str, Any]] | None:
    """Return the entity selectors within the registration of a source; None for any entity."""
    selectors: dict[str, dict[str, Any]] = {}
    for selector, target in zip(subscription.selectors or (None,), questions(subscription), strict=True):
        for part in source.parts(target):
            narrowed: dict[str, Any] = {}
            types = () if selector is None or selector.types is None else selector.types.alternatives
            if part.types is not None:
                some = tuple(kinds for kinds in types if kinds and not kinds.isdisjoint(part.types))
                types = some or tuple(frozenset({kind}) for kind in sorted(part.types))
            if types:
                narrowed["type"] = TypeSelection(types).written(dialect.name)
            if part.ids is None and selector is not None and selector.id_pattern is not None:
                narrowed["idPattern"] = selector.id_pattern.text
            for entity_id in part.ids or (None,):
                chosen = narrowed if entity_id is None else {"id": entity_id, **narrowed}
                if chosen:
                    selectors[str(chosen)] = chosen
    return list(selectors.values()) or None


def _watched(subscription: Subscription, source: Registration) -> frozenset[str] | None:
    """Return the watched attributes that the source has, None for all."""
    watched = subscription.triggers.watched
    registered: frozenset[str] | None = frozenset()
    for piece in source.information:
        if registered is None or piece.attributes is None:
            registered = None
        else:
            registered |= piece.attributes
    if watched is None or registered is None:
        return registered if watched is None else frozenset(watched)
    return frozenset(watched) & registered


def with_endpoint(document: dict[str, Any], base: str, token: str) -> dict[str, Any]:
    """Return the document with this broker as the subscriber."""
    uri = f"{base}/ngsi-ld/v1/{PATH}/{token}"
    notification = {
        "format": "normalized",
        "sysAttrs": True,
        **document.get("notification", {}),
        "endpoint": {"uri": uri, "accept": "application/json"},
    }
    return {**document, "id": f"urn:ngsi-ld:Subscription:{token}", "notification": notification}


def digest(document: dict[str, Any]) -> str:
    """Return a digest that changes with the forwarded document."""
    return sha256(orjson.dumps(document, option=orjson.OPT_SORT_KEYS)).hexdigest()[:32]
