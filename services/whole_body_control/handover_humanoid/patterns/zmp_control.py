"""Model predictive control of the linear inverted pendulum under bounds of the ZMP.

Decided is the velocity of the ZMP in the next `samples` intervals of `period_s`, as in intrinsically stable
MPC (Scianca et al. 2020). Minimised are, over the horizon,

    velocity_weight |x' - wanted|² + centre_weight |p - centre of the region|² + effort_weight |p'|²

while the ZMP at every sample, and the capture point at the last one, stay `margin_m` inside of their region:
from there the robot can stand still. The ZMP moves straight between samples, so it is inside there too.

Where no motion obeys all bounds (a push), their violations are minimised instead, and `excess_m` is the
largest one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import daqp
import numpy as np

from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.pendulum import Pendulum, PendulumState
from handover_humanoid.patterns.regions import Region

PERIOD_S, SAMPLES = 0.1, 16
MARGIN_M = 0.01
SOLVED, SOFT = 1, 8
RHO_SOFT = 1e-6
TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class Weights:
    """What costs how much; see the module. In s²/m², 1/m² and s²/m².

    With less for the centre the body sways less, but the ZMP is planned near the inner edges of the soles:
    the stabiliser then has no room against a fall towards the other foot, and in walks that also go aside a
    tenth of the measured pressures are less than 1 cm inside.
    """

    velocity: float = 0.1
    centre: float = 3.0
    effort: float = 1e-3


@dataclass(frozen=True, slots=True)
class ZmpPlan:
    """The states at each sample, the present one first, and the velocity of the ZMP in between (samples, 2).

    `excess_m` is by how much the bounds of the ZMP or the last capture point are exceeded at most.
    """

    states: tuple[PendulumState, ...]
    zmp_velocities: Array
    excess_m: float


class Unplannable(ValueError):
    """The state or the regions have no meaning."""


class ZmpControl:
    """Plans the motion of the centre of mass. Not thread-safe."""

    def __init__(
        self,
        pendulum: Pendulum,
        weights: Weights | None = None,
        *,
        period_s: float = PERIOD_S,
        samples: int = SAMPLES,
        margin_m: float = MARGIN_M,
    ) -> None:
        self.pendulum, self.period_s, self.samples, self.margin_m = pendulum, period_s, samples, margin_m
        self._weights = weights or Weights()
        a, b = pendulum.transition(period_s)
        of_state, of_input = np.zeros((samples, 3, 3)), np.zeros((samples, 3, samples))
        power = np.eye(3)
        for k in range(samples):
            # The effect of the first input after k + 1 intervals, shifted for the later ones.
            of_state[k] = a @ power
            effect = power @ b
            for j in range(samples - k):
                of_input[k + j, :, j] = effect
            power = a @ power
        self._of_state, self._of_input = of_state, of_input
        velocity, zmp = of_input[:, 1], of_input[:, 2]
        w = self._weights
        hessian = w.velocity * velocity.T @ velocity + w.centre * zmp.T @ zmp + w.effort * np.eye(samples)
        self._hessian = np.kron(np.eye(2), hessian)

    def plan(self, state: PendulumState, regions: Sequence[Region], wanted: Array) -> ZmpPlan:
        """Return the motion from a state, with the region of each sample and the wanted velocity (2,).

        Raises `Unplannable`.
        """
        start = np.vstack([state.com, state.velocity, state.zmp])
        if len(regions) != self.samples:
            raise Unplannable(f"{len(regions)} regions were given for {self.samples} samples")
        if not (np.isfinite(start).all() and np.isfinite(wanted).all()):
            raise Unplannable("the state or the wanted velocity has values that are not finite")
        drift = self._of_state @ start  # (samples, 3, 2): the motion without input
        gradient = self._gradient(drift, regions, wanted)
        rows, upper = self._bounds(drift, regions)
        lower = np.full(len(upper), -1e30)
        inputs, _, flag, _ = daqp.solve(self._hessian, gradient, rows, upper, lower, primal_tol=TOLERANCE)
        if flag != SOLVED:
            sense = np.full(len(upper), SOFT, dtype=np.int32)
            inputs, _, flag, _ = daqp.solve(
                self._hessian, gradient, rows, upper, lower, sense, rho_soft=RHO_SOFT
            )
            if flag <= 0:
                raise Unplannable(f"the motion could not be planned (daqp: {flag})")
        excess = float(np.maximum(rows @ inputs - upper, 0.0).max(initial=0.0))
        velocities = np.asarray(inputs).reshape(2, self.samples).T
        moved = drift + np.einsum("ksj,ja->ksa", self._of_input, velocities)
        states = (state, *(PendulumState(*values) for values in moved))
        return ZmpPlan(states, velocities, excess if excess > 10 * TOLERANCE else 0.0)

    def _gradient(self, drift: Array, regions: Sequence[Region], wanted: Array) -> Array:
        centres = np.array([region.centre for region in regions])
        of_velocity = self._of_input[:, 1].T @ (drift[:, 1] - wanted)
        of_zmp = self._of_input[:, 2].T @ (drift[:, 2] - centres)
        return np.asarray((self._weights.velocity * of_velocity + self._weights.centre * of_zmp).T.ravel())

    def _bounds(self, drift: Array, regions: Sequence[Region]) -> tuple[Array, Array]:
        """Return the rows for the inputs, x before y, and their upper bounds."""
        rows, upper, end = [], [], 0
        for region, count in _runs(regions):
            samples, end = slice(end, end + count), end + count
            rows.append(_for_both_axes(region.normals, self._of_input[samples, 2]))
            upper.append((region.offsets - self.margin_m - drift[samples, 2] @ region.normals.T).ravel())
        last, to_capture = regions[-1], np.array([1.0, 1.0 / self.pendulum.omega])
        rows.append(_for_both_axes(last.normals, (to_capture @ self._of_input[-1, :2])[None]))
        upper.append(last.offsets - self.margin_m - last.normals @ (to_capture @ drift[-1, :2]))
        return np.ascontiguousarray(np.vstack(rows)), np.concatenate(upper)


def _for_both_axes(normals: Array, effects: Array) -> Array:
    """Return rows (s k, 2 n) for normals (k, 2) and each of the effects (s, n), where each axis has the
    effects of its own inputs.

    It is their Kronecker product; that of numpy takes ten times as long.
    """
    rows = normals[:, :, None] * effects[:, None, None, :]
    return np.asarray(rows.reshape(len(normals) * len(effects), -1))


def _runs(regions: Sequence[Region]) -> Iterator[tuple[Region, int]]:
    """Yield each region that follows another one, and of how many samples it is in a row."""
    start = 0
    for index in range(1, len(regions) + 1):
        if index == len(regions) or regions[index] is not regions[start]:
            yield regions[start], index - start
            start = index
