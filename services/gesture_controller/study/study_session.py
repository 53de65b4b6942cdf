"""The conduct of a study: sessions begin, are led from step to step, and may be deleted at any time."""

import asyncio
import random
from collections.abc import Awaitable, Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Self
from uuid import uuid4

from sqlalchemy.exc import SQLAlchemyError

from datamodels.times import iso
from handover.errors import Problem
from services.gesture_controller.study.protocol import (
    FINISHED,
    STEPS,
    Answer,
    Language,
    Session,
    checked,
)
from services.gesture_controller.study.store import StudyStore
from services.gesture_controller.study.wording import consent_version

DECLINED = "declined"


class StudySessions:
    """All sessions of all studies; an asynchronous context manager while it is on duty.

    `apply(session, is_restart)` has the participant asked for the gestures that the present step is about;
    `is_restart` is True for a session that an earlier run of the service has begun. `release(id)` ends that
    for a session that is over or deleted.
    """

    def __init__(
        self,
        store: StudyStore,
        apply: Callable[[Session, bool], Awaitable[None]],
        release: Callable[[str], None],
    ) -> None:
        self._store = store
        self._apply = apply
        self._release = release
        self._answering = asyncio.Lock()

    async def __aenter__(self) -> Self:
        await asyncio.to_thread(self._store.prepare)
        for session in await self.sessions(None):
            await self._set_gestures(session, is_restart=True)
        return self

    async def __aexit__(self, *_: object) -> None:
        pass

    async def begin(
        self, study: str, pseudonym: str | None, language: Language, glove: str | None, person: str | None
    ) -> Session:
        """Begin a session with a pseudonym ("P07", the next free one, if none is given)."""
        async with self._answering:
            name = pseudonym or await self._next_pseudonym(study)
            session = Session(str(uuid4()), study, name, language, iso(datetime.now(UTC)), glove, person)
            await self._do(self._store.add, session)
            await self._set_gestures(session)
        return session

    async def answer(self, session_id: str, step: str, given: Mapping[str, Any]) -> Session | None:
        """Keep the answer to `step`; returns the session at its next step, or None if consent was declined.

        The same answer again changes nothing, so it may be sent twice; another is refused: `Problem` 409.
        """
        async with self._answering:
            session = await self.one(session_id)
            content = checked(step, given)
            known = session.answers.get(step)
            if known is not None:
                if known.content == content:
                    return session
                raise Problem(409, "Answered already", f'"{step}" is answered; what was said first counts')
            if session.step != step:
                raise Problem(409, "Another step", _not_yet(session, step))
            if step == "consent":
                if content["text"] != consent_version(session.language):
                    raise Problem(
                        409,
                        "Another text",
                        "the text of consent has changed; show the present one and ask again",
                    )
                if not content["agreed"]:
                    await self._do(self._store.delete, session_id)
                    self._release(session_id)
                    return None
            answer = Answer(content, session.language, session.last_at, iso(datetime.now(UTC)))
            lot = random.random()  # noqa: S311 - who comes next is no secret
            await self._do(self._store.answer, session, step, answer, lot)
            moved = await self.one(session_id)
            await self._set_gestures(moved)
            return moved

    async def delete(self, session_id: str) -> None:
        """Delete a session beyond recovery; `Problem` 404 if there is none."""
        async with self._answering:
            await self.one(session_id)
            await self._do(self._store.delete, session_id)
            self._release(session_id)

    async def one(self, session_id: str) -> Session:
        """Return a session; `Problem` 404 if there is none."""
        session: Session | None = await self._do(self._store.session, session_id)
        if session is None:
            raise _unknown(session_id)
        return session

    async def sessions(self, study: str | None) -> list[Session]:
        """Return the sessions (of `study`) in the order in which they began."""
        found: list[Session] = await self._do(self._store.sessions, study)
        return found

    async def _set_gestures(self, session: Session, *, is_restart: bool = False) -> None:
        """Have the participant asked for the gestures that the present step is about."""
        if session.step == FINISHED:
            self._release(session.id)
        elif session.glove is not None or session.person is not None:
            await self._apply(session, is_restart)

    async def _next_pseudonym(self, study: str) -> str:
        taken = {session.pseudonym for session in await self.sessions(study)}
        return next(name for nth in range(1, len(taken) + 2) if (name := f"P{nth:02}") not in taken)

    async def _do(self, act: Any, *what: Any) -> Any:
        try:
            return await asyncio.to_thread(act, *what)
        except SQLAlchemyError as error:
            raise Problem(
                503, "Database away", f"the database of the study cannot be used ({error}); try again later"
            ) from None


def _not_yet(session: Session, step: str) -> str:
    if session.step == FINISHED:
        return f"{session.pseudonym} has finished; nothing is asked any more"
    return (
        f'{session.pseudonym} is at step {STEPS.index(session.step) + 1}, "{session.step}", not at "{step}"'
    )


def _unknown(session_id: str) -> Problem:
    return Problem(404, "Unknown session", f'there is no session "{session_id}"; it may have been deleted')
