"""What is taken home: the table for statistics programs, and the report on paper."""

import csv
import io
import re
import zlib
from dataclasses import replace
from typing import Any

import pytest

from handover_study.model.protocol import LANGUAGES, StepAnswer
from handover_study.report.analysis import analysis_of
from handover_study.report.pdf import pdf_of
from handover_study.report.table import csv_of


def rows_of(sessions: list[Any]) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(csv_of(sessions))))


def test_the_table_has_a_line_a_participant_with_answers_and_scores(twenty: list[Any]) -> None:
    rows = rows_of(twenty)
    assert len(rows) == 20
    assert (rows[0]["pseudonym"], rows[0]["first"], rows[1]["first"]) == ("P01", "personal", "predefined")
    assert [rows[0][f"sus{nth}"] for nth in range(1, 11)] == [
        "5",
        "1",
        "5",
        "1",
        "5",
        "1",
        "3",
        "5",
        "1",
        "5",
    ]
    assert float(rows[0]["sus"]) == 65
    for row in rows:  # whichever came first
        assert (row["personal_frustration"], row["predefined_frustration"]) == ("60.0", "40.0")
        assert [row[f"personal_weight_{scale}"] for scale in ("mental", "effort")] == ["5", "1"]


def test_what_was_not_answered_is_empty(twenty: list[Any]) -> None:
    (row,) = rows_of([replace(twenty[0], answers={}, first=None, step="consent")])
    assert {
        row[column] for column in ("sus", "sus1", "personal_raw", "predefined_weight_effort", "comment")
    } == {""}


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@SUM(A1)"])
def test_no_spreadsheet_takes_a_comment_for_a_formula(twenty: list[Any], text: str) -> None:
    said = StepAnswer({"preferred": "none", "recalibrated": False, "comment": text}, "en", "", "")
    (row,) = rows_of([replace(twenty[0], answers={"preference": said})])
    assert row["comment"] == f"'{text}"


def text_of(pdf: bytes) -> str:
    """All text that is shown in the PDF, roughly: what stands in brackets in its streams."""
    import base64

    streams = re.findall(rb"stream\r?\n(.*?)endstream", pdf, re.DOTALL)
    shown = []
    for stream in streams:
        try:
            plain = zlib.decompress(
                base64.a85decode(stream.strip(), adobe=False) if stream.strip().endswith(b"~>") else stream
            )
        except ValueError:
            plain = zlib.decompress(base64.a85decode(stream.strip().removesuffix(b"~>")))
        shown += re.findall(rb"\(((?:\\.|[^\\)])*)\)", plain)
    return b" ".join(shown).decode("cp1252", errors="replace")


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_report_says_what_was_found_in_every_language(analysis: dict[str, Any], language: str) -> None:
    pdf = pdf_of(analysis, "gestures", language, "2026-03-02")  # type: ignore[arg-type]  # parametrized
    assert pdf.startswith(b"%PDF")
    text = text_of(pdf)
    mark = "." if language == "en" else ","
    assert f"78{mark}50" in text
    assert f"180{mark}5" in text
    assert "B+" in text


def test_the_report_on_no_answers_says_so() -> None:
    assert "No answers yet" in text_of(pdf_of(analysis_of([]), "gestures", "en", "2026-03-02"))


@pytest.mark.nightly
def test_nothing_heavy_is_loaded_before_somebody_asks_for_it() -> None:
    import subprocess
    import sys

    asked = (
        "import handover_gloves.app, sys;"
        "print([m for m in ('scipy', 'PIL', 'reportlab') if m in sys.modules])"
    )
    said = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"
