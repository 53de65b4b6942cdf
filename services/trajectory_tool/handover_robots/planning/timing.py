"""From a path to a trajectory within velocity, acceleration and jerk.

A straight line in joint space has one dimension: ruckig gives its time-optimal profile under all limits.

Any other path is a curve. toppra computes the fastest motion along it within velocity and acceleration; it
has no limit of jerk. Its motion q(t) is then averaged over a sliding window of time. Averages of values
within limits are within these limits, so velocity and acceleration stay valid; the jerk becomes

    (a(t) - a(t - window)) / window

which a longer window lowers, to the limit at the latest for a window of 2 * acceleration / jerk. The motion
takes longer by the window; `retiming` regains a part. The path is rounded where it turns, by what the robot
moves in one window at most, so the result is checked for collision, not the path. A straight line stays
straight.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import toppra
from ruckig import InputParameter, Result, Ruckig
from ruckig import Trajectory as RuckigProfile
from toppra import algorithm, constraint, interpolator

from handover_robots.model.joint_trajectory import JointTrajectory
from handover_robots.model.trajectory import Limits
from handover_robots.planning.arm import Array

SPACING_S = 0.002
MAX_POINTS = 4000
STEPS_ON_LINE, STEPS_ON_BLEND = 24, 16
"""The steps of toppra along each line and each rounded corner."""

UNLIMITED = 1e3

BLEND_SHARE = 0.45
"""A corner is rounded over this share of the shorter of its lines, at most."""

MIN_LENGTH = 1e-9
MIN_LINE = 1e-6
"""The shortest line of a path in rad or m: far below what a robot resolves."""

toppra.setup_logging("ERROR")


class NoTimingError(ValueError):
    """There is no motion along a path within the limits."""


class Curve(interpolator.AbstractGeometricPath):  # type: ignore[misc]
    """A path with continuous tangents over a parameter from 0 to `length`.

    `grid` has the parameters where the motion is computed, with all at which the curvature jumps.
    """

    grid: Array
    length: float
    columns: int

    @property
    def dof(self) -> int:
        """Return the number of columns."""
        return self.columns

    @property
    def path_interval(self) -> Array:
        """Return the range of the parameter."""
        return np.array([0.0, self.length])

    @property
    def waypoints(self) -> tuple[Array, Array]:
        """Return the points at the grid."""
        return self.grid, self(self.grid)


def distinct(path: Sequence[Array]) -> list[Array]:
    """Return a path without inner points that are where the one before them is, or the last one.

    A line without a length has no direction.
    """
    kept = [path[0]]
    for point in path[1:]:
        if float(np.abs(point - kept[-1]).max()) >= MIN_LINE:
            kept.append(point)
    return [*kept[: max(len(kept) - 1, 1)], path[-1]]


class BlendedLines(Curve):
    """Lines with rounded corners: parabolas that touch both lines. The parameter has the unit s.

    At full speed, the fastest joint of a line needs about its length of time.
    """

    def __init__(self, path: Sequence[Array], limits: Limits, share: float = BLEND_SHARE) -> None:
        speeds = np.array(limits.velocity)
        lengths = [float(np.linalg.norm((b - a) / speeds)) for a, b in pairwise(path)]
        ways = [(b - a) / length for (a, b), length in zip(pairwise(path), lengths, strict=True)]
        radii = [share * min(before, after) for before, after in pairwise(lengths)]
        starts, points, first, second, grid = [], [], [], [], []
        place = 0.0
        for number, (way, length) in enumerate(zip(ways, lengths, strict=True)):
            before = radii[number - 1] if number > 0 else 0.0
            after = radii[number] if number < len(radii) else 0.0
            starts.append(place + before)
            points.append(path[number] + before * way)
            first.append(way)
            second.append(np.zeros_like(way))
            grid.append(np.linspace(place + before, place + length - after, STEPS_ON_LINE, endpoint=False))
            if number < len(radii):
                starts.append(place + length - after)
                points.append(path[number + 1] - after * way)
                first.append(way)
                second.append((ways[number + 1] - way) / (2 * after))
                ends = place + length - after, place + length + after
                grid.append(np.linspace(*ends, STEPS_ON_BLEND, endpoint=False))
            place += length
        self.columns, self.length = len(path[0]), place
        self.grid = np.concatenate([*grid, [place]])
        self._starts = np.array(starts)
        self._pieces = np.array(points), np.array(first), np.array(second)

    def __call__(self, places: Any, order: int = 0) -> Array:
        """Return the points, or their derivatives by the parameter."""
        wanted = np.atleast_1d(np.asarray(places, dtype=np.float64))
        piece = np.searchsorted(self._starts, wanted + 1e-12, side="right") - 1
        since = (wanted - self._starts[piece])[:, None]
        point, first, second = (table[piece] for table in self._pieces)
        values = (point + since * first + since**2 / 2 * second, first + since * second, second)[order]
        if order == 2:  # at the end of a blend, its curvature counts, not that of the line after it
            values = np.where(since < 1e-9, np.where(np.abs(values) > 0, values, self._before(piece)), values)
        return np.asarray(values[0] if np.ndim(places) == 0 else values)

    def _before(self, piece: Any) -> Array:
        return np.asarray(self._pieces[2][np.maximum(piece - 1, 0)])


class Through(Curve):
    """A cubic spline through points at ascending parameters, at rest at both ends."""

    def __init__(self, at: Array, points: Array) -> None:
        self._spline = toppra.SplineInterpolator(at, points)
        self.columns, self.length = int(points.shape[1]), float(at[-1])
        self.grid = np.linspace(0.0, self.length, min(max(2 * len(at), 60), 300))

    def __call__(self, places: Any, order: int = 0) -> Array:
        """Return the points, or their derivatives by the parameter."""
        return np.asarray(self._spline(places, order))


def line(start: Array, end: Array, limits: Limits, spacing_s: float = SPACING_S) -> JointTrajectory:
    """Return the fastest motion from rest to rest on a straight line in joint space."""
    way = end - start
    if float(np.abs(way).max()) < MIN_LENGTH:
        return JointTrajectory(np.repeat(start[None, :], 4, axis=0), spacing_s)
    parameters = InputParameter(1)
    parameters.current_position, parameters.current_velocity, parameters.current_acceleration = (
        [0.0],
        [0.0],
        [0.0],
    )
    parameters.target_position = [1.0]
    moving = np.abs(way) >= MIN_LENGTH
    for name, limit in (
        ("max_velocity", limits.velocity),
        ("max_acceleration", limits.acceleration),
        ("max_jerk", limits.jerk),
    ):
        setattr(parameters, name, [float((np.array(limit)[moving] / np.abs(way[moving])).min())])
    profile = RuckigProfile(1)
    if Ruckig(1).calculate(parameters, profile) not in {Result.Working, Result.Finished}:
        raise NoTimingError("ruckig finds no motion along the line")
    spacing_s = max(spacing_s, profile.duration / MAX_POINTS)
    times = np.arange(math.ceil(profile.duration / spacing_s) + 1) * spacing_s
    share = np.array([profile.at_time(min(time, profile.duration))[0][0] for time in times.tolist()])
    share[-1] = 1.0
    points = start + share[:, None] * way
    return at_rest_at_ends(points, spacing_s).within(limits)


def with_stops(path: Sequence[Array], limits: Limits) -> JointTrajectory:
    """Return the motion on the lines of a path that rests at each corner."""
    parts = [line(start, end, limits) for start, end in pairwise(path)]
    spacing_s = max(part.spacing_s for part in parts)
    points = [parts[0].points, *(part.points[3:] for part in parts[1:])]
    return JointTrajectory(np.concatenate(points), spacing_s)


def along(curve: Curve, limits: Limits, *, extra_velocity: Sequence[float] = ()) -> JointTrajectory:
    """Return a fast motion from rest to rest along a curve, within all limits.

    The curve may have more columns than joints, such as the way of the tool in m: `extra_velocity` are their
    limits. Raises `NoTimingError`.
    """
    positions, spacing_s = fastest(curve, limits, extra_velocity)
    return _smoothed(positions[:, : len(limits.velocity)], spacing_s, limits)


def fastest(curve: Curve, limits: Limits, extra_velocity: Sequence[float] = ()) -> tuple[Array, float]:
    """Return the fastest motion within velocity and acceleration: positions at equal times, and the spacing.

    Raises `NoTimingError`.
    """
    velocity = np.array([*limits.velocity, *extra_velocity])
    acceleration = np.array([*limits.acceleration, *(UNLIMITED for _ in extra_velocity)])
    grid = curve.grid
    constraints = [
        constraint.JointVelocityConstraint(np.column_stack([-velocity, velocity])),
        constraint.JointAccelerationConstraint(
            np.column_stack([-acceleration, acceleration]),
            discretization_scheme=constraint.DiscretizationType.Interpolation,
        ),
    ]
    problem = algorithm.TOPPRA(constraints, curve, gridpoints=grid, solver_wrapper="seidel")
    _, speeds, _ = problem.compute_parameterization(0.0, 0.0)
    if speeds is None or not np.all(np.isfinite(speeds)):
        raise NoTimingError("toppra finds no motion along the path")
    speeds = np.maximum(speeds, 0.0)
    steps = np.diff(grid)
    means = np.maximum((speeds[1:] + speeds[:-1]) / 2, 1e-12)
    ends = np.concatenate([[0.0], np.cumsum(steps / means)])
    duration_s = float(ends[-1])
    spacing_s = max(SPACING_S, duration_s / MAX_POINTS)
    times = np.minimum(np.arange(math.ceil(duration_s / spacing_s) + 1) * spacing_s, duration_s)
    step = np.clip(np.searchsorted(ends, times, side="right") - 1, 0, len(steps) - 1)
    since = times - ends[step]
    gain = (speeds[step + 1] ** 2 - speeds[step] ** 2) / (2 * steps[step])
    places = np.clip(grid[step] + speeds[step] * since + gain * since**2 / 2, 0.0, grid[-1])
    return np.asarray(curve(places)), spacing_s


def _smoothed(positions: Array, spacing_s: float, limits: Limits) -> JointTrajectory:
    """Return the motion averaged over the window that makes it shortest within the limits."""
    longest = 2 * float((np.array(limits.acceleration) / np.array(limits.jerk)).max())
    best: JointTrajectory | None = None
    for share in (0.15, 0.25, 0.35, 0.45, 0.5, 0.55, 0.65, 0.75, 0.85, 1.0):
        window = max(round(share * longest / spacing_s), 1)
        motion = at_rest_at_ends(_averaged(positions, window), spacing_s).within(limits)
        if best is None or motion.duration_s < best.duration_s:
            best = motion
    assert best is not None  # noqa: S101 - the loop runs
    return best


def _averaged(positions: Array, window: int) -> Array:
    padded = np.concatenate(
        [
            np.repeat(positions[:1], window - 1, axis=0),
            positions,
            np.repeat(positions[-1:], window - 1, axis=0),
        ]
    )
    total = np.cumsum(np.concatenate([np.zeros((1, positions.shape[1])), padded - positions[0]]), axis=0)
    averaged = np.asarray((total[window:] - total[:-window]) / window + positions[0])
    averaged[-1] = positions[-1]
    return averaged


def at_rest_at_ends(points: Array, spacing_s: float) -> JointTrajectory:
    """Return the motion with these control points, which starts and ends at rest."""
    ends = np.repeat(points[:1], 2, axis=0), np.repeat(points[-1:], 2, axis=0)
    return JointTrajectory(np.concatenate([ends[0], points, ends[1]]), spacing_s)
