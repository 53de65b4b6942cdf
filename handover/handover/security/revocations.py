"""Revocations: sessions, tokens and grants that became invalid before their tokens expire.

`accounts` numbers its revocations. A token carries the number up to which it takes revocations into account;
a later one that names its subject or its session makes it invalid, so the clocks of machines do not matter.
Services follow the stream `GET /revocations` by long polling. A service without an answer for `MAX_SILENCE_S`
refuses whatever moves or changes something, since it may have missed a revocation.
"""

from collections.abc import Mapping
from typing import Any, Final, Protocol

from handover.runtime.clocks import steady_s
from handover.security.caller import Caller

MAX_SILENCE_S: Final = 5.0
LONG_POLL_S: Final = 2.0
KEPT_S: Final = 900.0
"""Age at which `accounts` drops a revocation: older tokens have expired."""


class RevocationState(Protocol):
    """What the guard asks about revocations."""

    def is_revoked(self, caller: Caller) -> bool:
        """Return whether a revocation made `caller` invalid."""
        ...

    def is_current(self) -> bool:
        """Return whether the state is recent enough for what moves or changes something."""
        ...


class FollowedRevocations:
    """The revocations that a service received from `accounts`."""

    def __init__(self) -> None:
        self.position = 0
        self._by_name: dict[str, int] = {}
        self._answered_s: float | None = None

    def apply(self, document: Mapping[str, Any]) -> None:
        """Add a document of the stream: `position`, and `revoked` as a list of `[position, name]`."""
        position = int(document["position"])
        if position < self.position:
            self._by_name.clear()  # `accounts` was restored from a backup
        for number, name in document["revoked"]:
            self._by_name[str(name)] = int(number)
        self.position = position
        self._answered_s = steady_s()

    def is_revoked(self, caller: Caller) -> bool:
        """Return whether a revocation made `caller` invalid."""
        latest = self._by_name.get(caller.subject, 0)
        if caller.session is not None:
            latest = max(latest, self._by_name.get(caller.session, 0))
        return latest > caller.revision

    def is_current(self) -> bool:
        """Return whether `accounts` answered within `MAX_SILENCE_S`."""
        return self._answered_s is not None and steady_s() - self._answered_s <= MAX_SILENCE_S
