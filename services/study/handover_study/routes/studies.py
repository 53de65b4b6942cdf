"""REST routes of studies: sessions, texts, analysis, and files with answers and report."""

import asyncio
import hashlib
import pickle
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, cast

from fastapi import Body, FastAPI, Query, Request, Response
from pydantic import Field

from handover.errors import Problem
from handover.formats.strict_json import RequestBody
from handover.http.api_description import TaggedRoutes, sends
from handover.runtime.offload import Offload, OffloadFailed
from handover.security.guard import in_path, require, require_somewhere
from handover.security.permissions import Permission
from handover_study.model.protocol import FINISHED, STEPS, Language, Session
from handover_study.model.questionnaires import TLX_PAIRS, TLX_SCALES, TLX_STEP
from handover_study.model.views import (
    AnalysisView,
    DeclinedSession,
    SessionView,
    SessionWithAnswers,
    StudyAnalysis,
    WordingView,
)
from handover_study.model.wording import consent_version, wording
from handover_study.sessions.study_session import DECLINED, StudySessions

Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[\w .-]+$")]
Study = Annotated[str, Query(min_length=1, max_length=64)]

DEFAULT_STUDY = "gestures"
MAX_ANALYSES_KEPT = 8
of_person = in_path("Person", "person")


class NewSession(RequestBody):
    """A participant with a pseudonym, the next free one if none is given; never a name."""

    study: Name = DEFAULT_STUDY
    pseudonym: Name | None = None
    language: Language = "en"
    glove: Annotated[str, Field(max_length=64)] | None = None
    person: Annotated[str, Field(max_length=200)] | None = None


def add_study(app: FastAPI, sessions: StudySessions) -> None:
    """Add the routes of the study."""
    routes = TaggedRoutes(app, "study")
    analyses = _Analyses(sessions)

    @routes.get("/wording", dependencies=[require_somewhere(Permission.READ)])
    async def words(language: Language = "en") -> WordingView:
        """Return the texts for participants, and the steps, scales and pairs of the questionnaires."""
        questionnaires = {
            "consentVersion": consent_version(language),
            "order": STEPS,
            "scales": TLX_SCALES,
            "scaleStep": TLX_STEP,
            "pairs": TLX_PAIRS,
        }
        return cast("WordingView", {**wording(language), **questionnaires})

    @routes.post("/sessions", status_code=201, dependencies=[require(Permission.CONDUCT_STUDIES)])
    async def begin(session: NewSession) -> SessionView:
        """Begin a session; its first step is consent."""
        begun = await sessions.begin(
            session.study, session.pseudonym, session.language, session.glove, session.person
        )
        return view_of(begun)

    @routes.get("/sessions", dependencies=[require(Permission.READ_STUDIES)])
    async def list_sessions(study: Study | None = None) -> list[SessionView]:
        """List the sessions (of a study), oldest first."""
        return [view_of(session) for session in await sessions.sessions(study)]

    @routes.get("/sessions/{session}", dependencies=[require(Permission.READ_STUDIES)])
    async def one(session: str) -> SessionWithAnswers:
        """Return a session with its step and its answers."""
        present = await sessions.find(session)
        answers = {step: dict(answer.content) for step, answer in present.answers.items()}
        return {**view_of(present), "answers": answers}

    @routes.post("/sessions/{session}/steps/{step}", dependencies=[require(Permission.CONDUCT_STUDIES)])
    async def answer(
        session: str, step: str, content: Annotated[dict[str, Any], Body()]
    ) -> SessionView | DeclinedSession:
        """Answer a step; the answer is stored when this returns. Declined consent deletes the session."""
        moved = await sessions.answer(session, step, content)
        if moved is None:
            return {"id": session, "step": DECLINED}
        return view_of(moved)

    @routes.delete("/sessions/{session}", status_code=204, dependencies=[require(Permission.CONDUCT_STUDIES)])
    async def delete(session: str) -> None:
        """Delete a session and all its answers beyond recovery."""
        await sessions.delete(session)

    @routes.delete(
        "/persons/{person}", status_code=204, dependencies=[require(Permission.MANAGE_PEOPLE, of_person)]
    )
    async def delete_person(person: str, request: Request) -> None:
        """Delete all sessions of a person with their answers beyond recovery; 404 if there are none."""
        if not await sessions.delete_person({person, of_person(request)}):
            raise Problem.translated(
                404,
                "No session",
                "study.no_session_of_person",
                "{person} takes part in no study",
                person=person[:64],
            )

    @routes.get("/analysis", dependencies=[require(Permission.READ_STUDIES)])
    async def analysis(study: Study = DEFAULT_STUDY) -> StudyAnalysis:
        """Return the analysis of a study: SUS, NASA-TLX by condition, tests and box plots."""
        return {"study": study, **await analyses.of(study)}

    @routes.get(
        "/answers.csv",
        response_class=Response,
        responses=sends("text/csv"),
        dependencies=[require(Permission.READ_STUDIES)],
    )
    async def as_csv(study: Study = DEFAULT_STUDY) -> Response:
        """Return every answer and score of a study, one line for each participant."""
        from handover_study.report.table import csv_of  # noqa: PLC0415 - seldom asked for

        text = csv_of(await sessions.sessions(study))
        return _file(text.encode(), "text/csv; charset=utf-8", study, "csv")

    @routes.get(
        "/report.pdf",
        response_class=Response,
        responses=sends("application/pdf"),
        dependencies=[require(Permission.READ_STUDIES)],
    )
    async def as_pdf(study: Study = DEFAULT_STUDY, language: Language = "en") -> Response:
        """Return the report of a study on A4."""
        from handover_study.report.pdf import pdf_of  # noqa: PLC0415 - seldom asked for

        result = await analyses.of(study)
        today = datetime.now(UTC).date().isoformat()
        pdf = await asyncio.to_thread(pdf_of, result, study, language, today)
        return _file(pdf, "application/pdf", study, "pdf")


def view_of(session: Session) -> SessionView:
    """Return a session without its answers."""
    is_over = session.step == FINISHED
    return {
        "id": session.id,
        "study": session.study,
        "pseudonym": session.pseudonym,
        "language": session.language,
        "glove": session.glove,
        "person": session.person,
        "step": session.step,
        "stepNumber": len(STEPS) if is_over else STEPS.index(session.step) + 1,
        "steps": len(STEPS),
        "first": session.first,
        "condition": session.condition,
        "pairs": session.pairs() if session.step.startswith("tlx") else None,
        "consentVersion": consent_version(session.language),
        "beganAt": session.began_at,
        "endedAt": session.ended_at,
    }


class _Analyses:
    """Analyses studies in another process, since importing SciPy would block this one for a second.

    The results are cached until the answers change.
    """

    def __init__(self, sessions: StudySessions) -> None:
        self._study_sessions = sessions
        self._offload = Offload()
        self._kept: dict[bytes, AnalysisView] = {}

    async def of(self, study: str) -> AnalysisView:
        """Return the analysis of `study`."""
        sessions = await self._study_sessions.sessions(study)
        key = hashlib.sha256(pickle.dumps(sessions)).digest()
        kept = self._kept.pop(key, None)
        analysis = kept if kept is not None else await self._analysed(sessions)
        self._kept[key] = analysis
        while len(self._kept) > MAX_ANALYSES_KEPT:
            del self._kept[next(iter(self._kept))]
        return analysis

    async def _analysed(self, sessions: Sequence[Session]) -> AnalysisView:
        from handover_study.report.analysis import analysis_of  # noqa: PLC0415 - seldom asked for

        try:
            return await self._offload.run(analysis_of, sessions)
        except OffloadFailed as error:
            raise Problem(503, "Cannot be analysed", f"{error}; try again later") from None


def _file(content: bytes, media_type: str, study: str, kind: str) -> Response:
    plain = "".join(char if char.isascii() and char.isalnum() else "-" for char in study)
    disposition = f'attachment; filename="study-{plain}.{kind}"'
    return Response(content, media_type=media_type, headers={"Content-Disposition": disposition})
