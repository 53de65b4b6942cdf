"""The state of a session: it runs, pauses for reasons, and ends once; pure, with times from outside.

A reason for a pause goes by itself when its cause does; the session goes on only when a person resumes it, so
that no ball flies at a patient who has just found the headset again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, Literal

from handover.messages import message
from handover_humanoid.sessions.catching import Outcome

Application = Literal["juggling", "walking"]
POINTS = 10


class SessionError(ValueError):
    """The session is not in a state in which this is possible."""


class State(StrEnum):
    """Where a session is."""

    RUNNING = "running"
    PAUSED = "paused"
    ENDED = "ended"


class PauseReason(StrEnum):
    """Why a session is paused."""

    PERSON = "person"
    TRACKING_LOST = "trackingLost"
    OUT_OF_BOUNDS = "outOfBounds"
    SILENT = "silent"
    FORCE = "force"
    LIMIT = "limit"
    STOPPED = "stopped"


CAUSES: Final = {
    PauseReason.TRACKING_LOST: message("humanoid.cause_tracking", "the headset is not tracked"),
    PauseReason.OUT_OF_BOUNDS: message("humanoid.cause_bounds", "the person is not at their place"),
    PauseReason.SILENT: message("humanoid.cause_silent", "the headset sends nothing"),
    PauseReason.FORCE: message("humanoid.cause_force", "a hand is pulled too hard"),
    PauseReason.LIMIT: message("humanoid.cause_limit", "a limit stops the robot"),
    PauseReason.STOPPED: message("humanoid.cause_stopped", "the robot is stopped"),
}
"""What keeps a session from going on, in words."""


class EndReason(StrEnum):
    """Why a session has ended."""

    GOAL = "goal"
    PERSON = "person"
    LIMIT = "limit"
    FAULT = "fault"
    CANCELLED = "cancelled"


@dataclass(frozen=True, slots=True)
class Goal:
    """What ends a session: so many throws, catches, or seconds of exercise; the first one that is reached."""

    throws: int | None = None
    catches: int | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        values = [value for value in (self.throws, self.catches, self.seconds) if value is not None]
        if not values or not all(0 < value < float("inf") for value in values):
            raise ValueError("a goal has throws, catches or seconds, each above 0 and finite")


@dataclass(frozen=True, slots=True)
class SessionThrow:
    """A throw of the session with its outcome: `at_s` since the start, and the difficulty that it had."""

    at_s: float
    level: float
    outcome: Outcome


@dataclass(slots=True)
class Exercise:
    """A session; the time of exercise leaves pauses out."""

    application: Application
    goal: Goal
    started_s: float
    state: State = State.RUNNING
    reasons: set[PauseReason] = field(default_factory=set)
    throws: list[SessionThrow] = field(default_factory=list)
    score: int = 0
    ended_by: EndReason | None = None
    _exercised_s: float = 0.0
    _since_s: float | None = field(init=False)

    def __post_init__(self) -> None:
        self._since_s = self.started_s

    @property
    def caught(self) -> int:
        """Return the number of balls that were caught."""
        return sum(throw.outcome.result == "caught" for throw in self.throws)

    def exercised_s(self, now_s: float) -> float:
        """Return the time of exercise without pauses."""
        return self._exercised_s + (max(now_s - self._since_s, 0.0) if self._since_s is not None else 0.0)

    def pause(self, reason: PauseReason, now_s: float) -> None:
        """Pause, or add a reason to a pause; an ended session stays ended."""
        if self.state is State.ENDED:
            return
        self.reasons.add(reason)
        self._stop_clock(now_s)
        self.state = State.PAUSED

    def clear(self, reason: PauseReason) -> None:
        """Take a reason back: its cause is gone. The session stays paused until a person resumes it."""
        self.reasons.discard(reason)

    def resume(self, now_s: float) -> None:
        """Go on by a person's wish. Raises `SessionError` while a cause of the pause is still there."""
        if self.state is State.ENDED:
            raise SessionError(message("humanoid.session_ended", "the session has ended; start another one"))
        self.reasons.discard(PauseReason.PERSON)
        if self.reasons:
            cause = next(text for reason, text in CAUSES.items() if reason in self.reasons)
            raise SessionError(
                message("humanoid.still_paused", "the session cannot go on yet: {cause}", cause=cause)
            )
        if self.state is State.PAUSED:
            self.state, self._since_s = State.RUNNING, now_s

    def end(self, reason: EndReason, now_s: float) -> None:
        """End; the first reason stays."""
        if self.state is not State.ENDED:
            self._stop_clock(now_s)
            self.state, self.ended_by = State.ENDED, reason
            self.reasons.clear()

    def add(self, outcome: Outcome, level: float, now_s: float) -> int:
        """Count a throw and return its points: those of a difficult catch are up to twice as many.

        A throw that was under way when the session paused or ended counts as well.
        """
        points = round(POINTS * (1.0 + level)) if outcome.result == "caught" else 0
        self.throws.append(SessionThrow(max(now_s - self.started_s, 0.0), level, outcome))
        self.score += points
        self.check(now_s)
        return points

    def check(self, now_s: float) -> None:
        """End the session if its goal is reached."""
        if self.state is not State.ENDED and self.progress(now_s) >= 1.0:
            self.end(EndReason.GOAL, now_s)

    def progress(self, now_s: float) -> float:
        """Return how much of the goal is reached, from 0 to 1."""
        shares: Sequence[float] = [
            done / wanted
            for done, wanted in (
                (len(self.throws), self.goal.throws),
                (self.caught, self.goal.catches),
                (self.exercised_s(now_s), self.goal.seconds),
            )
            if wanted is not None
        ]
        return min(max(shares), 1.0)

    def _stop_clock(self, now_s: float) -> None:
        self._exercised_s = self.exercised_s(now_s)
        self._since_s = None
