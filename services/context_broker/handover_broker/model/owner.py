"""Owners: who created or last changed a subscription or a registration, and so receives what it sends."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

from handover.security.caller import Caller, CallerKind

OWNER: Final = "owner"
"""In a stored document: its owner. No response contains it."""


@dataclass(frozen=True, slots=True)
class Owner:
    """A caller without its grants, which may change. A service is known by name, others by subject."""

    kind: CallerKind
    subject: str
    name: str

    @property
    def is_service(self) -> bool:
        """Return whether it is a service of the cell."""
        return self.kind is CallerKind.SERVICE

    def is_same(self, other: "Owner") -> bool:
        """Return whether both are one caller."""
        if self.is_service or other.is_service:
            return self.kind is other.kind and self.name == other.name
        return self.subject == other.subject

    def stored(self) -> dict[str, str]:
        """Return the member of the stored document."""
        return {"kind": self.kind.value, "subject": self.subject, "name": self.name}

    @classmethod
    def of(cls, caller: Caller) -> Self:
        """Return a caller as an owner."""
        return cls(caller.kind, caller.subject, caller.name)

    @classmethod
    def restored(cls, document: Mapping[str, Any]) -> Self | None:
        """Return the owner in a stored document; None if it was stored before owners were recorded."""
        stored = document.get(OWNER)
        if not isinstance(stored, Mapping):
            return None
        return cls(CallerKind(stored["kind"]), stored["subject"], stored["name"])
