"""The belt of a treadmill follows the walker: its controller, pure, with the time as an argument.

A range sensor at the front panel measures the distance to the walker, some 20 times a second. An observer
(alpha-beta filter with the speed of the belt as known input) finds the place on the belt and the speed of
the walk. The acceleration of the belt is proportional to the place before the middle and to its rate: a
walker who steps ahead makes it faster, one who falls back slower. With both gains the place is a critically
damped second-order system, so the walker comes to rest in the middle and the belt runs as fast as they
walk.

| what | value | why |
|---|---|---|
| gains | 1 /s², 2 /s | critically damped, 1 s |
| acceleration, deceleration, stop | 0.4, 0.5, 0.7 m/s² | a stop from 1.3 m/s takes 1.9 s and 1.2 m of belt |
| highest speed | 1.3 m/s | ROS4HC, section 5.2 |

Invariants, for any order of readings, limits and pauses: 0 <= speed <= max_speed; between two steps the
speed rises by at most `acceleration` and falls by at most `stop_deceleration`; a limit that is lower never
raises the speed; while the belt stops, or without a fresh reading, it does not accelerate; after a stop
only a person starts it. This is no safety function: a treadmill has its own stop, with a cord to the
walker.
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

PAPER_MAX_SPEED_MPS: Final = 1.3
PLACE_GAIN: Final = 1.0
RATE_GAIN: Final = 2.0
ALPHA: Final = 0.4
BETA: Final = 0.1
DEAD_ZONE_M: Final = 0.08
"""A belt at rest ignores a walker so near the middle: who stands sways."""
READING_EVERY_S: Final = 0.05
"""A rate is never computed over less: a step right after a late one would turn noise into a speed."""
MAX_STEP_S: Final = 0.2
"""A longer pause between two steps accelerates no more than this."""
LOST_S: Final = 0.5
"""Without a reading for so long the walker is lost."""
MAX_PAUSE_S: Final = 1.0
"""After a longer pause between two steps the belt stops, whatever is read then: nobody controlled it."""
MAX_WALK_MPS: Final = 3.5
MAX_JUMP_M: Final = 0.5
"""A reading that is further from the expected place is not the walker."""


class BeltState(StrEnum):
    """What the belt does."""

    READY = "ready"
    FOLLOWING = "following"
    STOPPING = "stopping"
    STOPPED = "stopped"


class StopReason(StrEnum):
    """Why it stops."""

    PERSON = "person"
    LOST = "lost"
    FRONT_END = "frontEnd"
    REAR_END = "rearEnd"
    LIMIT = "limit"
    TIME = "time"


@dataclass(frozen=True, slots=True)
class BeltSettings:
    """A belt: m, m/s and m/s². A place is 0 in the middle, and positive ahead of it."""

    max_speed_mps: float = PAPER_MAX_SPEED_MPS
    sensor_to_middle_m: float = 0.9
    front_end_m: float = 0.5
    rear_end_m: float = -0.6
    acceleration: float = 0.4
    deceleration: float = 0.5
    stop_deceleration: float = 0.7

    def __post_init__(self) -> None:
        if not 0 < self.max_speed_mps <= PAPER_MAX_SPEED_MPS:
            raise ValueError(
                f"the highest speed is {self.max_speed_mps:g} m/s; it must be above 0 and at most "
                f"{PAPER_MAX_SPEED_MPS:g}"
            )
        if not self.rear_end_m < -DEAD_ZONE_M < DEAD_ZONE_M < self.front_end_m < self.sensor_to_middle_m:
            raise ValueError(
                "the middle must lie between the rear and the front end, and the front end before the sensor"
            )
        if not 0 < self.acceleration <= self.deceleration <= self.stop_deceleration <= 2.0:
            raise ValueError(
                "acceleration, deceleration and stop must rise in this order, above 0 and up to 2 m/s²"
            )


@dataclass(frozen=True, slots=True)
class Belt:
    """The belt after the last step. `place_m` and `walk_mps` are those of the walker, as estimated."""

    settings: BeltSettings
    at_s: float
    state: BeltState = BeltState.READY
    reason: StopReason | None = None
    speed_mps: float = 0.0
    place_m: float = 0.0
    walk_mps: float = 0.0
    seen_s: float | None = None
    """When the walker was last seen; None: not since the start."""
    distance_m: float = 0.0
    """How far the belt has run since the start."""

    @property
    def is_moving(self) -> bool:
        """Return whether the belt runs or may begin to run."""
        return self.state is BeltState.FOLLOWING or self.speed_mps > 0

    def start(self, now_s: float) -> "Belt":
        """Follow the walker from now on; a person asked for it. A belt that still moves is not started."""
        if self.speed_mps > 0 or self.state is BeltState.FOLLOWING:
            return self
        return Belt(self.settings, max(now_s, self.at_s), BeltState.FOLLOWING)

    def stop(self, reason: StopReason) -> "Belt":
        """Stop by the ramp. The first reason stays."""
        if self.state in {BeltState.STOPPING, BeltState.STOPPED}:
            return self
        return replace(self, state=BeltState.STOPPING, reason=reason)

    def step(self, reading_m: float | None, max_speed_mps: float, now_s: float) -> "Belt":
        """Return the belt at `now_s` (s, monotonic).

        `reading_m` is the distance of the walker to the sensor, None without a new one; `max_speed_mps` is
        what limits allow, and only lowers: a value above the highest speed of the belt, or no number, counts
        as that, or as 0.
        """
        now_s = max(now_s, self.at_s)
        passed_s = now_s - self.at_s
        seen = self._observed(reading_m, now_s, min(passed_s, MAX_STEP_S))
        allowed_mps = (
            0.0 if math.isnan(max_speed_mps) else min(max(max_speed_mps, 0.0), self.settings.max_speed_mps)
        )
        if seen.state is BeltState.FOLLOWING:
            reason = seen._stop_reason(allowed_mps, passed_s)
            seen = seen if reason is None else seen.stop(reason)
        speed_mps = seen._next_speed(allowed_mps, min(passed_s, MAX_STEP_S), is_fresh=seen.seen_s == now_s)
        state = seen.state
        if state is BeltState.STOPPING and speed_mps == 0.0:
            state = BeltState.STOPPED
        run_m = (self.speed_mps + speed_mps) / 2 * passed_s
        return replace(seen, speed_mps=speed_mps, state=state, at_s=now_s, distance_m=self.distance_m + run_m)

    def _observed(self, reading_m: float | None, now_s: float, step_s: float) -> "Belt":
        """Return the belt with the place and the speed of the walker."""
        place_m = self.place_m + (self.walk_mps - self.speed_mps) * step_s
        since_s = self.at_s if self.seen_s is None else self.seen_s
        if reading_m is None or not math.isfinite(reading_m) or reading_m <= 0:
            return replace(self, place_m=place_m, seen_s=self.seen_s)
        found_m = self.settings.sensor_to_middle_m - reading_m
        if self.seen_s is None:
            return replace(self, place_m=found_m, walk_mps=self.speed_mps, seen_s=now_s)
        error_m = found_m - place_m
        if abs(error_m) > MAX_JUMP_M and now_s - since_s < LOST_S:
            return replace(self, place_m=place_m)
        walk_mps = self.walk_mps + BETA * error_m / max(step_s, READING_EVERY_S)
        return replace(
            self,
            place_m=place_m + ALPHA * error_m,
            walk_mps=min(max(walk_mps, -MAX_WALK_MPS), MAX_WALK_MPS),
            seen_s=now_s,
        )

    def _stop_reason(self, allowed_mps: float, passed_s: float) -> StopReason | None:
        if allowed_mps <= 0.0:
            return StopReason.LIMIT
        if self.seen_s is None:
            return None if self.speed_mps == 0.0 else StopReason.LOST
        if passed_s > MAX_PAUSE_S or self.at_s + passed_s - self.seen_s >= LOST_S:
            return StopReason.LOST
        if self.place_m > self.settings.front_end_m:
            return StopReason.FRONT_END
        return StopReason.REAR_END if self.place_m < self.settings.rear_end_m else None

    def _next_speed(self, allowed_mps: float, step_s: float, *, is_fresh: bool) -> float:
        settings = self.settings
        if self.state is not BeltState.FOLLOWING:
            return max(self.speed_mps - settings.stop_deceleration * step_s, 0.0)
        wanted = PLACE_GAIN * self.place_m + RATE_GAIN * (self.walk_mps - self.speed_mps)
        if self.speed_mps == 0.0 and self.place_m < DEAD_ZONE_M:
            wanted = 0.0
        highest = settings.acceleration if is_fresh else 0.0
        change_mps = min(max(wanted, -settings.deceleration), highest) * step_s
        slowest_mps = max(self.speed_mps - settings.deceleration * step_s, 0.0)
        return max(min(self.speed_mps + change_mps, allowed_mps), slowest_mps)
