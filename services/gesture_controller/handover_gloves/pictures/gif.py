"""Pictures as GIF, for systems without SVG: small, antialiased, on white."""

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

from handover_gloves.pictures.hand import (
    FingerShape,
    Phalanx,
    Point,
    bends_of,
    box,
    palm,
    palm_lines,
    shape_of,
)
from handover_gloves.pictures.motion import Hand, Moment, Motion, Pose, moments, whole_s
from handover_gloves.pictures.svg import FOLDED, LINE, NAIL, SKIN

if TYPE_CHECKING:
    from PIL import Image, ImageDraw

FINER = 4
"""The oversampling factor: each picture is drawn larger and then reduced."""
SHADES = 7
"""The number of steps between two adjacent colours."""

CREASE = "#8d8b8f"
MARGIN = 14
EDGE = 3.0
"""Half the width of the outline."""


def gif_of(poses: Sequence[Pose], motion: Motion = "loop") -> bytes:
    """Return the picture of hands beside each other; takes some tenths of a second for each hand.

    Without motion, a sequence is drawn as one hand for each gesture.
    """
    from PIL import Image  # noqa: PLC0415 - heavy, and seldom asked for

    if motion == "none":
        hands = [_picture(bends_of(states), pose.hand) for pose in poses for states in pose.states]
        pictures, durations_ms = [_beside(hands)], [0]
    else:
        ways = [moments(*pose.states) for pose in poses]
        steps = _steps(ways)
        pictures = [
            _beside([_picture(way[index].bends, pose.hand) for way, pose in zip(ways, poses, strict=True)])
            for index, _ in steps
        ]
        durations_ms = [duration_ms for _, duration_ms in steps]
    palette = _palette()
    first, *others = (picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures)
    file = io.BytesIO()
    moving = {"save_all": True, "append_images": others, "duration": durations_ms} if others else {}
    forever = {"loop": 0} if motion == "loop" else {}
    first.save(file, "GIF", optimize=True, **moving, **forever)
    return file.getvalue()


def _steps(ways: Sequence[Sequence[Moment]]) -> list[tuple[int, int]]:
    """Return the moments that differ from the previous one, with the duration (ms) of each."""
    first, steps = ways[0], list[tuple[int, int]]()
    for index, moment in enumerate(first):
        end_s = first[index + 1].at_s if index + 1 < len(first) else whole_s(first)
        # A GIF counts in hundredths of a second.
        duration_ms = round((end_s - (moment.at_s if index else 0.0)) * 100) * 10
        if steps and all(way[index].bends == way[steps[-1][0]].bends for way in ways):
            steps[-1] = (steps[-1][0], steps[-1][1] + duration_ms)
        else:
            steps.append((index, duration_ms))
    return steps


def _beside(hands: "Sequence[Image.Image]") -> "Image.Image":
    from PIL import Image  # noqa: PLC0415 - heavy, and seldom asked for

    if len(hands) == 1:
        return hands[0]
    width, height = hands[0].size
    both = Image.new("RGB", (width * len(hands), height), "white")
    for index, hand in enumerate(hands):
        both.paste(hand, (index * width, 0))
    return both


def _palette() -> "Image.Image":
    """Return the colours of the drawing, exact white, and the steps between adjacent colours."""
    from PIL import Image, ImageColor  # noqa: PLC0415 - heavy, and seldom asked for

    values: list[int] = []
    for start, other in (
        ("white", LINE),
        (SKIN, LINE),
        (FOLDED, LINE),
        (NAIL, LINE),
        (SKIN, CREASE),
        (FOLDED, CREASE),
    ):
        ends = ImageColor.getrgb(start)[:3], ImageColor.getrgb(other)[:3]
        for step in range(SHADES):
            values += [round(a + (b - a) * step / SHADES) for a, b in zip(*ends, strict=True)]
    values += ImageColor.getrgb(LINE)[:3]
    palette = Image.new("P", (1, 1))
    palette.putpalette(values)
    return palette


def _picture(bends: Sequence[float], hand: Hand) -> "Image.Image":
    from PIL import Image, ImageDraw, ImageOps  # noqa: PLC0415 - heavy, and seldom asked for

    width, height = box()
    size = ((width + 2 * MARGIN) * FINER, (height + MARGIN) * FINER)
    large = Image.new("RGB", size, "white")
    _Pen(ImageDraw.Draw(large)).hand(shape_of(bends))
    if hand == "left":
        large = ImageOps.mirror(large)
    return large.resize((size[0] // FINER, size[1] // FINER), Image.Resampling.LANCZOS)


class _Pen:
    """Draws on the oversampled picture, in units of the box."""

    def __init__(self, draw: "ImageDraw.ImageDraw") -> None:
        self._draw = draw

    def hand(self, shapes: Sequence[FingerShape]) -> None:
        thumb, *others = shapes
        flat = [phalanx for shape in shapes for phalanx in shape.phalanges if not phalanx.folded]
        self._area(palm(), LINE, EDGE)
        for phalanx in flat:
            self._bone(phalanx, LINE, EDGE)
        self._area(palm(), SKIN)
        for line in palm_lines():
            self._line(line, CREASE, 2)
        for shape in (*others, thumb):
            self._finger(shape)

    def _finger(self, shape: FingerShape) -> None:
        folded = [phalanx for phalanx in shape.phalanges if phalanx.folded]
        for phalanx in shape.phalanges:
            if not phalanx.folded:
                self._bone(phalanx, SKIN)
        for colour, wider in ((LINE, EDGE), (FOLDED, 0.0)):
            for phalanx in folded:
                self._bone(phalanx, colour, wider)
        for crease in shape.creases:
            self._line(crease, CREASE, 2)
        if shape.nail is not None:
            self._area(shape.nail, LINE, 0.75)
            self._area(shape.nail, NAIL)

    def _bone(self, phalanx: Phalanx, colour: str, wider: float = 0.0) -> None:
        (x, y), (end_x, end_y) = phalanx.start, phalanx.end
        length = ((end_x - x) ** 2 + (end_y - y) ** 2) ** 0.5 or 1.0
        nx, ny = -(end_y - y) / length, (end_x - x) / length
        a, b = phalanx.start_radius + wider, phalanx.end_radius + wider
        self._disc(phalanx.start, a, colour)
        self._disc(phalanx.end, b, colour)
        sides = [
            (x + nx * a, y + ny * a),
            (x - nx * a, y - ny * a),
            (end_x - nx * b, end_y - ny * b),
            (end_x + nx * b, end_y + ny * b),
        ]
        self._draw.polygon([_place(point) for point in sides], fill=colour)

    def _area(self, points: Sequence[Point], colour: str, wider: float = 0.0) -> None:
        self._draw.polygon([_place(point) for point in points], fill=colour)
        if wider:
            self._line([*points, points[0]], colour, 2 * wider)

    def _line(self, points: Sequence[Point], colour: str, width: float) -> None:
        self._draw.line([_place(p) for p in points], fill=colour, width=round(width * FINER), joint="curve")
        for point in points:
            self._disc(point, width / 2, colour)

    def _disc(self, centre: Point, radius: float, colour: str) -> None:
        self._draw.circle(_place(centre), radius * FINER, fill=colour)


def _place(point: Point) -> Point:
    return (point[0] + MARGIN) * FINER, (point[1] + MARGIN / 2) * FINER
