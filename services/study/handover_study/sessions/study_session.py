"""Study sessions: they begin, move from step to step, and can be deleted at any time."""

import asyncio
import random
from collections.abc import Collection, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any, Final, Self
from uuid import uuid4

from handover.database.outage import in_database
from handover.errors import Problem
from handover_datamodels.times import iso
from handover_study.model.protocol import FINISHED, STEPS, Language, Session, StepAnswer, checked
from handover_study.model.wording import consent_version
from handover_study.sessions.gesture_conditions import GestureConditions
from handover_study.storage.store import StudyStore

DECLINED: Final = "declined"


class StudySessions:
    """All sessions of all studies; an asynchronous context manager."""

    def __init__(self, store: StudyStore, conditions: GestureConditions) -> None:
        self._store = store
        self._conditions = conditions
        self._answering = asyncio.Lock()

    async def __aenter__(self) -> Self:
        await asyncio.to_thread(self._store.prepare)
        self._conditions.load(await self.sessions(None))
        return self

    async def __aexit__(self, *_: object) -> None:
        pass

    async def begin(
        self, study: str, pseudonym: str | None, language: Language, glove: str | None, person: str | None
    ) -> Session:
        """Begin a session; without a pseudonym it gets the next free one, such as "P07"."""
        async with self._answering:
            name = pseudonym or await self._next_pseudonym(study)
            session = Session(str(uuid4()), study, name, language, iso(datetime.now(UTC)), glove, person)
            await in_database(self._store.add, session)
            await self._conditions.update(session)
        return session

    async def answer(self, session_id: str, step: str, body: Mapping[str, Any]) -> Session | None:
        """Store the answer to `step`; return the session at its next step, or None after declined consent.

        Repeating the same answer changes nothing; another answer raises `Problem` 409.
        """
        async with self._answering:
            session = await self.find(session_id)
            content = checked(step, body)
            present = session.answers.get(step)
            if present is not None:
                if present.content == content:
                    return session
                raise Problem(409, "Answered already", f'"{step}" is answered; the first answer counts')
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
                    await in_database(self._store.delete, session_id)
                    await self._conditions.remove(session_id)
                    return None
            answer = StepAnswer(content, session.language, session.last_at, iso(datetime.now(UTC)))
            lot = random.random()  # noqa: S311 - a random order, no secret
            await in_database(self._store.answer, session, step, answer, lot)
            moved = await self.find(session_id)
            await self._conditions.update(moved)
            return moved

    async def delete(self, session_id: str) -> None:
        """Delete a session beyond recovery; raises `Problem` 404."""
        async with self._answering:
            await self.find(session_id)
            await in_database(self._store.delete, session_id)
            await self._conditions.remove(session_id)

    async def delete_person(self, names: Collection[str]) -> int:
        """Delete the sessions of a person, who is named in one of these ways; return how many."""
        theirs = [session.id for session in await self.sessions(None) if session.person in names]
        for session_id in theirs:
            with suppress(Problem):  # somebody else has deleted it meanwhile
                await self.delete(session_id)
        return len(theirs)

    async def find(self, session_id: str) -> Session:
        """Return a session; raises `Problem` 404."""
        session = await in_database(self._store.session, session_id)
        if session is None:
            raise _unknown(session_id)
        return session

    async def sessions(self, study: str | None) -> list[Session]:
        """Return the sessions (of `study`), oldest first."""
        return await in_database(self._store.sessions, study)

    async def _next_pseudonym(self, study: str) -> str:
        taken = {session.pseudonym for session in await self.sessions(study)}
        return next(name for nth in range(1, len(taken) + 2) if (name := f"P{nth:02}") not in taken)


def _not_yet(session: Session, step: str) -> str:
    if session.step == FINISHED:
        return f"{session.pseudonym} has finished; nothing is asked any more"
    return (
        f'{session.pseudonym} is at step {STEPS.index(session.step) + 1}, "{session.step}", not at "{step}"'
    )


def _unknown(session_id: str) -> Problem:
    return Problem(404, "Unknown session", f'there is no session "{session_id}"; it may have been deleted')
