"""Writes the session that runs to the database: at its start and end, and every second while it changes."""

import asyncio
from typing import Any, Final

from sqlalchemy.exc import SQLAlchemyError

from handover.database.outage import database_reason
from handover.errors import Problem
from handover_humanoid.running.sessions.store import SessionStore
from handover_humanoid.running.sessions.training import Session, SessionPlan, Training
from handover_humanoid.sessions.exercise import EndReason

WRITE_EVERY_S: Final = 1.0


class SessionWriter:
    """Begins sessions and keeps them."""

    def __init__(self, training: Training, store: SessionStore) -> None:
        self._training, self._store = training, store
        self._written: tuple[str, dict[str, Any]] | None = None
        self._lock = asyncio.Lock()

    async def begin(self, plan: SessionPlan) -> Session:
        """Begin a session; it is in the database before it is returned. Raises `Problem` 409, 503."""
        await self.flush()
        session = self._training.open(plan)
        try:
            await asyncio.to_thread(self._store.add, self._training.row(session))
        except SQLAlchemyError as error:
            self._training.end(EndReason.FAULT)
            session.is_closed = True
            raise Problem.translated(
                503,
                "Not stored",
                "humanoid.session_not_stored",
                "the session has ended again, since it cannot be stored: {reason}",
                reason=database_reason(error),
            ) from None
        return session

    async def flush(self) -> None:
        """Write what has changed."""
        async with self._lock:
            session = self._training.current
            if session is None or session.is_closed:
                return
            values = session.figures()
            if self._written == (session.id, values):
                return
            is_ended = session.is_ended
            await asyncio.to_thread(self._store.change, session.id, values)
            self._written, session.is_closed = (session.id, values), is_ended

    async def run(self) -> None:
        """Write until cancelled."""
        while True:
            await asyncio.sleep(WRITE_EVERY_S)
            await self.flush()
