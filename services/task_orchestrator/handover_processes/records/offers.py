"""Offers: definitions of other systems, and what engineers have decided about them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Any

from handover_bpmn.model import Fault


class OfferStatus(StrEnum):
    """What has become of an offer."""

    OPEN = "open"
    ACCEPTED = "accepted"
    REJECTED = "rejected"
    SUPERSEDED = "superseded"
    WITHDRAWN = "withdrawn"


@dataclass(frozen=True, slots=True)
class Decision:
    """An engineer has accepted or rejected an offer; `verified`: `by` is the name of who was signed in."""

    at: datetime
    status: OfferStatus
    by: str
    why: str | None = None
    deployed: tuple[tuple[str, int], ...] = ()
    """Name and version of the definitions that were deployed."""
    verified: bool = False


@dataclass(frozen=True, slots=True)
class OfferRecord:
    """A definition of another system in the broker, offered to an engineer.

    An offer is one content of one entity; the same content that returns is the same offer.
    """

    id: str
    entity: str
    type: str
    name: str
    status: OfferStatus
    found_at: datetime
    content: Mapping[str, Any] = field(repr=False)
    """The entity in simplified form; the BPMN file is stored separately."""
    faults: tuple[Fault, ...] = ()
    warnings: tuple[Fault, ...] = ()
    has_file: bool = False
    times: int = 1
    """How often the entity has had this content."""
    decisions: tuple[Decision, ...] = ()
    in_force: bool = False
    """Whether it is the content of its entity that was accepted last."""

    @property
    def is_decided(self) -> bool:
        """Return whether an engineer has decided about it."""
        return bool(self.decisions)
