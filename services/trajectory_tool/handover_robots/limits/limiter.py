"""The limiter: every setpoint passes it before it is commanded, whatever the source of the motion.

A setpoint is permitted when it can be reached from the one before within the limits. A trajectory that
violates a limit is a fault; the joints then come to rest on the brake motion of the last permitted setpoint.

Commanded velocities (`step`) keep one invariant: from every setpoint that was returned, the brake motion
stays within all limits. A candidate for the next setpoint is taken only if its own brake motion does; else
the next setpoint is the one on the brake motion of the last. By induction, the joints can always come to rest
within the limits. Example: a joint that is jogged towards its end brakes in time to stop there.

A setpoint that `step` has returned passed the guards there; `limit` then compares it with the joint limits.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, Protocol, overload

from ruckig import ControlInterface, InputParameter, Ruckig, RuckigError, Synchronization
from ruckig import Trajectory as RuckigProfile

from handover.messages import text_of
from handover.runtime.control_cycle import runs_in_cycle
from handover_robots.limits.guards import Guard
from handover_robots.model.faults import RobotFault
from handover_robots.model.joints import Joints
from handover_robots.model.trajectory import NOTHING_RAD, Limits, Setpoint

TOLERANCE = 1.01
EPSILON = 1e-6
START_TOLERANCE_RAD = 0.02
"""The first setpoint of a motion is this near to the joints."""
SHARES = (1.0, 0.5, 0.2)
"""The fractions of a commanded velocity that are tried."""
ACCELERATION_SHARES = (1.0, 1 - 1e-9, 1 - 1e-6)
"""Rounding leaves Ruckig without a profile for some states whose acceleration ends exactly at rest; a state
beside them has one that differs by less than `EPSILON`."""
STOP_SAMPLES = 6
"""A way to rest is divided into this many parts for the guards."""

LINE_STEP_RAD = 0.02
"""The distance of the places on a straight line that are checked before the motion, in rad or m."""

Ranges = Sequence[tuple[float | None, float | None]]
"""The lower and the upper limit of each joint; None for a joint without."""


class Limiter(Protocol):
    """Passes or changes what is commanded; used by one thread."""

    def needs_preparation(self) -> bool:
        """Return whether `start` would take long; call it, and `prepare`, while nothing moves."""

    def prepare(self) -> None:
        """Build what `start` needs, such as a model of the surroundings."""

    def start(self, joints: Joints, now_s: float) -> None:
        """Begin a motion at rest at `joints`."""

    def resume(self, setpoint: Setpoint, now_s: float) -> None:
        """Continue from a setpoint that was permitted before, at its time."""

    def require_line(self, start: Joints, target: Joints) -> None:
        """Raise `RobotFault` where a straight line in joint space is not permitted, before anything moves."""

    def limit(self, setpoint: Setpoint, now_s: float) -> Setpoint:
        """Return the setpoint to command. Raises `RobotFault` for one that violates a limit."""

    def step(self, velocity: Joints, now_s: float) -> Setpoint:
        """Return the next setpoint towards joint velocities, within all limits."""

    def brake(self, now_s: float) -> Setpoint:
        """Return the setpoint of the stop from the last permitted setpoint."""


class WayToRest(Sequence[Setpoint]):
    """The brake motion from a setpoint: samples of it, the setpoint first, each computed when it is used.

    `box` has the lowest and the highest position of each joint on the whole way, not of the samples alone.
    """

    def __init__(self, start: Setpoint, profile: Any, jerk: Joints) -> None:
        self._start = start
        self._profile = profile
        self._jerk = jerk
        self._step_s = profile.duration / STOP_SAMPLES
        self._rest: dict[int, Setpoint] = {}

    def __len__(self) -> int:
        """Return the number of samples."""
        return STOP_SAMPLES + 1

    @overload
    def __getitem__(self, number: int) -> Setpoint: ...

    @overload
    def __getitem__(self, number: slice) -> list[Setpoint]: ...

    def __getitem__(self, number: int | slice) -> Setpoint | list[Setpoint]:
        """Return a sample, or several."""
        if isinstance(number, slice):
            return [self[index] for index in range(*number.indices(len(self)))]
        if number < 0:
            number += len(self)
        if number == 0:
            return self._start
        if not 0 < number < len(self):
            raise IndexError(number)
        if number not in self._rest:
            self._rest[number] = _setpoint(self._profile, number * self._step_s)
        return self._rest[number]

    @cached_property
    def box(self) -> tuple[Joints, Joints]:
        """Return the lowest and the highest positions."""
        # Not by Ruckig's `position_extrema`, which are 0 or incomplete for many brake motions.
        # A joint turns round before its rest only if its acceleration, which falls to 0 at the maximum jerk,
        # takes more than its velocity; until then it is never faster than at the start.
        start, lower, upper = self._start, [], []
        for here, there, velocity, acceleration, jerk in zip(
            start.positions,
            self._profile.at_time(self._profile.duration)[0],
            start.velocities,
            start.accelerations,
            self._jerk,
            strict=True,
        ):
            low, high = (here, there) if here < there else (there, here)
            if velocity * acceleration < 0 and acceleration * acceleration > 2 * jerk * abs(velocity):
                strength = abs(acceleration)
                turns_s = (strength - math.sqrt(strength * strength - 2 * jerk * abs(velocity))) / jerk
                turn = here + velocity * turns_s
                low, high = min(low, turn), max(high, turn)
            lower.append(low)
            upper.append(high)
        return tuple(lower), tuple(upper)


class JointLimiter:
    """The limits of position, velocity, acceleration and jerk of each joint, and the rules of guards."""

    def __init__(self, limits: Limits, ranges: Ranges | None = None, guards: Sequence[Guard] = ()) -> None:
        self.limits = limits
        self.guards = guards
        self._limits = list(zip(limits.velocity, limits.acceleration, limits.jerk, strict=True))
        self._ranges = [
            (-math.inf if lower is None else lower, math.inf if upper is None else upper)
            for lower, upper in ranges or [(None, None)] * len(limits.velocity)
        ]
        self._last = Setpoint.at_rest((0.0,) * len(limits.velocity))
        self._last_s = 0.0
        self._is_first = True
        self._stepped: Setpoint | None = None
        """The setpoint that `step` has returned last."""
        self._still = [0.0] * len(limits.velocity)
        self._braking: tuple[Any, float] | None = None
        self._ruckig = Ruckig(len(limits.velocity))
        self._inputs = InputParameter(len(limits.velocity))
        self._inputs.control_interface = ControlInterface.Velocity
        self._inputs.synchronization = Synchronization.No
        self._inputs.max_acceleration = limits.acceleration
        self._inputs.max_jerk = limits.jerk

    def needs_preparation(self) -> bool:
        """Return whether a guard is not prepared for the present surroundings."""
        return any(guard.needs_preparation() for guard in self.guards)

    def prepare(self) -> None:
        """Prepare the guards."""
        for guard in self.guards:
            guard.prepare()

    def start(self, joints: Joints, now_s: float) -> None:
        """Begin a motion at rest at `joints`."""
        self._last, self._last_s = Setpoint.at_rest(joints), now_s
        self._is_first = True
        self._braking = None
        for guard in self.guards:
            guard.start(joints)

    @runs_in_cycle
    def resume(self, setpoint: Setpoint, now_s: float) -> None:
        """Continue from a setpoint that was permitted before, at its time."""
        self.start(setpoint.positions, now_s)
        self._permit(setpoint, now_s)

    def require_line(self, start: Joints, target: Joints) -> None:
        """Ask the guards about the places on a line; it ends what `start` began."""
        ways = [there - here for here, there in zip(start, target, strict=True)]
        count = math.ceil(max(map(abs, ways), default=0.0) / LINE_STEP_RAD) if self.guards else 0
        for number in range(1, count + 1):
            share = number / count
            place = tuple(here + share * way for here, way in zip(start, ways, strict=True))
            self._ask_guards(Setpoint.at_rest(place), None)

    @runs_in_cycle
    def limit(self, setpoint: Setpoint, now_s: float) -> Setpoint:
        """Return the setpoint. Raises `RobotFault` for one that violates a limit."""
        reason = self._violation(setpoint, now_s)
        if setpoint is self._stepped and reason is None:
            for guard in self.guards:
                guard.note(setpoint)
        else:
            self._ask_guards(setpoint, reason)
        self._permit(setpoint, now_s)
        return setpoint

    @runs_in_cycle
    def _ask_guards(self, setpoint: Setpoint, reason: str | None) -> None:
        """Raise `RobotFault` for a reason, or for that of a guard."""
        for guard in self.guards:
            reason = reason or guard.violation(setpoint)
        if reason is not None:
            raise RobotFault.translated(
                "robot.limit_violated", "the motion was stopped by the limiter: {reason}", reason=reason
            )

    @runs_in_cycle
    def step(self, velocity: Joints, now_s: float) -> Setpoint:
        """Return the next setpoint towards joint velocities, within all limits."""
        self._stepped = self._next(velocity, max(now_s - self._last_s, 0.0))
        return self._stepped

    @runs_in_cycle
    def _next(self, velocity: Joints, dt_s: float) -> Setpoint:
        for share in SHARES:
            wanted = [
                min(max(share * speed, -limit), limit)
                for speed, limit in zip(velocity, self.limits.velocity, strict=True)
            ]
            candidate = _setpoint(self._to_velocity(self._last, wanted), dt_s)
            if self._can_stop(candidate):
                return candidate
        return _setpoint(self._to_velocity(self._last), dt_s)

    @runs_in_cycle
    def brake(self, now_s: float) -> Setpoint:
        """Return the setpoint of the stop from the last permitted setpoint."""
        if self._braking is None:
            self._braking = self._to_velocity(self._last), self._last_s
        profile, since_s = self._braking
        self._last, self._last_s = _setpoint(profile, now_s - since_s), now_s
        return self._last

    @runs_in_cycle
    def _permit(self, setpoint: Setpoint, now_s: float) -> None:
        self._last, self._last_s, self._is_first = setpoint, now_s, False

    @runs_in_cycle
    def _violation(self, setpoint: Setpoint, now_s: float) -> str | None:
        """Return which limit a setpoint violates; None for none."""
        last, dt_s = self._last, max(now_s - self._last_s, 0.0) * TOLERANCE
        for number, (
            (lower, upper),
            (fastest, strongest, jerk),
            position,
            velocity,
            acceleration,
            before,
            velocity_before,
            acceleration_before,
        ) in enumerate(
            zip(self._ranges, self._limits, *setpoint.derivatives, *last.derivatives, strict=True)
        ):
            reach = START_TOLERANCE_RAD if self._is_first else fastest * dt_s
            if not (
                abs(velocity) <= fastest * TOLERANCE
                and abs(acceleration) <= strongest * TOLERANCE
                and abs(position - before) <= reach + EPSILON
                and abs(velocity - velocity_before) <= strongest * dt_s + EPSILON
                and abs(acceleration - acceleration_before) <= jerk * dt_s + EPSILON
            ):
                return (
                    f"joint {number + 1} from {before:.4f}, {velocity_before:.3f}, {acceleration_before:.2f} "
                    f"to {position:.4f}, {velocity:.3f}, {acceleration:.2f} (position, velocity, "
                    f"acceleration) in {now_s - self._last_s:.4f} s exceeds {fastest:.3f}, {strongest:.2f}, "
                    f"{jerk:.1f} (velocity, acceleration, jerk)"
                )
            if position < min(lower - EPSILON, before) or position > max(upper + EPSILON, before):
                return f"joint {number + 1} would be at {position:.4f}, outside {lower:.4f} to {upper:.4f}"
        return None

    @runs_in_cycle
    def _can_stop(self, setpoint: Setpoint) -> bool:
        """Return whether the stop from a setpoint is within the limits."""
        for velocity, acceleration, (fastest, _, jerk) in zip(
            setpoint.velocities, setpoint.accelerations, self._limits, strict=True
        ):
            peak = velocity + math.copysign(acceleration * acceleration / (2 * jerk), acceleration)
            if max(abs(velocity), abs(peak)) > fastest * (1 + EPSILON):
                return False
        profile = self._to_velocity(setpoint)
        stop = WayToRest(setpoint, profile, self.limits.jerk)
        for (lower, upper), here, least, most in zip(
            self._ranges, self._last.positions, *stop.box, strict=True
        ):
            if (most > upper and most > here) or (least < lower and least < here):
                return False
        return all(guard.permits_stop(stop) for guard in self.guards)

    @runs_in_cycle
    def _to_velocity(self, start: Setpoint, velocity: Sequence[float] | None = None) -> Any:
        """Return the quickest motion of each joint to a velocity; to rest by default. Raises `RobotFault`."""
        inputs = self._inputs
        inputs.current_position = start.positions
        inputs.current_velocity = start.velocities
        inputs.target_velocity = self._still if velocity is None else velocity
        profile = RuckigProfile(len(start.positions))
        for share in ACCELERATION_SHARES:
            inputs.current_acceleration = (
                start.accelerations
                if share == 1.0
                else [share * acceleration for acceleration in start.accelerations]
            )
            try:
                self._ruckig.calculate(inputs, profile)
            except RuckigError as error:
                failure = error
            else:
                return profile
        raise RobotFault.translated(
            "robot.no_motion_because",
            "there is no motion along {line}: {error}",
            line="a stop",
            error=text_of(failure),
        ) from failure


def _setpoint(profile: Any, since_s: float) -> Setpoint:
    positions, velocities, accelerations = profile.at_time(since_s)
    if since_s >= profile.duration:
        velocities = [value if abs(value) > NOTHING_RAD else 0.0 for value in velocities]
        accelerations = [0.0] * len(positions)
    return Setpoint(tuple(positions), tuple(velocities), tuple(accelerations))
