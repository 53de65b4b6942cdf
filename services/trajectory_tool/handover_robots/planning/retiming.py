"""The same path in less time: a motion within the limits gets the fastest timing that is found for it.

The motion q(s), with its time as the parameter s, gets the rate b(s) = (ds/dt)^2. By the chain rule:

    velocity = q' b^(1/2)
    acceleration = q'' b + q' b' / 2
    jerk = b^(1/2) (q''' b + 3/2 q'' b' + 1/2 q' b'')

b is a cubic B-spline over s, so acceleration and the square of velocity are linear in its coefficients. The
limit J of the jerk becomes |q''' b + 3/2 q'' b' + 1/2 q' b''| <= J b^(-1/2). Logarithmic barriers keep the
limits at many places. Newton's method minimises duration and barriers, with less and less weight of the
barriers (Boyd and Vandenberghe: Convex Optimization, chapter 11). The set of rates that keep the limit of
jerk is not convex, so the result is a local optimum; the Hessian lacks the term that is not positive.

Between these places a limit of jerk may be exceeded. There it is lowered, and the search continues twice at
most. The result is slowed as a whole as far as the limits still demand, and if it is not shorter than the
motion that was given, that one is returned.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import LinAlgError, solveh_banded

from handover_robots.model.joint_trajectory import Array, JointTrajectory, spline_weights
from handover_robots.model.trajectory import Limits
from handover_robots.planning import timing

INTERVAL_S, QUICK_INTERVAL_S = 0.012, 0.03
"""About the length of the intervals of b; shorter ones give a shorter motion and cost more.

The second one is for joints whose acceleration builds up within an interval: jerk hardly limits them.
"""
MIN_INTERVALS, MAX_INTERVALS = 12, 150
PLACES = 5
"""The places in each interval where the limits hold exactly."""

GAP = 3e-3
"""The end: so close to the optimum (a fraction of the duration) are the barriers."""
FIRST_GAPS, NARROWING = (2.0, 0.03, 0.03), 4.0
"""The gaps at the beginning, for each attempt, and the factor by which they narrow."""
TOLERANCE = 2e-3
"""So little (a fraction of the limit) may be exceeded between the places before another attempt."""
MAX_STEPS = 100
NEAR = 0.98
"""Of the way to the nearest limit, a step covers this fraction at most."""
SHRINK, SUFFICIENT = 0.6, 0.1
"""Backtracking: the factor of the step size, and the fraction of the expected decrease that is sufficient."""
LONG, MIN_SIZE = 0.9, 1e-6
"""After a long step, the barriers get less weight; there is no step below the smallest size."""
MIN_SHARE = 1e-9
SAMPLES = 24
"""The places in each interval between which the time is interpolated."""

ORDERS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""The pairs of derivatives of b in the second derivatives of the barriers."""


def faster(trajectory: JointTrajectory, limits: Limits) -> JointTrajectory:
    """Return a motion within `limits` on the path of `trajectory` that takes no longer."""
    build_up_s = float((np.array(limits.acceleration) / np.array(limits.jerk)).max())
    interval_s = INTERVAL_S if build_up_s > INTERVAL_S else QUICK_INTERVAL_S
    intervals = round(trajectory.duration_s / interval_s)
    rates = _Rates(trajectory, limits, min(max(intervals, MIN_INTERVALS), MAX_INTERVALS))
    best, coefficients = trajectory, np.ones(rates.intervals + 1)
    for gap in FIRST_GAPS:
        coefficients = rates.optimum(coefficients, gap)
        at_s, motion = rates.motion(coefficients)
        best = min(best, motion.within(limits), key=lambda motion: motion.duration_s)
        if not rates.tighten(at_s, motion):
            break
    return best


@dataclass(frozen=True, slots=True)
class _Terms:
    """What the limits bound, as fractions of them: one row a joint, one column a place, by interval.

    All are linear in the coefficients.
    """

    rate: Array
    """b."""
    acceleration: Array
    jerk: Array
    """Likewise, times the slowness b^(-1/2)."""
    velocity: Array
    """The square of the highest velocity of a joint."""

    def after(self, size: float, change: "_Terms") -> "_Terms":
        """Return the terms after a step."""
        return _Terms(
            self.rate + size * change.rate,
            self.acceleration + size * change.acceleration,
            self.jerk + size * change.jerk,
            self.velocity + size * change.velocity,
        )


@dataclass(frozen=True, slots=True)
class _State:
    """Coefficients that keep the limits, and the distances from the limits."""

    coefficients: Array
    terms: _Terms
    slowness: Array
    """b^(-1/2)."""
    acceleration: Array
    """The distances from the upper and from the lower limit."""
    jerk: Array
    """Likewise, times the slowness."""
    velocity: Array
    barriers: float
    """The sum of the barriers."""


class _Rates:
    """The rates of one motion. Its coefficients are those of the splines that reach into its intervals.

    The first derivative of b is 0 at both ends: the coefficient beyond an end equals that on the other side.
    """

    def __init__(self, trajectory: JointTrajectory, limits: Limits, intervals: int) -> None:
        self._trajectory, self._limits, self.intervals = trajectory, limits, intervals
        self._step_s = trajectory.duration_s / intervals
        within = (np.arange(PLACES) + 0.5) / PLACES
        at_s = (np.arange(intervals)[:, None] + within).ravel() * self._step_s
        self._splines = [spline / self._step_s**order for order, spline in enumerate(_splines(within))]
        products = [
            self._splines[first][:, :, None] * self._splines[second][:, None, :] for first, second in ORDERS
        ]
        self._products = (
            np.concatenate([product + product.transpose(0, 2, 1) for product in products]).reshape(-1, 16) / 2
        )
        q1, q2, q3 = (trajectory.derivative(at_s, order).T for order in (1, 2, 3))
        fastest, strongest, jerk = (
            np.array(bounds)[:, None] for bounds in (limits.velocity, limits.acceleration, limits.jerk)
        )
        self._velocity = ((q1 / fastest) ** 2).max(axis=0)
        self._acceleration = q2 / strongest, q1 / strongest / 2
        self._jerk = q3 / jerk, 1.5 * q2 / jerk, q1 / jerk / 2
        self._place_s = self._step_s / PLACES
        self._count = len(at_s) * (4 * len(q1) + 1)

    def optimum(self, coefficients: Array, gap: float) -> Array:
        """Return coefficients close to a local optimum, found from others with a gap at the beginning."""
        state = self._start(coefficients)
        weight = self._count / (gap * self._duration_s(state))
        for _ in range(MAX_STEPS):
            next_state, size = self._newton(state, weight)
            if next_state is None:
                break
            state = next_state
            if size > LONG:
                if self._count < weight * GAP * self._duration_s(state):
                    break
                weight *= NARROWING
        return state.coefficients

    def motion(self, coefficients: Array) -> tuple[Array, JointTrajectory]:
        """Return the motion at a rate, and the times of its points in the motion that was given.

        It keeps the limits at the places, and about between them.
        """
        trajectory = self._trajectory
        halves = np.arange(2 * SAMPLES) / (2 * SAMPLES)
        b = (_windows(coefficients) @ _splines(halves)[0].T).ravel()
        end = _windows(coefficients)[-1] @ _splines(np.ones(1))[0][0]
        slowness = np.append(b, end) ** -0.5
        places = np.linspace(0.0, trajectory.duration_s, self.intervals * SAMPLES + 1)
        steps = (slowness[2::2] + 4 * slowness[1::2] + slowness[:-2:2]) * places[1] / 6  # Simpson's rule
        times = np.concatenate([[0.0], np.cumsum(steps)])
        total_s = float(times[-1])
        count = math.ceil(total_s / max(timing.SPACING_S, total_s / timing.MAX_POINTS))
        place = CubicHermiteSpline(times, places, 1 / slowness[::2])
        at_s = np.clip(place(np.linspace(0.0, total_s, count + 1)), 0.0, trajectory.duration_s)
        points = trajectory.derivative(at_s, 0)
        points[0], points[-1] = trajectory.points[0], trajectory.points[-1]
        return at_s, timing.at_rest_at_ends(points, total_s / count)

    def tighten(self, at_s: Array, trajectory: JointTrajectory) -> bool:
        """Lower the limits at the places near which a motion exceeds them; return whether there are any."""
        jerk = np.abs(np.diff(trajectory.points, 3, axis=0)).T / trajectory.spacing_s**3
        ratios = (jerk / np.array(self._limits.jerk)[:, None]).max(axis=0)
        exceeded = np.flatnonzero(ratios > 1 + TOLERANCE)
        places = np.zeros(self._velocity.shape)
        between = at_s[np.clip(exceeded, 1, len(at_s) - 1) - 1] / self._place_s - 0.5
        for reach in range(-1, 3):
            near = np.clip(np.floor(between).astype(np.int64) + reach, 0, len(places) - 1)
            np.maximum.at(places, near, ratios[exceeded])
        self._jerk = tuple(bound * np.maximum(places, 1.0) for bound in self._jerk)
        return len(exceeded) > 0

    def _duration_s(self, state: _State) -> float:
        return float(state.slowness.sum()) * self._place_s

    def _start(self, coefficients: Array) -> _State:
        """Return the rate, lowered until it keeps the limits; that of the given motion is at their border."""
        while not isinstance(state := _state(coefficients, self._terms(coefficients)), _State):
            coefficients = 0.97 * coefficients
        return state

    def _terms(self, coefficients: Array) -> _Terms:
        windows = _windows(coefficients)
        b, b1, b2 = ((windows @ splines.T).ravel() for splines in self._splines)
        (a0, a1), (j0, j1, j2) = self._acceleration, self._jerk
        return _Terms(b, a0 * b + a1 * b1, j0 * b + j1 * b1 + j2 * b2, self._velocity * b)

    def _newton(self, state: _State, weight: float) -> tuple[_State | None, float]:
        """Return the state after a step and the size of the step; None if no step is better."""
        gradient, bands = self._derivatives(state, weight)
        try:
            step = -solveh_banded(bands, gradient, lower=True, check_finite=False)
        except LinAlgError:
            return None, 0.0
        slope, before = float(gradient @ step), weight * self._duration_s(state) + state.barriers
        change = self._terms(step)
        size = min(1.0, NEAR * _farthest(state, change))
        while size > MIN_SIZE:
            next_state = _state(state.coefficients + size * step, state.terms.after(size, change))
            if isinstance(next_state, _State):
                after = weight * self._duration_s(next_state) + next_state.barriers
                if after <= before + SUFFICIENT * size * slope:
                    return next_state, size
                size *= SHRINK
            else:
                size *= NEAR * _crossing(state, next_state)
        return None, 0.0

    def _derivatives(self, state: _State, weight: float) -> tuple[Array, Array]:
        """Return gradient and Hessian (lower bands) of the weighted duration and the barriers."""
        (a0, a1), (j0, j1, j2) = self._acceleration, self._jerk
        up, down = 1 / state.acceleration
        jerk_up, jerk_down = 1 / state.jerk
        velocity = self._velocity / state.velocity
        slow = state.slowness
        slow1 = -0.5 * slow**3  # its derivative by b
        weight *= self._place_s
        a, a_twice = up - down, up**2 + down**2
        j, j_twice = jerk_up - jerk_down, jerk_up**2 + jerk_down**2
        mixed = (jerk_down**2 - jerk_up**2) * slow1
        first = (
            (a * a0 + j * j0 - slow1 * (jerk_up + jerk_down)).sum(0) + velocity + weight * slow1,
            (a * a1 + j * j1).sum(0),
            (j * j2).sum(0),
        )
        second = (
            (a_twice * a0**2 + j_twice * (j0**2 + slow1**2) + 2 * mixed * j0).sum(0)
            + velocity**2
            + 0.75 * weight * slow**5,
            2 * (a_twice * a0 * a1 + j_twice * j0 * j1 + mixed * j1).sum(0),
            2 * (j_twice * j0 * j2 + mixed * j2).sum(0),
            (a_twice * a1**2 + j_twice * j1**2).sum(0),
            2 * (j_twice * j1 * j2).sum(0),
            (j_twice * j2**2).sum(0),
        )
        by_interval = np.concatenate([rows.reshape(-1, PLACES) for rows in second], axis=1) @ self._products
        gradients = sum(
            rows.reshape(-1, PLACES) @ splines for rows, splines in zip(first, self._splines, strict=True)
        )
        return _assembled(np.asarray(gradients), by_interval.reshape(-1, 4, 4))


def _state(coefficients: Array, terms: _Terms) -> _State | Array:
    """Return the state; if a limit of jerk is exceeded, the distances from these limits."""
    slowness = terms.rate**-0.5
    jerk = np.stack([slowness - terms.jerk, slowness + terms.jerk])
    acceleration = np.stack([1 - terms.acceleration, 1 + terms.acceleration])
    velocity = 1 - terms.velocity
    if min(jerk.min(), acceleration.min(), velocity.min()) <= 0:
        return jerk
    barriers = -float(np.log(jerk).sum() + np.log(acceleration).sum() + np.log(velocity).sum())
    return _State(coefficients, terms, slowness, acceleration, jerk, velocity, barriers)


def _farthest(state: _State, change: _Terms) -> float:
    """Return the size of step that reaches the first limit other than that of jerk."""
    shares = (
        -change.rate / state.terms.rate,
        change.acceleration / state.acceleration[0],
        -change.acceleration / state.acceleration[1],
        change.velocity / state.velocity,
    )
    return 1 / max(*(float(share.max()) for share in shares), MIN_SHARE)


def _crossing(state: _State, jerk: Array) -> float:
    """Return about the fraction of a step at which the first limit of jerk is exceeded.

    The distances are convex in the size of the step, so the true fraction is at most this one.
    """
    exceeded = jerk <= 0
    before = state.jerk[exceeded]
    return float((before / (before - jerk[exceeded])).min())


def _splines(at: Array) -> tuple[Array, Array, Array]:
    """Return the four cubic B-splines of an interval of length 1 at places, and their two derivatives."""
    value, slope, bend = (np.stack(weights, axis=1) for weights in spline_weights(at))
    return value, slope, bend


def _windows(coefficients: Array) -> Array:
    """Return the four coefficients of each interval, one row each."""
    all_of = np.concatenate([coefficients[1:2], coefficients, coefficients[-2:-1]])
    return np.lib.stride_tricks.sliding_window_view(all_of, 4)


_FIRST = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
_LAST = _FIRST[::-1, ::-1]
"""The four coefficients of the interval at an end, from those that are free."""


def _assembled(gradients: Array, hessians: Array) -> tuple[Array, Array]:
    """Return the gradient and the lower bands of the Hessian from those of the intervals."""
    count = len(gradients)
    for end, free in ((0, _FIRST), (-1, _LAST)):
        gradients[end] = gradients[end] @ free
        hessians[end] = free.T @ hessians[end] @ free
    gradient, bands = np.zeros(count + 3), np.zeros((4, count + 3))
    for row in range(4):
        gradient[row : row + count] += gradients[:, row]
        for column in range(row + 1):
            bands[row - column, column : column + count] += hessians[:, row, column]
    bands[0] *= 1 + 1e-9  # against rounding
    return gradient[1:-1], bands[:, 1:-1]
