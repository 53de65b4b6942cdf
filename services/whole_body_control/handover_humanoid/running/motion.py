"""What people want of the humanoid, as one wish for the control cycle; every rule only lowers.

A person walks it by a dead-man control: without a message for a moment the velocity is 0. The limit of human
state scales velocities by the share that is sent with the wish. A stop keeps the robot on both feet until a
person with the right resets it, also when this service was restarted in between.
"""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from handover.control.dead_man import DeadMan
from handover.control.speed_limits import Allowed
from handover.errors import Problem
from handover_humanoid.behaviours.component_state import Behaviour
from handover_humanoid.metrics import STOPS
from handover_humanoid.patterns.footsteps import Footsteps, Wish
from handover_humanoid.patterns.throwing import PlannedThrow

HOLD_TIMEOUT_S: Final = 0.25
"""Clients send 20 times a second or more."""
MAX_AHEAD_MPS, MAX_LEFT_MPS, MAX_YAW_RADPS = 0.2, 0.1, 0.3
"""What a person may ask for; the pattern generator has limits of its own."""
MAX_REACH_M: Final = 3.0


NAMES: Final = {"walking": 0, "assistedWalking": 1, "juggling": 2}
HANDS: Final = {"left": 0, "right": 1}


@dataclass(frozen=True, slots=True)
class Stopped:
    """Who stopped the robot, why, and when in s since 1970."""

    by: str
    reason: str
    at_s: float


@dataclass(frozen=True, slots=True)
class RequestedThrow:
    """A throw of `hand` to `target` in m, in the frame of the feet: x ahead, y to the left, z up.

    `plan` has the values of the wish that describe the motion, by their names.
    """

    number: int
    target: tuple[float, float, float]
    hand: str
    plan: Mapping[str, float] = field(default_factory=dict)


class Motion:
    """The wish for the control cycle. Not thread-safe.

    `footsteps` says what the robot can step of a wish.
    """

    def __init__(self, footsteps: Footsteps | None = None) -> None:
        self._footsteps = footsteps
        self.behaviour = Behaviour.WALKING
        self.stopped: Stopped | None = None
        self.is_paused = False
        """Whether a session or a Task pauses the motion: the robot stands on both feet meanwhile."""
        self.is_finishing = False
        """Whether a session has ended, and the robot walks by wishes again as soon as it stands."""
        self.throw = RequestedThrow(0, (0.8, 0.0, 0.5), "right")
        self.limit = Allowed("body")
        self._velocity = (0.0, 0.0, 0.0)
        self._dead_man = DeadMan(HOLD_TIMEOUT_S)

    def begin(self, behaviour: Behaviour) -> None:
        """Take a behaviour; after a session that has ended it takes the place of walking by wishes."""
        self.behaviour = behaviour
        if self.is_finishing:
            self.is_paused = self.is_finishing = False

    def walk(self, ahead_mps: float, left_mps: float, yaw_radps: float, *, is_held: bool) -> None:
        """Take a message of the dead-man control; velocities beyond the limits are lowered."""
        self._dead_man.receive(time.monotonic(), is_held=is_held)
        wanted = (ahead_mps, left_mps, yaw_radps)
        self._velocity = (0.0, 0.0, 0.0)
        if all(map(math.isfinite, wanted)):
            self._velocity = (
                _within(ahead_mps, MAX_AHEAD_MPS),
                _within(left_mps, MAX_LEFT_MPS),
                _within(yaw_radps, MAX_YAW_RADPS),
            )

    @property
    def needs_release(self) -> bool:
        """Whether the control is held without effect: it must be released first."""
        return self._dead_man.needs_release(time.monotonic())

    @property
    def velocity(self) -> tuple[float, float, float]:
        """The velocity that is wanted now, before the limit: ahead and left in m/s, yaw in rad/s."""
        is_free = self.stopped is None and not self.is_paused and self.behaviour is Behaviour.WALKING
        return self._velocity if is_free and self._dead_man.permits(time.monotonic()) else (0.0, 0.0, 0.0)

    @property
    def walked(self) -> tuple[float, float, float]:
        """What the robot walks of the wish, as `velocity`: after the limit and within what it can step."""
        share = max(0.0, min(1.0, self.limit.fraction))
        ahead, left, yaw = (share * speed for speed in self.velocity)
        if self._footsteps is None:
            return ahead, left, yaw
        steps = self._footsteps.walked(Wish(np.array([ahead, left]), yaw))
        return float(steps.velocity[0]), float(steps.velocity[1]), steps.yaw_rate

    def why_less(self) -> str:
        """Return why less is walked than is held: the first cause that applies."""
        if self.stopped is not None:
            return "stopped"
        if self.is_paused:
            return "paused"
        if self.behaviour is not Behaviour.WALKING:
            return "behaviour"
        if self.needs_release:
            return "needsRelease"
        return "limit" if self.limit.fraction < 1 else "steps"

    def require_throwing(self, target: Sequence[float]) -> None:
        """Raise `Problem` 409 or 422 unless the robot may throw to a target now."""
        self.require_free()
        if self.behaviour is not Behaviour.JUGGLING:
            raise Problem.translated(
                409,
                "Not juggling",
                "humanoid.not_juggling",
                "the humanoid does not juggle; choose that behaviour first",
            )
        if not all(map(math.isfinite, target)) or math.hypot(*target) > MAX_REACH_M:
            raise Problem.translated(
                422,
                "Out of reach",
                "humanoid.target_far",
                "the target must be finite, and at most {limit} m away",
                limit=f"{MAX_REACH_M:g}",
            )

    def set_throw(self, number: int, target: Sequence[float], hand: str, planned: PlannedThrow) -> None:
        """Throw now, as planned."""
        x, y, z = target
        plan = {"flight_s": planned.flight_s, "swing_s": planned.swing_s, "follow_s": planned.follow_s}
        plan |= {f"release_{index}_rad": float(value) for index, value in enumerate(planned.release)}
        plan |= {f"velocity_{index}_radps": float(value) for index, value in enumerate(planned.velocity)}
        self.throw = RequestedThrow(number, (x, y, z), hand, plan)

    def require_free(self) -> None:
        """Raise `Problem` 409 while a stop or a limit of 0 keeps the robot where it is."""
        if self.stopped is not None:
            raise Problem.translated(
                409,
                "Stopped",
                "humanoid.stopped",
                "{by} stopped the humanoid: {reason}; reset it first",
                by=self.stopped.by,
                reason=self.stopped.reason,
            )
        if self.limit.fraction <= 0:
            raise Problem.translated(
                409,
                "Limited",
                "humanoid.limited",
                "the limit of {rule} lets the humanoid not move: {reason}",
                rule=self.limit.rule,
                reason=str(self.limit.reason),
            )

    def stop(self, by: str, reason: str, cause: str = "person") -> Stopped:
        """Finish the step and stand on both feet until a reset; the first stop stays."""
        self._dead_man.disarm()
        if self.stopped is None:
            self.stopped = Stopped(by, reason, time.time())
            STOPS.labels(cause).inc()
        return self.stopped

    def reset(self) -> None:
        """Release the stop; what is held must be released before it acts again."""
        self.stopped = None
        self._dead_man.disarm()

    def values(self, names: Sequence[str]) -> list[float]:
        """Return the wish as the values `names` of the port."""
        share = max(0.0, min(1.0, self.limit.fraction))
        ahead, left, yaw = self.velocity
        is_stopped = self.stopped is not None or self.is_paused or share <= 0
        by_name = {
            "ahead_mps": ahead,
            "left_mps": left,
            "yaw_radps": yaw,
            "behaviour": float(self.behaviour),
            "throw_number": float(self.throw.number),
            "target_x_m": self.throw.target[0],
            "target_y_m": self.throw.target[1],
            "target_z_m": self.throw.target[2],
            "hand": float(HANDS[self.throw.hand]),
            **self.throw.plan,
            "speed_share": share,
            "stop": float(is_stopped),
            "cancel": float(is_stopped),
        }
        return [by_name.get(name, 0.0) for name in names]


def _within(value: float, most: float) -> float:
    return max(-most, min(most, value))
