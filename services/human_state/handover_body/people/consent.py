"""Consent: what a person allows, and until when. Without a valid one nothing is processed or stored.

Health data needs explicit consent for named purposes (GDPR Art. 9 (2) a, Art. 4 (11) and 7): it ends at a
date, and is withdrawn as easily as it is given.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from handover_body.storage.store import ConsentRow

MAX_CONSENT_DAYS: Final = 366.0


class Purpose(StrEnum):
    """What a consent is for."""

    LIVE = "live"
    """Signals are processed and shown live; required by each other purpose."""
    SPEED_LIMITS = "speedLimits"
    """The heart rate limits the speed of robots, and a lasting strain proposes a break."""
    HISTORY = "history"
    """Values are kept in the database of this service for the time of retention."""
    BROKER = "broker"
    """HumanState entities are written to the context broker."""
    BROKER_HISTORY = "brokerHistory"
    """The broker keeps the history of these entities, if it keeps any; else it is deleted again and again."""
    RECORDING = "recording"
    """Signals may be recorded in recordings that somebody starts and stops."""


@dataclass(frozen=True, slots=True)
class Consent:
    """The newest consent of a person, or none."""

    row: ConsentRow | None = None

    def purposes(self, now_us: int) -> frozenset[Purpose]:
        """Return what is allowed now."""
        row = self.row
        if row is None or row.withdrawn_us is not None or not row.given_us <= now_us < row.ends_us:
            return frozenset()
        purposes_of_row = frozenset(Purpose(purpose) for purpose in row.purposes if purpose in set(Purpose))
        return purposes_of_row if Purpose.LIVE in purposes_of_row else frozenset()
