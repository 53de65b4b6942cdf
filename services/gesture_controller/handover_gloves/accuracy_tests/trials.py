"""Trials: each asks for one gesture and records the gestures that are recognized.

Each round asks for every gesture once, in random order. The hand opens before each trial. A shape counts once
it has been held for `hold_ms`. The gesture asked for ends the trial. Any other gesture is recorded as a
problem, and so is a similar shape that is no gesture (the finger that "needed readjustment" in Machines 2022,
10, 957, section 6.1). Between rounds the glove is taken off and put on again. All moments are on the glove's
clock.
"""

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

from handover_gloves.recognition.hold import Hold, HoldEvent, HoldTiming

OPEN_HAND, FIST = "00000", "22222"
REST_MS = 300
"""How long the hand rests before a gesture is asked for."""

NEAR_FINGERS = 2
"""A shape that is no gesture counts as an attempt if at most this many fingers differ."""


class Phase(StrEnum):
    """The phase of a test."""

    BREAK = "break"  # the glove is taken off and put on again; waits for resume
    REST = "rest"  # the hand opens
    ASKED = "asked"  # a gesture is asked for
    NOTED = "noted"  # a trial has ended and is being stored
    INTERRUPTED = "interrupted"  # waits for resume
    STOPPED = "stopped"  # stopped by a person; its trials count
    FINISHED = "finished"

    @property
    def is_over(self) -> bool:
        """True if nothing follows."""
        return self in {Phase.STOPPED, Phase.FINISHED}

    @property
    def waits_for_resume(self) -> bool:
        """True if the test continues only after `resume`."""
        return self in {Phase.BREAK, Phase.INTERRUPTED}


class Outcome(StrEnum):
    """How a trial ended."""

    RIGHT = "right"  # the first shape that was held is the gesture asked for
    CORRECTED = "corrected"  # it was shown after another shape
    MISSED = "missed"  # it was not shown within the time limit


@dataclass(frozen=True, slots=True)
class Plan:
    """The plan of a test: codes by gesture, and the order of the gestures in each round."""

    codes: Mapping[str, str]
    order: tuple[tuple[str, ...], ...]
    seed: int
    hold_ms: float = 500
    limit_ms: float = 10_000
    gap_ms: float = 250
    breaks: bool = True
    """True if the glove is taken off between rounds."""

    @property
    def asked(self) -> tuple[str, ...]:
        """The gestures of all trials in order."""
        return tuple(gesture for one_round in self.order for gesture in one_round)

    def round_of(self, trial: int) -> int:
        """Return the round of a trial; both count from 0."""
        return trial // len(self.codes)


def draw_order(codes: Mapping[str, str], rounds: int, seed: int) -> tuple[tuple[str, ...], ...]:
    """Return the random order of the gestures in each round; `seed` makes it reproducible."""
    generator = random.Random(seed)  # noqa: S311 - reproducible, no secret
    return tuple(tuple(generator.sample(sorted(codes), len(codes))) for _ in range(rounds))


@dataclass(frozen=True, slots=True)
class Observation:
    """The recognized states at `t_s`, and the gesture if they are one."""

    t_s: float
    states: str
    gesture: str | None


@dataclass(frozen=True, slots=True)
class Attempt:
    """A shape that was held, `at_ms` after the gesture was asked for; `gesture` None: no gesture."""

    gesture: str | None
    states: str
    at_ms: float


@dataclass(frozen=True, slots=True)
class Trial:
    """One gesture that was asked for, and all shapes held until success or timeout."""

    number: int
    round: int
    asked: str
    outcome: Outcome
    tries: tuple[Attempt, ...]
    repeats: int = 0
    """How often it restarted because the glove went silent."""

    @property
    def first(self) -> Attempt | None:
        """The first shape that was held, if any."""
        return self.tries[0] if self.tries else None

    @property
    def recognized_ms(self) -> float | None:
        """The time until the right gesture had been held; None if it was not."""
        return None if self.outcome is Outcome.MISSED else self.tries[-1].at_ms


@dataclass(frozen=True, slots=True)
class Progress:
    """The progress of a test: `done` trials, and the state of the current one."""

    done: int = 0
    phase: Phase = Phase.REST
    since_s: float | None = None
    """When the rest or the request began; None until the next observation."""
    seen_s: float | None = None
    hold: Hold = field(default_factory=Hold)
    tries: tuple[Attempt, ...] = ()
    repeats: int = 0
    reason: str = ""
    """Why it was interrupted."""

    def after(self, observation: Observation, plan: Plan) -> "tuple[Progress, Trial | None]":
        """Return the progress after an observation, and the trial that ended with it, if any."""
        if self.phase not in {Phase.REST, Phase.ASKED}:
            return self, None
        if self.seen_s is not None and not 0 <= (observation.t_s - self.seen_s) * 1000 <= plan.gap_ms:
            return self._restarted(observation), None
        seen = replace(self, seen_s=observation.t_s)
        return (
            seen._asked(observation, plan)
            if self.phase is Phase.ASKED
            else (seen._rested(observation, plan), None)
        )

    def noted(self, plan: Plan) -> "Progress":
        """Return the progress after the trial has been stored."""
        done = self.done + 1
        if done == len(plan.asked):
            return Progress(done, Phase.FINISHED)
        new_round = plan.round_of(done) > plan.round_of(self.done)
        return Progress(done, Phase.BREAK if new_round and plan.breaks else Phase.REST)

    def resumed(self) -> "Progress":
        """Return the progress after a resume; the current trial restarts."""
        return Progress(self.done) if self.phase.waits_for_resume else self

    def interrupted(self, reason: str) -> "Progress":
        """Return the progress after an interruption."""
        return self if self.phase.is_over else Progress(self.done, Phase.INTERRUPTED, reason=reason)

    def stopped(self) -> "Progress":
        """Return the progress after a stop."""
        return self if self.phase.is_over else Progress(self.done, Phase.STOPPED)

    def _restarted(self, observation: Observation) -> "Progress":
        repeats = self.repeats + (self.phase is Phase.ASKED)
        return Progress(self.done, seen_s=observation.t_s, repeats=repeats)

    def _rested(self, observation: Observation, plan: Plan) -> "Progress":
        asked_code = plan.codes[plan.asked[self.done]]
        rests = observation.gesture is None or (observation.states == OPEN_HAND != asked_code)
        if not rests:
            return replace(self, since_s=None)
        if self.since_s is None:
            return replace(self, since_s=observation.t_s)
        if (observation.t_s - self.since_s) * 1000 < REST_MS:
            return self
        return replace(self, phase=Phase.ASKED, since_s=observation.t_s, hold=Hold(), tries=())

    def _asked(self, observation: Observation, plan: Plan) -> "tuple[Progress, Trial | None]":
        gesture = plan.asked[self.done]
        timing = HoldTiming(plan.hold_ms, plan.hold_ms + plan.limit_ms, plan.gap_ms)
        hold = self.hold.after(observation.gesture or observation.states, observation.t_s, timing)
        at_ms = round((observation.t_s - (self.since_s or 0.0)) * 1000, 3)
        tries = self.tries
        if hold.last is HoldEvent.ANNOUNCED and _is_attempt(observation, plan.codes[gesture]):
            tries = (*tries, Attempt(observation.gesture, observation.states, at_ms))
            if observation.gesture == gesture:
                outcome = Outcome.RIGHT if len(tries) == 1 else Outcome.CORRECTED
                return self._ended(plan, outcome, tries)
        if at_ms >= plan.limit_ms:
            return self._ended(plan, Outcome.MISSED, tries)
        return replace(self, hold=hold, tries=tries), None

    def _ended(self, plan: Plan, outcome: Outcome, tries: Sequence[Attempt]) -> "tuple[Progress, Trial]":
        trial = Trial(
            self.done, plan.round_of(self.done), plan.asked[self.done], outcome, tuple(tries), self.repeats
        )
        return Progress(self.done, Phase.NOTED), trial


def _is_attempt(observation: Observation, code: str) -> bool:
    """Return True if a held shape is a gesture, or similar to the one with `code`."""
    if observation.gesture is not None:
        return observation.states != OPEN_HAND or code == OPEN_HAND
    if observation.states in {OPEN_HAND, FIST}:
        return False
    return sum(a != b for a, b in zip(observation.states, code, strict=True)) <= NEAR_FINGERS
