"""From the centre of pressure and the limit of the body to the velocity of a wheelchair. Pure.

    centre of pressure > dead zones > command > smoothing > equation 1 with vmax > acceleration limits

Equation 2 of ROS4HC, vmax(HR), is the limit that human state computes after its checks of faults, with the
curve from 90 to 125 bpm down to 0; this process ages it. It is smoothed here as the command is, and never
rises above the limit itself. Equation 1 scales the translation to vmax. The angular velocity is scaled by the
same factor while the chair moves, so that the curve stays; on the spot it has a limit of its own.

Invariants, for any centres of pressure, limits and gaps: the speed never exceeds the maximum; while it is
above vmax it does not rise, and vmax does not rise during a fault; without a valid centre of pressure it
falls to 0 within the deceleration; with a limit of 0 it falls to 0.

Worked example: a maximum of 1.2 m/s and 107.5 bpm give a limit of 0.5, so vmax is 0.6 m/s. A command of 1.0
m/s and 0.5 rad/s becomes 0.6 m/s and 0.3 rad/s: the same curve of 2 m radius.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

from handover_cases.model.smoothing import AT_REST, Smoothed, within_rate

CALIBRATION_S: Final = 1.5
MAX_SPREAD_MM: Final = 15.0
"""Of the centre of pressure while the person sits upright."""
MIN_MOVING_MPS: Final = 0.05
MAX_DT_S: Final = 0.2


@dataclass(frozen=True, slots=True)
class WheelchairParameters:
    """Limits of the chair, in SI units; lengths of the mat in mm. The paper names none but vmax(HR)."""

    max_speed_mps: float = 1.2
    max_turn_radps: float = 1.0
    max_spot_turn_radps: float = 0.6
    acceleration_mps2: float = 0.6
    deceleration_mps2: float = 0.9
    turn_acceleration_radps2: float = 1.5
    turn_deceleration_radps2: float = 2.5
    dead_zone_mm: float = 6.0
    full_lean_mm: float = 25.0
    command_time_constant_s: float = 0.25
    limit_time_constant_s: float = 0.4


@dataclass(frozen=True, slots=True)
class Centre:
    """A valid centre of pressure in mm: x to the right, y forwards."""

    x_mm: float
    y_mm: float


@dataclass(frozen=True, slots=True)
class Wheelchair:
    """The controller at the time of the last step; `linear` (m/s) and `angular` (rad/s, left) go out."""

    parameters: WheelchairParameters = WheelchairParameters()
    is_enabled: bool = False
    linear: float = 0.0
    angular: float = 0.0
    intent: tuple[float, float] = (0.0, 0.0)
    """The velocities that the posture asks for, before the limit."""
    neutral: Centre | None = None
    """The centre of pressure of the person who sits upright."""
    calibrated_s: float = 0.0
    forward: Smoothed = AT_REST
    turn: Smoothed = AT_REST
    vmax: Smoothed = AT_REST

    def start(self) -> "Wheelchair":
        """Return the controller that measures the upright posture, and then drives."""
        return replace(self, is_enabled=True, neutral=None, calibrated_s=0.0)

    def stop(self) -> "Wheelchair":
        """Return the controller that brings the chair to a stop."""
        return replace(self, is_enabled=False)

    @property
    def is_calibrated(self) -> bool:
        """Whether the upright posture is known."""
        return self.calibrated_s >= CALIBRATION_S

    def step(
        self, centre: Centre | None, fraction: float, dt_s: float, *, may_rise: bool = True
    ) -> "Wheelchair":
        """Return the controller `dt_s` later.

        `centre` is None unless a fresh, valid one is known; `fraction` is the limit of the body, 0 to 1. A
        fraction that is no number counts as 0. vmax rises only while `may_rise`: the heart rate is valid.
        """
        dt_s = min(max(dt_s, 0.0), MAX_DT_S)
        bounds = self.parameters
        limit = min(max(fraction, 0.0), 1.0) if math.isfinite(fraction) else 0.0
        target = bounds.max_speed_mps * limit
        if not may_rise and target >= self.vmax.value:
            vmax = Smoothed(self.vmax.value)
        else:
            vmax = self.vmax.step(target, dt_s, bounds.limit_time_constant_s)
        ready = replace(self, vmax=vmax)
        if centre is None or not self.is_enabled:
            return ready._stopping(dt_s)
        if not self.is_calibrated:
            return ready._calibrating(centre, dt_s)._stopping(dt_s)
        forward, turn = self._intent(centre)
        time_constant_s = bounds.command_time_constant_s
        ready = replace(
            ready,
            intent=(forward, turn),
            forward=self.forward.step(forward, dt_s, time_constant_s),
            turn=self.turn.step(turn, dt_s, time_constant_s),
        )
        return ready._driving(limit, dt_s)

    def _calibrating(self, centre: Centre, dt_s: float) -> "Wheelchair":
        rest = self.neutral
        if rest is None or math.dist((rest.x_mm, rest.y_mm), (centre.x_mm, centre.y_mm)) > MAX_SPREAD_MM:
            return replace(self, neutral=centre, calibrated_s=0.0)
        weight = min(dt_s / CALIBRATION_S, 1.0)
        mean = Centre(
            rest.x_mm + weight * (centre.x_mm - rest.x_mm), rest.y_mm + weight * (centre.y_mm - rest.y_mm)
        )
        return replace(self, neutral=mean, calibrated_s=self.calibrated_s + dt_s)

    def _intent(self, centre: Centre) -> tuple[float, float]:
        """Return the velocities of the posture: forwards in m/s, to the left in rad/s."""
        assert self.neutral is not None  # noqa: S101 - calibrated
        bounds = self.parameters
        forward = self._share(centre.y_mm - self.neutral.y_mm) * bounds.max_speed_mps
        return forward, -self._share(centre.x_mm - self.neutral.x_mm) * bounds.max_turn_radps

    def _share(self, lean_mm: float) -> float:
        bounds = self.parameters
        beyond = max(abs(lean_mm) - bounds.dead_zone_mm, 0.0) / (bounds.full_lean_mm - bounds.dead_zone_mm)
        return math.copysign(min(beyond, 1.0), lean_mm)

    def _driving(self, limit: float, dt_s: float) -> "Wheelchair":
        bounds, forward, turn = self.parameters, self.forward.value, self.turn.value
        scaled = min(max(forward, -self.vmax.value), self.vmax.value)  # equation 1
        linear = within_rate(self.linear, scaled, bounds.acceleration_mps2, bounds.deceleration_mps2, dt_s)
        if abs(forward) > MIN_MOVING_MPS:
            factor = min(abs(linear) / abs(forward), 1.0) if linear * forward > 0 else 0.0
            turn *= factor
        else:
            spot = bounds.max_spot_turn_radps * min(limit, self.vmax.value / bounds.max_speed_mps)
            turn = min(max(turn, -spot), spot)
        angular = within_rate(
            self.angular, turn, bounds.turn_acceleration_radps2, bounds.turn_deceleration_radps2, dt_s
        )
        return replace(self, linear=linear, angular=angular)

    def _stopping(self, dt_s: float) -> "Wheelchair":
        bounds = self.parameters
        return replace(
            self,
            intent=(0.0, 0.0),
            forward=AT_REST,
            turn=AT_REST,
            linear=within_rate(self.linear, 0.0, bounds.acceleration_mps2, bounds.deceleration_mps2, dt_s),
            angular=within_rate(
                self.angular, 0.0, bounds.turn_acceleration_radps2, bounds.turn_deceleration_radps2, dt_s
            ),
        )
