"""Gesture conditions: keeps the conditions of the gesture controller equal to those of the sessions.

The controller asks a participant for their own gestures or for those of the site. Each change is sent
at once. A request can fail and both services can restart, so `reconcile` is repeated every few seconds.
Of several sessions with the same glove or person, only the latest one counts.
"""

import asyncio
from collections.abc import Iterable
from typing import Any

from handover.telemetry import get_logger
from handover_study.model.protocol import FINISHED, Condition, Session
from handover_study.sessions.controller_client import ControllerClient, ControllerUnavailable

log = get_logger(__name__)

_GESTURES = {Condition.PERSONAL: "own", Condition.PREDEFINED: "site"}


class GestureConditions:
    """The conditions that the controller should have."""

    def __init__(self, client: ControllerClient) -> None:
        self._client = client
        self._wanted: dict[str, dict[str, Any]] = {}
        self._sending = asyncio.Lock()

    def load(self, sessions: Iterable[Session]) -> None:
        """Set the wanted conditions from all sessions, oldest first."""
        for session in sessions:
            self._set(session)

    async def update(self, session: Session) -> None:
        """Apply the condition of the present step of `session`; end it if the session has finished."""
        self._set(session)
        await self.reconcile()

    async def remove(self, session_id: str) -> None:
        """End the condition of a session."""
        if self._wanted.pop(session_id, None) is not None:
            await self.reconcile()

    async def reconcile(self) -> bool:
        """Make the conditions of the controller equal to the wanted ones; return False on failure."""
        async with self._sending:
            try:
                present = await self._client.conditions()
                for session in present.keys() - self._wanted.keys():
                    await self._client.remove_condition(session)
                for session, condition in self._wanted.items():
                    if present.get(session) != condition:
                        await self._client.set_condition(session, condition)
            except ControllerUnavailable as error:
                log.warning("study conditions were not applied", error=str(error))
                return False
        return True

    def _set(self, session: Session) -> None:
        self._wanted.pop(session.id, None)
        if session.step == FINISHED or (session.glove is None and session.person is None):
            return
        condition = {
            "participant": session.pseudonym,
            "glove": session.glove,
            "person": session.person,
            "gestures": _GESTURES[session.condition] if session.condition is not None else None,
        }
        self._wanted = {
            key: wanted for key, wanted in self._wanted.items() if not _overlap(wanted, condition)
        } | {session.id: condition}


def _overlap(wanted: dict[str, Any], other: dict[str, Any]) -> bool:
    return any(wanted[name] is not None and wanted[name] == other[name] for name in ("glove", "person"))
