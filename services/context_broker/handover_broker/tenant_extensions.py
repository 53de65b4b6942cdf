"""The federation state of one tenant as far as the core needs it, with an implementation for none."""

from collections.abc import Collection, Iterator
from typing import Protocol

from handover_broker.storage.entries import DocumentKey

Announced = tuple[Collection[str], Collection[str]]
"""Attributes and types (IRIs) that a context source has registered together."""


class TenantFederation(Protocol):
    """Registrations of one tenant, as far as the core asks for them."""

    @property
    def is_empty(self) -> bool:
        """Whether no request can concern a context source. Read for each request: O(1)."""

    def announced(self) -> Iterator[Announced]:
        """Yield the attributes and types that context sources have registered."""

    def has_subscription(self, subscription_id: str) -> bool:
        """Return whether the id belongs to a subscription to registrations."""

    def document_keys(self) -> Iterator[DocumentKey]:
        """Yield the keys of all stored documents, so that they can be deleted with the tenant."""

    def stop(self) -> None:
        """Stop delivering; pending notifications stay in the outbox."""


class LocalTenant:
    """The state of a tenant without federation: there are no registrations."""

    is_empty = True

    def announced(self) -> Iterator[Announced]:
        return iter(())

    def has_subscription(self, subscription_id: str) -> bool:
        return False

    def document_keys(self) -> Iterator[DocumentKey]:
        return iter(())

    def stop(self) -> None:
        return
