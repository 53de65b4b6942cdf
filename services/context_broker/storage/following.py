"""Following: what other brokers on the same database did comes into the memory of this one.

News are taken on the event loop, in the one order of all changes: after them every write is made with what
they tell, and what was on its way before them and contradicts them is made again.
"""

from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Final

from handover.telemetry import get_logger
from services.context_broker.entities.entity import Entity
from services.context_broker.storage.entries import DocumentKey, Kind
from services.context_broker.storage.replica import News

if TYPE_CHECKING:
    from services.context_broker.storage.tenants import Tenants

log = get_logger(__name__)

Follow = Callable[[str, str, bytes | None], Awaitable[None]]
"""Takes tenant, id and content of a document; None as content: it is gone."""

_FIRST: Final = (Kind.TENANT, Kind.CONTEXT)
"""What other documents need."""


class Following:
    """Takes the news of other brokers. Whoever keeps documents of a kind in memory follows those `on` it."""

    def __init__(self, tenants: "Tenants") -> None:
        self._tenants = tenants
        self._rooms: dict[Kind, Follow] = {Kind.TENANT: self._follow_tenant}

    def on(self, kind: Kind, follow: Follow) -> None:
        """Have `follow` called with each document of a kind that another broker wrote or deleted."""
        self._rooms[kind] = follow

    async def take(self, news: News) -> None:
        """Bring the memory up to the news."""
        for key in sorted(news.documents, key=_needed_first):
            follow = self._rooms.get(key[0])
            if follow is None:
                continue
            try:
                await follow(key[1], key[2], news.documents[key])
            except Exception:  # one that cannot be followed must not keep the others from being known
                log.exception("what another broker wrote cannot be taken up", kind=key[0], id=key[2])
        # From here on without an await: what is told, and that it is known, become true in one moment.
        for tenant in {key[1] for key in news.documents if key[0] is Kind.SUBSCRIPTION}:
            self._tenants.kept(tenant).store.forget_staged()  # who is to be told was decided too early
        for place, (tenant, entity_id, body) in news.entities.items():
            self._tenants.follow(place, tenant, entity_id, None if body is None else Entity.restored(body))
        for place in news.departed:
            self._tenants.places.seen(place)
        if news.is_everything:
            self._tenants.forget_all_but(news.entities)
        self._tenants.commits.knows(news.number)
        for tenant, subscription in news.owed:
            kept = self._tenants.kept(tenant)
            kept.notifier.owed_by_others(subscription)
            kept.source_notifier.owed_by_others(subscription)

    async def _follow_tenant(self, _: str, name: str, body: bytes | None) -> None:
        if body is not None:
            self._tenants.kept(name)
        else:  # only what belongs to snapshots ever goes
            self._tenants.drop(name)


def _needed_first(key: DocumentKey) -> tuple[int, DocumentKey]:
    return (_FIRST.index(key[0]) if key[0] in _FIRST else len(_FIRST)), key
