"""Charts: box plots as vectors, for the report on paper."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from handover_study.model.questionnaires import SUS_AVERAGE

if TYPE_CHECKING:
    from reportlab.graphics.shapes import Drawing

WIDTH_PT = 482.0
LEFT_PT, RIGHT_PT = 118.0, 10.0
PERSONAL, PREDEFINED = "#1d5fd1", "#c26a00"
_INK, _QUIET, _GRID = "#1b2333", "#5a6478", "#d9dde5"
_BANDS = (
    ("F", 0.0, "#f6dcd9"),
    ("D", 51.7, "#fbe9cf"),
    ("C", 62.7, "#fbf4d3"),
    ("B", 72.6, "#e6f2d8"),
    ("A", 78.9, "#d3ecd8"),
)


def sus_chart(sus: Mapping[str, Any]) -> "Drawing":
    """Return the box plot of SUS over the bands of its grades, each score as a dot, the average dashed."""
    from reportlab.graphics import shapes  # noqa: PLC0415 - heavy, and seldom asked for
    from reportlab.lib.colors import HexColor  # noqa: PLC0415 - as above

    height = 116.0
    drawing = shapes.Drawing(WIDTH_PT, height)
    base, top = 24.0, height - 16
    ends = [least for _, least, _ in _BANDS[1:]] + [100.0]
    for (grade, least, colour), most in zip(_BANDS, ends, strict=True):
        drawing.add(
            shapes.Rect(
                _x(least, 0),
                base,
                _x(most, 0) - _x(least, 0),
                top - base,
                fillColor=HexColor(colour),
                strokeColor=None,
            )
        )
        drawing.add(_text((_x(least, 0) + _x(most, 0)) / 2, top + 4, grade, "middle"))
    _axis(drawing, base, top, 0)
    x = _x(SUS_AVERAGE, 0)
    drawing.add(
        shapes.Line(x, base, x, top, strokeColor=HexColor(_INK), strokeDashArray=[3, 2], strokeWidth=1)
    )
    _box(drawing, sus, (base + top) / 2 + 12, height=22, colour=PERSONAL, left=0)
    stacked: dict[float, int] = {}
    for score in sorted(sus["scores"]):
        nth = stacked[score] = stacked.get(score, -1) + 1
        y = base + 7 + min(nth, 5) * 4.2
        drawing.add(
            shapes.Circle(_x(score, 0), y, 1.9, fillColor=HexColor(_INK), strokeColor=None, fillOpacity=0.65)
        )
    return drawing


def tlx_chart(tlx: Mapping[str, Any], names: Mapping[str, str], legend: tuple[str, str]) -> "Drawing":
    """Return the box plots of all measures in `tlx`, called by `names`, personal above predefined."""
    from reportlab.graphics import shapes  # noqa: PLC0415 - heavy, and seldom asked for
    from reportlab.lib.colors import HexColor  # noqa: PLC0415 - as above

    row = 34.0
    base = 24.0
    top = base + row * len(tlx)
    drawing = shapes.Drawing(WIDTH_PT, top + 22)
    _axis(drawing, base, top, LEFT_PT)
    for nth, (measure, compared) in enumerate(tlx.items()):
        middle = top - row * (nth + 0.5)
        if nth:
            drawing.add(
                shapes.Line(
                    0,
                    middle + row / 2,
                    WIDTH_PT - RIGHT_PT,
                    middle + row / 2,
                    strokeColor=HexColor(_GRID),
                    strokeWidth=0.5,
                )
            )
        drawing.add(_text(LEFT_PT - 8, middle - 3, names[measure], "end", size=8.5, colour=_INK))
        _box(drawing, compared["personal"], middle + 7.5, height=10, colour=PERSONAL, left=LEFT_PT)
        _box(drawing, compared["predefined"], middle - 7.5, height=10, colour=PREDEFINED, left=LEFT_PT)
    x = LEFT_PT
    for name, colour in zip(legend, (PERSONAL, PREDEFINED), strict=True):
        drawing.add(shapes.Rect(x, top + 9, 9, 9, fillColor=HexColor(colour), strokeColor=None))
        drawing.add(_text(x + 13, top + 10.5, name, "start", size=8.5, colour=_INK))
        x += 90
    return drawing


def _box(
    drawing: Any, described: Mapping[str, Any], y: float, *, height: float, colour: str, left: float
) -> None:
    from reportlab.graphics import shapes  # noqa: PLC0415 - heavy, and seldom asked for
    from reportlab.lib.colors import HexColor  # noqa: PLC0415 - as above

    box = described["box"]
    if box is None:
        return
    ink = HexColor(colour)
    half = height / 2

    def line(begin: tuple[float, float], other: tuple[float, float], width: float = 1.0) -> None:
        drawing.add(shapes.Line(*begin, *other, strokeColor=ink, strokeWidth=width))

    for end, edge in (("low", "q1"), ("high", "q3")):
        line((_x(box[end], left), y), (_x(box[edge], left), y))
        line((_x(box[end], left), y - half * 0.5), (_x(box[end], left), y + half * 0.5))
    wide = max(_x(box["q3"], left) - _x(box["q1"], left), 0.8)
    drawing.add(
        shapes.Rect(
            _x(box["q1"], left), y - half, wide, height, fillColor=HexColor("#ffffff"), strokeColor=None
        )
    )
    drawing.add(
        shapes.Rect(
            _x(box["q1"], left),
            y - half,
            wide,
            height,
            fillColor=ink,
            fillOpacity=0.22,
            strokeColor=ink,
            strokeWidth=1,
        )
    )
    line((_x(box["median"], left), y - half), (_x(box["median"], left), y + half), 2.2)
    for value in box["outliers"]:
        drawing.add(shapes.Circle(_x(value, left), y, 1.8, fillColor=None, strokeColor=ink, strokeWidth=0.9))
    x, size = _x(described["mean"], left), 3.0
    corners = [x - size, y, x, y + size, x + size, y, x, y - size]
    drawing.add(shapes.Polygon(corners, fillColor=HexColor("#ffffff"), strokeColor=ink, strokeWidth=1))


def _axis(drawing: Any, base: float, top: float, left: float) -> None:
    from reportlab.graphics import shapes  # noqa: PLC0415 - heavy, and seldom asked for
    from reportlab.lib.colors import HexColor  # noqa: PLC0415 - as above

    for value in range(0, 101, 10):
        x = _x(value, left)
        if left:
            drawing.add(shapes.Line(x, base, x, top, strokeColor=HexColor(_GRID), strokeWidth=0.5))
        drawing.add(shapes.Line(x, base - 3, x, base, strokeColor=HexColor(_QUIET), strokeWidth=0.7))
        drawing.add(_text(x, base - 13, str(value), "middle"))
    drawing.add(
        shapes.Line(_x(0, left), base, _x(100, left), base, strokeColor=HexColor(_QUIET), strokeWidth=0.7)
    )


def _x(value: float, left: float) -> float:
    start = left or 10.0
    return start + (WIDTH_PT - RIGHT_PT - start) * value / 100


def _text(x: float, y: float, text: str, anchor: str, *, size: float = 8.0, colour: str = _QUIET) -> Any:
    from reportlab.graphics import shapes  # noqa: PLC0415 - heavy, and seldom asked for
    from reportlab.lib.colors import HexColor  # noqa: PLC0415 - as above

    return shapes.String(
        x, y, text, textAnchor=anchor, fontName="Helvetica", fontSize=size, fillColor=HexColor(colour)
    )
