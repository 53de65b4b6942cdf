"""The picture as SVG: one file that needs nothing else, and that rests for who prefers no motion."""

from collections.abc import Callable, Sequence
from html import escape

from services.gesture_controller.pictures.hand import (
    FingerShape,
    Phalanx,
    Point,
    bends_of,
    box,
    palm,
    palm_lines,
    shape_of,
)
from services.gesture_controller.pictures.motion import WHOLE_S, Hand, Motion, moments

LINE, SKIN, FOLDED, NAIL = "#27324a", "#f2e6da", "#d3b8a0", "#fffaf5"

_STYLE = (
    f".e{{fill:{LINE};stroke:{LINE};stroke-width:6;stroke-linejoin:round}}.s{{fill:{SKIN}}}"
    f".f{{fill:{FOLDED}}}.c{{fill:none;stroke:{LINE};stroke-width:2;stroke-linecap:round;opacity:.5}}"
    f".n{{fill:{NAIL};stroke:{LINE};stroke-width:1.5}}"
)
_REST = (
    ".still{display:none}@media (prefers-reduced-motion:reduce){.still{display:inline}.moving{display:none}}"
)

Part = Callable[[FingerShape], str | None]
"""What is drawn of a finger: the data of a path, or None where it is out of sight."""


def svg_of(name: str, states: str, hand: Hand = "right", motion: Motion = "loop") -> str:
    """Return the picture of the gesture `name` with the five `states`, thumb first."""
    width, height = box()
    mirror = f' transform="translate({width} 0) scale(-1 1)"' if hand == "left" else ""
    still = _drawing([shape_of(bends_of(states))], motion, f"{hand}{states}s")
    if motion == "none":
        style, body = _STYLE, still
    else:
        moving = _drawing([shape_of(moment.bends) for moment in moments(states)], motion, f"{hand}{states}m")
        style, body = _STYLE + _REST, f'<g class="moving">{moving}</g><g class="still">{still}</g>'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" role="img"><title>{escape(name)}</title><style>{style}</style>'
        f"<g{mirror}>{body}</g></svg>"
    )


def _drawing(hands: Sequence[Sequence[FingerShape]], motion: Motion, mark: str) -> str:
    """Return the hand in layers: all outlines first, then all fills, so that no line runs where parts join.

    `hands` are the hands to be gone through in turn; one alone stays as it is. `mark` begins its ids.
    """
    fingers = [_Finger([hand[nth] for hand in hands], motion, f"{mark}{nth}") for nth in range(5)]
    palm_path = _polygon(palm())
    defined = "".join(part for finger in fingers for part in finger.bones.values())
    edges = f'<path class="e" d="{palm_path}"/>' + "".join(finger.layer("e", "0") for finger in fingers)
    lines = "".join(f'<path class="c" d="{_line(line)}"/>' for line in palm_lines())
    thumb, *others = (finger.drawing() for finger in fingers)
    return f'<defs>{defined}</defs>{edges}<path class="s" d="{palm_path}"/>{lines}{"".join(others)}{thumb}'


class _Finger:
    """A finger on its way; each bone is defined once and used for its outline and its fill."""

    def __init__(self, shapes: Sequence[FingerShape], motion: Motion, mark: str) -> None:
        self._shapes, self._motion, self._mark = shapes, motion, mark
        made = {
            f"{folded:d}{nth}": _moving(
                f'id="{mark}{folded:d}{nth}"', shapes, _bone(nth, folded=folded), motion
            )
            for folded in (False, True)
            for nth in range(3)
        }
        self.bones = {which: bone for which, bone in made.items() if bone}

    def layer(self, kind: str, folded: str) -> str:
        """Return its flat ("0") or its folded ("1") bones in the colour of `kind`."""
        return "".join(
            f'<use class="{kind}" href="#{self._mark}{which}"/>' for which in self.bones if which[0] == folded
        )

    def drawing(self) -> str:
        """Return all that lies over the palm."""
        creases = _moving('class="c"', self._shapes, _creases, self._motion)
        nail = _moving('class="n"', self._shapes, _nail, self._motion)
        return self.layer("s", "0") + self.layer("e", "1") + self.layer("f", "1") + creases + nail


def _moving(attributes: str, finger: Sequence[FingerShape], part: Part, motion: Motion) -> str:
    """Return a path that goes through `part` of each of the shapes; nothing if it is never in sight."""
    paths = [part(shape) for shape in finger]
    seen = [path for path in paths if path is not None]
    if not seen:
        return ""
    if len(set(paths)) == 1:
        return f'<path {attributes} d="{seen[0]}"/>'
    seen_when = ["visible" if path else "hidden" for path in paths]
    shown = _animation("visibility", seen_when, motion) if None in paths else ""
    nearest = [path or seen[0 if nth < paths.index(seen[0]) else -1] for nth, path in enumerate(paths)]
    return f'<path {attributes} d="{nearest[-1]}">{_animation("d", nearest, motion)}{shown}</path>'


def _animation(attribute: str, values: Sequence[str], motion: Motion) -> str:
    times = [0.0, *(moment.at_s for moment in moments("00000"))]
    whole_s = times[-1] if motion == "once" else WHOLE_S
    every = [values[0], *values]
    if motion != "once":
        times, every = [*times, whole_s], [*every, values[-1]]
    keys = ";".join(f"{at_s / whole_s:.3f}".rstrip("0").rstrip(".") for at_s in times)
    how = 'fill="freeze"' if motion == "once" else 'repeatCount="indefinite"'
    mode = ' calcMode="discrete"' if attribute == "visibility" else ""
    return (
        f'<animate attributeName="{attribute}" dur="{whole_s:g}s" {how}{mode} keyTimes="{keys}" '
        f'values="{";".join(every)}"/>'
    )


def _bone(nth: int, *, folded: bool) -> Part:
    def part(shape: FingerShape) -> str | None:
        phalanx = shape.phalanges[nth]
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
