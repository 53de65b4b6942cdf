"""The table: one line a participant, with every answer and score, for statistics programs."""

import csv
import io
from collections.abc import Iterator, Sequence
from typing import Any

from handover_study.model.protocol import Condition, Session
from handover_study.model.questionnaires import SUS_ITEMS, TLX_SCALES, tlx_weights
from handover_study.report.analysis import MEASURES, scores_of

_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def csv_of(sessions: Sequence[Session]) -> str:
    """Return the sessions as CSV (RFC 4180, UTF-8); what was not answered is empty."""
    file = io.StringIO()
    rows = [dict(_cells(session)) for session in sessions]
    table = csv.DictWriter(file, fieldnames=list(COLUMNS))
    table.writeheader()
    table.writerows({column: _harmless(row[column]) for column in COLUMNS} for row in rows)
    return file.getvalue()


def _cells(session: Session) -> Iterator[tuple[str, Any]]:
    yield from (
        ("study", session.study),
        ("pseudonym", session.pseudonym),
        ("language", session.language),
        ("first", session.first.value if session.first else None),
        ("step", session.step),
        ("beganAt", session.began_at),
        ("endedAt", session.ended_at),
    )
    introduction = _content(session, "introduction")
    yield "age_years", introduction.get("age_years")
    yield "experience", introduction.get("experience")
    scores = scores_of(session)
    items = _content(session, "sus").get("answers", [None] * SUS_ITEMS)
    yield from ((f"sus{nth + 1}", item) for nth, item in enumerate(items))
    yield "sus", scores.sus
    for condition in Condition:
        yield from _cells_of(session, condition, scores.tlx.get(condition, {}))
    preference = _content(session, "preference")
    yield from ((name, preference.get(name)) for name in ("preferred", "recalibrated", "comment"))


def _cells_of(session: Session, condition: Condition, scores: dict[str, float]) -> Iterator[tuple[str, Any]]:
    nth = "1" if session.first is condition else "2"
    task = session.answers.get(f"interaction{nth}") if session.first else None
    yield f"{condition.value}_completed", task.content["completed"] if task else None
    yield f"{condition.value}_from", task.opened_at if task else None
    yield f"{condition.value}_until", task.answered_at if task else None
    yield f"{condition.value}_notes", task.content["notes"] if task else None
    yield from ((f"{condition.value}_{measure}", scores.get(measure)) for measure in MEASURES)
    choices = _content(session, f"tlx{nth}").get("choices", []) if session.first else []
    weights = tlx_weights([choice["chosen"] for choice in choices]) if choices else {}
    yield from ((f"{condition.value}_weight_{scale}", weights.get(scale)) for scale in TLX_SCALES)


def _content(session: Session, step: str) -> dict[str, Any]:
    answer = session.answers.get(step)
    return dict(answer.content) if answer else {}


def _harmless(value: Any) -> Any:
    """Return `value` so that no spreadsheet takes a text for a formula."""
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


COLUMNS = tuple(name for name, _ in _cells(Session("", "", "", "en", "")))
