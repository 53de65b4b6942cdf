"""Convex polytopes that contain a mesh: few where it is convex, more where it is not.

A mesh is cut across where the hulls of both sides have much less volume than the hull of the whole. Each
piece gets a polytope around its hull: the intersection of some of the half spaces of the hull's facets, taken
until no corner is farther than a tolerance beyond the hull. So no point of the mesh is outside of it, and it
has a tenth of the corners of a hull of a fine mesh.

Example: the hull of a turned flange with a radius of 40 mm has 600 corners; 40 half spaces have an
intersection with 76 corners, at most 0.5 mm outside of the hull.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from handover_robots.planning.arm import Array

PADDING_M = 3e-5
"""A polytope is larger by this much, so that rounded corners still contain the mesh."""
DIGITS = 5
TOLERANCE_M = 5e-4
MAX_CORNERS = 160
MIN_THICKNESS_M = 1e-3

MAX_PIECES = 4
"""The pieces of a mesh; pairs of links whose polytopes overlap too often get more."""
CUTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
"""Where a mesh is cut, as shares of its extent."""
WORTH_A_CUT, LEAST_GAIN_M3 = 0.93, 2e-5
"""A cut must leave less than this share of the volume, and save so much: pieces make pairs to check."""
CUT_POINTS = 1500
"""The points of a mesh by which cuts are compared."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A part of a mesh, as n x 3 corners of triangles, and the corners of a polytope that contains it."""

    triangles: Array
    corners: Array

    @classmethod
    def around(cls, triangles: Array) -> "Piece":
        """Return the piece of some triangles."""
        return cls(triangles, enclosing(triangles.reshape(-1, 3)))


def pieces_of(triangles: Array, most: int = MAX_PIECES, least_gain_m3: float = LEAST_GAIN_M3) -> list[Piece]:
    """Return pieces whose polytopes together contain a mesh: cut where that makes them much smaller."""
    pending = [triangles]
    settled: list[Piece] = []
    while pending:
        part = pending.pop(0)
        halves = (
            _halves(part, least_gain_m3=least_gain_m3) if len(pending) + len(settled) + 1 < most else None
        )
        if halves is None:
            settled.append(Piece.around(part))
        else:
            pending += halves
    return settled


def split(piece: Piece) -> list[Piece]:
    """Return the two parts of a piece at its best cut, however little that saves; itself if it has none."""
    halves = _halves(piece.triangles, worth=1.0, least_gain_m3=0.0)
    return [piece] if halves is None else [Piece.around(half) for half in halves]


def surface_points(triangles: Array, count: int) -> Array:
    """Return corners of a mesh and random points on it, evenly distributed; the same ones in each call."""
    corners = np.unique(triangles.reshape(-1, 3), axis=0)
    random = np.random.default_rng(0)
    if len(corners) > count:
        corners = corners[random.choice(len(corners), count, replace=False)]
    sides = triangles[:, 1:] - triangles[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    if not areas.sum() > 0:
        return corners
    chosen = triangles[random.choice(len(triangles), count, p=areas / areas.sum())]
    shares = random.dirichlet((1.0, 1.0, 1.0), count)
    return np.concatenate([corners, (chosen * shares[:, :, None]).sum(axis=1)])


def enclosing(points: Array, tolerance_m: float = TOLERANCE_M, most: int = MAX_CORNERS) -> Array:
    """Return the corners of a polytope that contains all points, with some `most` corners."""
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat
        return _box(points, _principal_axes(points))
    points = points[hull.vertices]
    axes = _principal_axes(points)
    if np.ptp(points @ axes.T, axis=0).min() < MIN_THICKNESS_M:
        return _box(points, axes)
    facets = np.unique(hull.equations.round(9), axis=0)
    inside = points.mean(axis=0)
    if len(points) <= most:
        nearest_m = -float((facets[:, :3] @ inside + facets[:, 3]).max())
        return np.asarray((inside + (1 + PADDING_M / nearest_m) * (points - inside)).round(DIGITS))
    chosen = [_half_space(points, normal) for axis in axes for normal in (axis, -axis)]
    while True:
        corners = HalfspaceIntersection(np.array(chosen), inside).intersections
        corners = np.unique(corners.round(9), axis=0)
        beyond = corners @ facets[:, :3].T + facets[:, 3]
        number, facet = np.unravel_index(int(beyond.argmax()), beyond.shape)
        if beyond[number, facet] <= tolerance_m + PADDING_M or len(corners) >= most:
            break
        chosen.append(_half_space(points, facets[facet, :3]))
    return np.asarray(corners.round(DIGITS))


def _principal_axes(points: Array) -> Array:
    """Return the principal axes of points as rows."""
    axes: Array = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    return axes


def _half_space(points: Array, normal: Array) -> Array:
    """Return the normal and the offset of the plane across `normal` that all points are behind."""
    return np.append(normal, -float((points @ normal).max()) - PADDING_M)


def _box(points: Array, axes: Array) -> Array:
    """Return the corners of a box with given axes, for points that are nearly in a plane."""
    local = points @ axes.T
    low, high = local.min(axis=0) - PADDING_M, local.max(axis=0) + PADDING_M
    thin = np.maximum(MIN_THICKNESS_M - (high - low), 0.0) / 2
    ends = np.array([low - thin, high + thin])
    corners = np.array([[ends[x, 0], ends[y, 1], ends[z, 2]] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    return np.asarray((corners @ axes).round(DIGITS))


def _halves(
    triangles: Array, worth: float = WORTH_A_CUT, least_gain_m3: float = LEAST_GAIN_M3
) -> list[Array] | None:
    """Return both sides of the cut that leaves the least volume; None where it saves too little."""
    points = surface_points(triangles, CUT_POINTS)
    whole_m3 = _volume_m3(points)
    least_m3, best = min(worth * whole_m3, whole_m3 - least_gain_m3), None
    for axis in (*_principal_axes(points), *np.eye(3)):
        heights = points @ axis
        low, high = float(heights.min()), float(heights.max())
        for share in CUTS:
            at = low + share * (high - low)
            volume_m3 = _volume_m3(points[heights >= at]) + _volume_m3(points[heights <= at])
            if volume_m3 < least_m3:
                least_m3, best = volume_m3, (axis, at)
    if best is None:
        return None
    axis, at = best
    sides = [side for side in (_beyond(triangles, axis, at), _beyond(triangles, -axis, -at)) if len(side)]
    return sides if len(sides) == 2 else None


def _volume_m3(points: Array) -> float:
    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):  # flat, or too few
        return 0.0


def _beyond(triangles: Array, axis: Array, at: float) -> Array:
    """Return the triangles where `axis` is above `at`, those on both sides cut there."""
    above = triangles @ axis - at
    count = (above > 0).sum(axis=1)
    kept = [triangles[count == 3]]
    for corners in (1, 2):
        cut, heights = triangles[count == corners], above[count == corners]
        if not len(cut):
            continue
        # Turn each triangle so that the corner that is alone on its side is the first one.
        alone = np.argmax((heights > 0) == (corners == 1), axis=1)
        order = (alone[:, None] + np.arange(3)) % 3
        first, second, third = np.moveaxis(np.take_along_axis(cut, order[..., None], axis=1), 1, 0)
        a, b, c = np.take_along_axis(heights, order, axis=1).T
        to_second = first + (a / (a - b))[:, None] * (second - first)
        to_third = first + (a / (a - c))[:, None] * (third - first)
        if corners == 1:
            kept.append(np.stack([first, to_second, to_third], axis=1))
        else:
            kept.append(np.stack([second, third, to_second], axis=1))
            kept.append(np.stack([third, to_third, to_second], axis=1))
    return np.concatenate(kept)
