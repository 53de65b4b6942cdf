"""The report on paper: what the study found, on two or three pages of A4 with vector charts."""

import io
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from handover_study.model.protocol import Language
from handover_study.model.questionnaires import TLX_SCALES
from handover_study.model.wording import wording
from handover_study.report.analysis import MEASURES
from handover_study.report.charts import sus_chart, tlx_chart

_GRID, _INK, _QUIET = "#d9dde5", "#1b2333", "#5a6478"


def pdf_of(analysis: Mapping[str, Any], study: str, language: Language, date: str) -> bytes:
    """Return the report on `analysis` as PDF; `date` is printed as it is given. Takes about half a second."""
    from reportlab.lib.pagesizes import A4  # noqa: PLC0415 - heavy, and seldom asked for
    from reportlab.platypus import SimpleDocTemplate  # noqa: PLC0415 - as above

    words = _Words(language)
    file = io.BytesIO()
    document = SimpleDocTemplate(
        file, pagesize=A4, leftMargin=50, rightMargin=50, topMargin=54, bottomMargin=54,
        title=words.of("title"), author="Handover", lang=language,
    )  # fmt: skip

    def number(canvas: Any, page: Any) -> None:
        canvas.saveState()
        canvas.setFont("Helvetica", 8)
        canvas.setFillColor(_QUIET)
        canvas.drawRightString(A4[0] - 56, 32, words.of("page", page=page.page))
        canvas.drawString(56, 32, f"Handover · {study} · {date}")
        canvas.restoreState()

    pages = _Pages(words)
    document.build(pages.flow(analysis, study, date), onFirstPage=number, onLaterPages=number)
    return file.getvalue()


class _Words:
    """The words of the report in one language, and how numbers are written in it."""

    def __init__(self, language: Language) -> None:
        self._all = wording(language)
        self._report = self._all["report"]

    def of(self, name: str, **values: Any) -> str:
        shown = {
            key: value if isinstance(value, str) else self.number(value) for key, value in values.items()
        }
        return str(self._report[name]).format(**shown)

    def columns(self) -> list[str]:
        return list(self._report["columns"])

    def measure(self, measure: str) -> str:
        if measure in TLX_SCALES:
            return str(self._all["tlx"]["scales"][measure]["title"])
        return str(self._report[measure])

    def sources(self) -> list[str]:
        return [f"SUS: {self._all['sus']['source']}.", f"NASA-TLX: {self._all['tlx']['source']}."]

    def number(self, value: float | None, digits: int = 2, *, short: bool = False) -> str:
        if value is None:
            return "–"
        text = str(value) if isinstance(value, int) else f"{value:.{digits}f}"
        text = text.rstrip("0").rstrip(".") if short and "." in text else text
        return text.replace(".", self._report["decimal"]).replace("-", "−")

    def chance(self, p: float | None, *, alone: bool = False) -> str:
        """Return p as "= 0.034" or "< 0.001"; `alone` without the equals sign."""
        if p is None:
            return "–"
        if p < 0.001:
            return f"< 0{self._report['decimal']}001"
        text = f"{p:.3f}".replace(".", self._report["decimal"])
        return text if alone else f"= {text}"


class _Pages:
    """Puts the report together."""

    def __init__(self, words: _Words) -> None:
        from reportlab.lib.styles import ParagraphStyle  # noqa: PLC0415 - heavy, and seldom asked for

        self._words = words
        text = ParagraphStyle(
            "text", fontName="Helvetica", fontSize=9.5, leading=14, textColor=_INK, spaceAfter=6
        )
        self._text = text
        self._quiet = ParagraphStyle("quiet", parent=text, fontSize=8.5, leading=12, textColor=_QUIET)
        self._title = ParagraphStyle("title", parent=text, fontName="Helvetica-Bold", fontSize=17, leading=22)
        self._head = ParagraphStyle(
            "head", parent=text, fontName="Helvetica-Bold", fontSize=12.5, leading=16, spaceBefore=12
        )
        self._cell = ParagraphStyle("cell", parent=text, fontSize=8.5, leading=11, spaceAfter=0)

    def flow(self, analysis: Mapping[str, Any], study: str, date: str) -> list[Any]:
        words = self._words
        counted = {
            name: analysis[name] for name in ("participants", "finished", "personalFirst", "predefinedFirst")
        }
        story = [
            self._said(words.of("title"), self._title),
            self._said(words.of("made", date=date, study=study, **counted)),
        ]
        if analysis["age_years"]["n"]:
            age = {name: analysis["age_years"][name] for name in ("mean", "sd", "n")}
            story.append(self._said(words.of("age", **age)))
        story += [*self._sus(analysis["sus"]), *self._tlx(analysis["tlx"]), *self._preference(analysis)]
        story.append(self._said(words.of("wordingTitle"), self._head))
        return story + [self._said(source, self._quiet) for source in words.sources()]

    def _sus(self, sus: Mapping[str, Any]) -> list[Any]:
        from reportlab.platypus import KeepTogether  # noqa: PLC0415 - heavy, and seldom asked for

        words = self._words
        head = self._said(words.of("susTitle"), self._head)
        if not sus["n"]:
            return [head, self._said(words.of("none"))]
        named = {name: sus[name] for name in ("mean", "sd", "n", "grade")}
        story = [head, sus_chart(sus), self._said(words.of("sus", median=sus["box"]["median"], **named))]
        test, normality = sus["test"], sus["normality"]
        if "p" not in test:
            return [KeepTogether([*story, self._said(words.of("tooFew"))])]
        low, high = test["interval"]
        values = {"average": round(test["average"]), **{name: test[name] for name in ("df", "t", "effect")}}
        story.append(self._said(words.of("susTest", p=words.chance(test["p"]), low=low, high=high, **values)))
        checked = (
            words.of("normality", w=normality["w"], p=words.chance(normality["p"]))
            if "p" in normality
            else ""
        )
        return [KeepTogether([*story, self._said(f"{words.of('susMethod')} {checked}", self._quiet)])]

    def _tlx(self, tlx: Mapping[str, Any]) -> list[Any]:
        from reportlab.platypus import KeepTogether, Spacer  # noqa: PLC0415 - heavy, and seldom asked for

        words = self._words
        head = self._said(words.of("tlxTitle"), self._head)
        if not any(tlx[measure][side]["n"] for measure in MEASURES for side in ("personal", "predefined")):
            return [head, self._said(words.of("none"))]
        names = {measure: words.measure(measure) for measure in MEASURES}
        chart = tlx_chart(tlx, names, (words.of("personal"), words.of("predefined")))
        return [
            KeepTogether([head, chart, self._said(words.of("tlxChart"), self._quiet)]),
            KeepTogether(
                [self._table(tlx, names), Spacer(1, 6), self._said(words.of("tlxMethod"), self._quiet)]
            ),
        ]

    def _table(self, tlx: Mapping[str, Any], names: Mapping[str, str]) -> Any:
        from reportlab.platypus import Table, TableStyle  # noqa: PLC0415 - heavy, and seldom asked for

        words = self._words
        rows = [[self._said(f"<b>{column}</b>", self._cell) for column in words.columns()]]
        for measure, compared in tlx.items():
            test = compared["test"]
            cells = [
                escape(names[measure]),
                self._five(compared["personal"]["box"]),
                self._five(compared["predefined"]["box"]),
                words.number(test.get("u"), 1, short=True),
                words.chance(test.get("p"), alone=True).replace("<", "&lt;"),
                words.number(test.get("effect")),
                words.chance(compared["paired"].get("p"), alone=True).replace("<", "&lt;"),
            ]
            rows.append([self._said(cell, self._cell) for cell in cells])
        table = Table(rows, colWidths=[112, 96, 104, 40, 44, 42, 44], repeatRows=1, hAlign="LEFT")
        table.setStyle(
            TableStyle(
                [
                    ("LINEBELOW", (0, 0), (-1, 0), 0.8, _INK),
                    ("LINEBELOW", (0, 1), (-1, -1), 0.4, _GRID),
                    ("VALIGN", (0, 0), (-1, -1), "MIDDLE"),
                    ("LEFTPADDING", (0, 0), (0, -1), 0),
                    ("TOPPADDING", (0, 0), (-1, -1), 3),
                    ("BOTTOMPADDING", (0, 0), (-1, -1), 3),
                ]
            )
        )
        return table

    def _preference(self, analysis: Mapping[str, Any]) -> Sequence[Any]:
        words, counts = self._words, analysis["preference"]
        head = self._said(words.of("preferenceTitle"), self._head)
        if not any(counts.values()):
            return [head, self._said(words.of("none"))]
        return [head, self._said(words.of("preference", recalibrated=analysis["recalibrated"], **counts))]

    def _five(self, box: Mapping[str, float] | None) -> str:
        if box is None:
            return "–"
        median, q1, q3 = (self._words.number(box[name], 1, short=True) for name in ("median", "q1", "q3"))
        return f"{median} ({q1}–{q3})"

    def _said(self, text: str, style: Any = None) -> Any:
        from reportlab.platypus import Paragraph  # noqa: PLC0415 - heavy, and seldom asked for

        return Paragraph(text, style or self._text)
