"""Pictures as self-contained SVG; they do not move for viewers who prefer reduced motion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

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

LINE, SKIN, FOLDED, NAIL = "#27324a", "#f2e6da", "#d3b8a0", "#fffaf5"

_STYLE = (
    f".e{{fill:{LINE};stroke:{LINE};stroke-width:6;stroke-linejoin:round}}.s{{fill:{SKIN}}}"
    f".f{{fill:{FOLDED}}}.c{{fill:none;stroke:{LINE};stroke-width:2;stroke-linecap:round;opacity:.5}}"
    f".n{{fill:{NAIL};stroke:{LINE};stroke-width:1.5}}"
    f".a{{fill:none;stroke:{LINE};stroke-width:5;stroke-linecap:round;stroke-linejoin:round}}"
)
_REST = (
    ".still{display:none}@media (prefers-reduced-motion:reduce){.still{display:inline}.moving{display:none}}"
)

BESIDE = 48
"""The distance of two hands beside each other."""
ARROW = "M-18 0H18M6 -12L18 0L6 12"

Size = tuple[int, int]
Drawing = tuple[Size, str]
"""The size of a drawing, and its SVG elements."""
Part = Callable[[FingerShape], str | None]
"""Returns the path data of a part of a finger, or None if it is not visible."""


def svg_of(name: str, poses: Sequence[Pose], motion: Motion = "loop") -> str:
    """Return the picture of the gesture `name`: one hand, or the left and the right one beside each other.

    A sequence moves through its gestures; without motion, all of them are drawn in order.
    """
    resting, still = _beside([_resting(pose) for pose in poses])
    if motion == "none":
        size, style, body = resting, _STYLE, still
    else:
        size, moving = _beside([_moving_hand(pose, motion) for pose in poses])
        style = _STYLE + _REST
        body = f'<g class="moving">{moving}</g><g class="still"{_fitted(resting, size)}>{still}</g>'
    width, height = size
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" role="img"><title>{escape(name)}</title><style>{style}</style>{body}</svg>'
    )


def _beside(drawings: Sequence[Drawing]) -> Drawing:
    """Return drawings of hands beside each other."""
    x, parts = 0, []
    for (width, _), drawing in drawings:
        parts.append(f'<g transform="translate({x} 0)">{drawing}</g>' if x else drawing)
        x += width + BESIDE
    return (x - BESIDE, box()[1]), "".join(parts)


def _fitted(inner: Size, outer: Size) -> str:
    """Return the transform that centres a drawing of the size `inner` in `outer`."""
    if inner == outer:
        return ""
    scale = min(outer[0] / inner[0], outer[1] / inner[1])
    x, y = ((outer[axis] - inner[axis] * scale) / 2 for axis in (0, 1))
    return f' transform="translate({x:g} {y:g}) scale({scale:.4g})"'


def _resting(pose: Pose) -> Drawing:
    """Return a hand without motion; for a sequence, one hand for each gesture with arrows between."""
    way = moments(pose.states[0])
    drawn = [
        _sided(_drawing([shape_of(bends_of(states))], Pace("none", way), f"{pose.mark}s{index}"), pose.hand)
        for index, states in enumerate(pose.states)
    ]
    size, hands = _beside([(box(), drawing) for drawing in drawn])
    step = box()[0] + BESIDE
    y = box()[1] * 0.6
    arrows = "".join(
        f'<path class="a" transform="translate({index * step - BESIDE / 2:g} {y:g})" d="{ARROW}"/>'
        for index in range(1, len(drawn))
    )
    return size, hands + arrows


def _moving_hand(pose: Pose, motion: Motion) -> Drawing:
    way = moments(*pose.states)
    drawing = _drawing([shape_of(moment.bends) for moment in way], Pace(motion, way), f"{pose.mark}m")
    return box(), _sided(drawing, pose.hand)


def _sided(drawing: str, hand: Hand) -> str:
    mirror = f' transform="translate({box()[0]} 0) scale(-1 1)"' if hand == "left" else ""
    return f"<g{mirror}>{drawing}</g>"


@dataclass(frozen=True, slots=True)
class Pace:
    """The timing of an animation."""

    motion: Motion
    way: tuple[Moment, ...]

    def animation(self, attribute: str, values: Sequence[str]) -> str:
        """Return the animation of `attribute` through `values`, one for each moment."""
        once = self.motion == "once"
        lasts_s = self.way[-1].at_s if once else whole_s(self.way)
        times = [0.0, *(moment.at_s for moment in self.way)]
        every = [values[0], *values]
        if not once:
            times, every = [*times, lasts_s], [*every, values[-1]]
        keys = ";".join(f"{at_s / lasts_s:.3f}".rstrip("0").rstrip(".") for at_s in times)
        how = 'fill="freeze"' if once else 'repeatCount="indefinite"'
        mode = ' calcMode="discrete"' if attribute == "visibility" else ""
        return (
            f'<animate attributeName="{attribute}" dur="{lasts_s:g}s" {how}{mode} keyTimes="{keys}" '
            f'values="{";".join(every)}"/>'
        )


def _drawing(hands: Sequence[Sequence[FingerShape]], pace: Pace, mark: str) -> str:
    """Return the hand in layers: all outlines first, then all fills, so that no line crosses a joint.

    `hands` are the shapes of the animation; a single one does not move. `mark` is the prefix of the ids.
    """
    fingers = [_DrawnFinger([hand[index] for hand in hands], pace, f"{mark}{index}") for index in range(5)]
    palm_path = _polygon(palm())
    defined = "".join(part for finger in fingers for part in finger.bones.values())
    edges = f'<path class="e" d="{palm_path}"/>' + "".join(finger.layer("e", "0") for finger in fingers)
    lines = "".join(f'<path class="c" d="{_line(line)}"/>' for line in palm_lines())
    thumb, *others = (finger.drawing() for finger in fingers)
    return f'<defs>{defined}</defs>{edges}<path class="s" d="{palm_path}"/>{lines}{"".join(others)}{thumb}'


class _DrawnFinger:
    """An animated finger; each bone is defined once and used for its outline and its fill."""

    def __init__(self, shapes: Sequence[FingerShape], pace: Pace, mark: str) -> None:
        self._shapes, self._pace, self._mark = shapes, pace, mark
        made = {
            f"{folded:d}{index}": _moving(
                f'id="{mark}{folded:d}{index}"', shapes, _bone(index, folded=folded), pace
            )
            for folded in (False, True)
            for index in range(3)
        }
        self.bones = {which: bone for which, bone in made.items() if bone}

    def layer(self, kind: str, folded: str) -> str:
        """Return its flat ("0") or folded ("1") bones in the style of `kind`."""
        return "".join(
            f'<use class="{kind}" href="#{self._mark}{which}"/>' for which in self.bones if which[0] == folded
        )

    def drawing(self) -> str:
        """Return the parts that lie over the palm."""
        creases = _moving('class="c"', self._shapes, _creases, self._pace)
        nail = _moving('class="n"', self._shapes, _nail, self._pace)
        return self.layer("s", "0") + self.layer("e", "1") + self.layer("f", "1") + creases + nail


def _moving(attributes: str, finger: Sequence[FingerShape], part: Part, pace: Pace) -> str:
    """Return a path animated through `part` of each shape; empty if it is never visible."""
    paths = [part(shape) for shape in finger]
    first = next((path for path in paths if path is not None), None)
    if first is None:
        return ""
    if len(set(paths)) == 1:
        return f'<path {attributes} d="{first}"/>'
    seen_when = ["visible" if path else "hidden" for path in paths]
    shown = pace.animation("visibility", seen_when) if None in paths else ""
    where = [first]  # while it is invisible it keeps its last position
    for path in paths[1:]:
        where.append(path or where[-1])
    return f'<path {attributes} d="{where[-1]}">{pace.animation("d", where)}{shown}</path>'


def _bone(index: int, *, folded: bool) -> Part:
    def part(shape: FingerShape) -> str | None:
        phalanx = shape.phalanges[index]
        return _capsule(phalanx) if phalanx.folded is folded else None

    return part


def _nail(shape: FingerShape) -> str | None:
    return _polygon(shape.nail) if shape.nail else None


def _creases(shape: FingerShape) -> str | None:
    return "".join(_line(crease) for crease in shape.creases) or None


def _capsule(phalanx: Phalanx) -> str:
    """Return a phalanx, round at both ends."""
    (x, y), (end_x, end_y) = phalanx.start, phalanx.end
    dx, dy = end_x - x, end_y - y
    length = (dx * dx + dy * dy) ** 0.5 or 1.0
    nx, ny = -dy / length, dx / length
    a, b = phalanx.start_radius, phalanx.end_radius
    return (
        f"M{_at((x + nx * a, y + ny * a))}A{a:g} {a:g} 0 0 1 {_at((x - nx * a, y - ny * a))}"
        f"L{_at((end_x - nx * b, end_y - ny * b))}A{b:g} {b:g} 0 0 1 {_at((end_x + nx * b, end_y + ny * b))}Z"
    )


def _polygon(points: Sequence[Point]) -> str:
    return f"{_line(points)}Z"


def _line(points: Sequence[Point]) -> str:
    return "M" + "L".join(_at(point) for point in points)


def _at(point: Point) -> str:
    return " ".join(f"{value:.1f}".removesuffix(".0") for value in point)
