"""One training: belt, coach and walker together, step by step. Pure but for its state; the time is given.

The machine of the service and the study on a clock of its own run the same steps.
"""

from collections import deque
from dataclasses import dataclass
from typing import Final

from handover_cases.machines.treadmill.belt import Belt, BeltSettings, BeltState, StopReason
from handover_cases.machines.treadmill.coach import (
    AT_LIMIT_SHARE,
    ZONES,
    Advice,
    Coach,
    Decision,
    Intensity,
    Zone,
)
from handover_cases.machines.treadmill.figures import Figures, Moment, figures_of
from handover_cases.machines.treadmill.simulation import SimulatedWalker
from handover_cases.machines.treadmill.wording import LANGUAGES

DEFAULT_DURATION_S: Final = 600.0
MIN_DURATION_S, MAX_DURATION_S = 30.0, 3600.0
RECORD_EVERY_S: Final = 0.25
MAX_MOMENTS: Final = round(MAX_DURATION_S / RECORD_EVERY_S) + 60


@dataclass(frozen=True, slots=True)
class Plan:
    """What the person chooses. `consents_to_model`: a language model of others may word the advice."""

    duration_s: float = DEFAULT_DURATION_S
    intensity: Intensity = Intensity.LIGHT
    language: str = "en"
    consents_to_model: bool = False

    def __post_init__(self) -> None:
        if not MIN_DURATION_S <= self.duration_s <= MAX_DURATION_S:
            raise ValueError(
                f"the duration is {self.duration_s:g} s; it must be {MIN_DURATION_S:g} to {MAX_DURATION_S:g}"
            )
        if self.language not in LANGUAGES:
            raise ValueError(f'the language is "{self.language}"; there are {", ".join(LANGUAGES)}')

    @property
    def zone(self) -> Zone:
        """Return the heart rates to reach."""
        return ZONES[self.intensity]


class Training:
    """The present session of a walker, or the last one."""

    def __init__(
        self, walker: SimulatedWalker, settings: BeltSettings | None = None, now_s: float = 0.0
    ) -> None:
        self.walker: Final = walker
        self.plan = Plan()
        self.belt = Belt(settings or BeltSettings(), now_s)
        self.began_s: float | None = None
        self.decisions: list[Decision] = []
        self.record: deque[Moment] = deque(maxlen=MAX_MOMENTS)
        self._coach = Coach(self.plan.zone, now_s)

    @property
    def is_running(self) -> bool:
        """Return whether the belt follows the walker."""
        return self.belt.state is BeltState.FOLLOWING

    def start(self, plan: Plan, now_s: float) -> bool:
        """Begin a session; return False while the belt still moves."""
        belt = self.belt.start(now_s)
        if belt is self.belt:
            return False
        self.belt, self.plan, self.began_s = belt, plan, now_s
        self.decisions = []
        self.record.clear()
        self._coach = Coach(plan.zone, now_s)
        return True

    def stop(self, reason: StopReason) -> None:
        """Stop the belt by its ramp."""
        if self.is_running:
            self.belt = self.belt.stop(reason)

    def time_left_s(self, now_s: float) -> float:
        """Return the seconds until the end of the session; 0 without one."""
        if self.began_s is None or not self.is_running:
            return 0.0
        return max(self.plan.duration_s - (now_s - self.began_s), 0.0)

    def step(
        self, now_s: float, seconds: float, heart: tuple[float, float] | None, allowed_mps: float
    ) -> Decision | None:
        """Let `seconds` pass until `now_s`; return the decision of the coach when one is due.

        `heart` is the valid, fresh heart rate in bpm with the time of its measurement, None without one.
        """
        settings = self.belt.settings
        self.walker.step(seconds, self.belt.speed_mps, is_walking=self.is_running)
        self.belt = self.belt.step(self.walker.reading(settings.sensor_to_middle_m), allowed_mps, now_s)
        if heart is not None:
            self._coach = self._coach.take(*heart)
        if self.began_s is None or not self.is_running:
            return None
        elapsed_s = now_s - self.began_s
        self._note(elapsed_s, heart, allowed_mps)
        if elapsed_s >= self.plan.duration_s:
            self.stop(StopReason.TIME)
            return None
        limit_mps = min(allowed_mps, settings.max_speed_mps)
        is_at_limit = self.belt.speed_mps >= AT_LIMIT_SHARE * limit_mps
        self._coach, decision = self._coach.decide(now_s, is_at_limit=is_at_limit)
        if decision is not None:
            self.decisions.append(decision)
        return decision

    def _note(self, elapsed_s: float, heart: tuple[float, float] | None, allowed_mps: float) -> None:
        if self.record and elapsed_s - self.record[-1].at_s < RECORD_EVERY_S - 1e-6:
            return
        limit_mps = min(allowed_mps, self.belt.settings.max_speed_mps)
        bpm = None if heart is None else heart[0]
        place_m, walk_mps = self.walker.place_m, self.walker.walk_mps
        self.record.append(Moment(elapsed_s, self.belt.speed_mps, walk_mps, place_m, limit_mps, bpm))

    def follow(self, advice: Advice) -> None:
        """The walker has been given the words of a decision."""
        self.walker.follow(advice)

    def figures(self) -> Figures:
        """Return the figures of the recorded session. Raises `ValueError` for too short a record."""
        return figures_of(list(self.record), self.decisions, self.plan.zone)
