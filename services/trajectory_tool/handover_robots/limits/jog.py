"""A motion by commanded joint velocities, as in jogging and shared control."""

from collections.abc import Callable

from handover.runtime.control_cycle import runs_in_cycle
from handover_robots.limits.limiter import Limiter
from handover_robots.model.joints import Joints, Velocity
from handover_robots.model.trajectory import Setpoint


class Jog:
    """Joints that follow the latest velocities until `until` returns True, or after a pace of 0, to rest.

    The joints come to rest within their limits. `at` must be called with increasing times.
    """

    def __init__(
        self, start: Joints, velocity: Velocity, until: Callable[[], bool], limiter: Limiter
    ) -> None:
        self.stopping = False
        self._is_ending = False
        self._velocity = velocity
        self._until = until
        self._limiter = limiter
        self._still = (0.0,) * len(start)
        self._setpoint = Setpoint.at_rest(start)

    @runs_in_cycle
    def at(self, now_s: float, *, pace: float = 1.0) -> Setpoint:
        """Return the setpoint of this cycle; a pace of 0 ends the motion."""
        self.stopping = self.stopping or not pace > 0
        self._is_ending = self.stopping or self._is_ending or self._until()
        wanted = self._still
        if not self._is_ending:
            share = min(pace, 1.0)
            wanted = tuple(share * speed for speed in self._velocity())
        self._setpoint = self._limiter.step(wanted, now_s)
        return self._setpoint

    def remaining_s(self, now_s: float) -> float:  # noqa: ARG002
        """Return 0: the end of the motion is not known."""
        return 0.0

    @runs_in_cycle
    def is_over(self, now_s: float) -> bool:  # noqa: ARG002
        """Return whether the joints are at rest after the end of the motion."""
        return self._is_ending and self._setpoint.is_at_rest
