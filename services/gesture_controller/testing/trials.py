"""Trials: a gesture is asked for, and what the hand was taken to show is written down.

Each round asks for every gesture once, in an order drawn by lot. Before each, the hand opens. A shape counts
once it has been kept for `hold_ms`: the gesture asked for ends the trial, any other is noted as a problem,
and so is a shape near it that is no gesture at all (the finger that "needed readjustment" in Machines 2022,
10, 957, section 6.1). Between rounds the glove is taken off and put on again. All moments are on the glove's
clock.
"""

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

from services.gesture_controller.hold import Hold, HoldEvent, HoldTiming

OPEN_HAND, FIST = "00000", "22222"
REST_MS = 300
"""The hand rests so long before a gesture is asked for."""

NEAR_FINGERS = 2
"""A shape that is no gesture counts as a try if no more fingers differ from what was asked for."""


class Phase(StrEnum):
    """Where a test stands."""

    BREAK = "break"  # the glove is taken off and put on again; goes on when told
    REST = "rest"  # the hand opens
    ASKED = "asked"  # a gesture is asked for
    NOTED = "noted"  # a trial is over and is being written down
    INTERRUPTED = "interrupted"  # something came between; goes on when told
    STOPPED = "stopped"  # given up; what was done counts
    FINISHED = "finished"

    @property
    def is_over(self) -> bool:
        """Say whether nothing follows."""
        return self in {Phase.STOPPED, Phase.FINISHED}

    @property
    def waits_for_word(self) -> bool:
        """Say whether the test goes on only when it is told to."""
        return self in {Phase.BREAK, Phase.INTERRUPTED}


class Outcome(StrEnum):
    """How a trial ended."""

    RIGHT = "right"  # the first shape that was kept was the gesture asked for
    CORRECTED = "corrected"  # it was, after another
    MISSED = "missed"  # it never was within the time limit


@dataclass(frozen=True, slots=True)
class Plan:
    """What is tested: the codes of the gestures by name, and the order in which each round asks for them."""

    codes: Mapping[str, str]
    order: tuple[tuple[str, ...], ...]
    seed: int
    hold_ms: float = 500
    limit_ms: float = 10_000
    gap_ms: float = 250
    breaks: bool = True
    """Whether the glove is taken off between rounds."""

    @property
    def asked(self) -> tuple[str, ...]:
        """Return the gestures of all trials, one after the other."""
        return tuple(gesture for one_round in self.order for gesture in one_round)

    def round_of(self, trial: int) -> int:
        """Return the round of the trial with that number, both counted from 0."""
        return trial // len(self.codes)


def drawn(codes: Mapping[str, str], rounds: int, seed: int) -> tuple[tuple[str, ...], ...]:
    """Return `rounds` orders of the gestures, each drawn by lot; the same for the same `seed`."""
    lot = random.Random(seed)  # noqa: S311 - an order that can be repeated, no secret
    return tuple(tuple(lot.sample(sorted(codes), len(codes))) for _ in range(rounds))


@dataclass(frozen=True, slots=True)
class Look:
    """What the glove was taken to show at `t_s`: five states, and the gesture if it is one."""

    t_s: float
    states: str
    gesture: str | None


@dataclass(frozen=True, slots=True)
class Try:
    """A shape that was kept long enough, `at_ms` after the gesture was asked for; None: no gesture."""

    gesture: str | None
    states: str
    at_ms: float


@dataclass(frozen=True, slots=True)
class Trial:
    """One gesture that was asked for, and all that was kept until it was right or the time was over."""

    number: int
    round: int
    asked: str
    outcome: Outcome
    tries: tuple[Try, ...]
    repeats: int = 0
    """How often it began anew because the glove fell silent."""

    @property
    def first(self) -> Try | None:
        """Return what was kept first; None if nothing was."""
        return self.tries[0] if self.tries else None

    @property
    def recognized_ms(self) -> float | None:
        """Return how long it took until the right gesture had been kept; None if it never was."""
        return None if self.outcome is Outcome.MISSED else self.tries[-1].at_ms


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a test is: `done` trials, and what the hand has done in the present one."""

    done: int = 0
    phase: Phase = Phase.REST
    since_s: float | None = None
    """Since when the hand rests, or was asked; None until the next look."""
    seen_s: float | None = None
    hold: Hold = field(default_factory=Hold)
    tries: tuple[Try, ...] = ()
    repeats: int = 0
    reason: str = ""
    """Why it was interrupted."""

    def after(self, look: Look, plan: Plan) -> "tuple[Progress, Trial | None]":
        """Return the progress once `look` was seen, and the trial that ended with it if one did."""
        if self.phase not in {Phase.REST, Phase.ASKED}:
            return self, None
        if self.seen_s is not None and not 0 <= (look.t_s - self.seen_s) * 1000 <= plan.gap_ms:
            return self._begun_anew(look), None
        seen = replace(self, seen_s=look.t_s)
        return seen._asked(look, plan) if self.phase is Phase.ASKED else (seen._rested(look, plan), None)

    def noted(self, plan: Plan) -> "Progress":
        """Return the progress once the trial is written down."""
        done = self.done + 1
        if done == len(plan.asked):
            return Progress(done, Phase.FINISHED)
        new_round = plan.round_of(done) > plan.round_of(self.done)
        return Progress(done, Phase.BREAK if new_round and plan.breaks else Phase.REST)

    def gone_on(self) -> "Progress":
        """Return the progress once somebody said to go on; the present trial begins anew."""
        return Progress(self.done) if self.phase.waits_for_word else self

    def interrupted(self, reason: str) -> "Progress":
        """Return the progress once something came between."""
        return self if self.phase.is_over else Progress(self.done, Phase.INTERRUPTED, reason=reason)

    def stopped(self) -> "Progress":
        """Return the progress once the test was given up."""
        return self if self.phase.is_over else Progress(self.done, Phase.STOPPED)

    def _begun_anew(self, look: Look) -> "Progress":
        repeats = self.repeats + (self.phase is Phase.ASKED)
        return Progress(self.done, seen_s=look.t_s, repeats=repeats)

    def _rested(self, look: Look, plan: Plan) -> "Progress":
        asked_code = plan.codes[plan.asked[self.done]]
        rests = look.gesture is None or (look.states == OPEN_HAND != asked_code)
        if not rests:
            return replace(self, since_s=None)
        if self.since_s is None:
            return replace(self, since_s=look.t_s)
        if (look.t_s - self.since_s) * 1000 < REST_MS:
            return self
        return replace(self, phase=Phase.ASKED, since_s=look.t_s, hold=Hold(), tries=())

    def _asked(self, look: Look, plan: Plan) -> "tuple[Progress, Trial | None]":
        asked = plan.asked[self.done]
        timing = HoldTiming(plan.hold_ms, plan.hold_ms + plan.limit_ms, plan.gap_ms)
        hold = self.hold.after(look.gesture or look.states, look.t_s, timing)
        at_ms = round((look.t_s - (self.since_s or 0.0)) * 1000, 3)
        tries = self.tries
        if hold.last is HoldEvent.ANNOUNCED and _is_a_try(look, plan.codes[asked]):
            tries = (*tries, Try(look.gesture, look.states, at_ms))
            if look.gesture == asked:
                outcome = Outcome.RIGHT if len(tries) == 1 else Outcome.CORRECTED
                return self._ended(plan, outcome, tries)
        if at_ms >= plan.limit_ms:
            return self._ended(plan, Outcome.MISSED, tries)
        return replace(self, hold=hold, tries=tries), None

    def _ended(self, plan: Plan, outcome: Outcome, tries: Sequence[Try]) -> "tuple[Progress, Trial]":
        trial = Trial(
            self.done, plan.round_of(self.done), plan.asked[self.done], outcome, tuple(tries), self.repeats
        )
        return Progress(self.done, Phase.NOTED), trial


def _is_a_try(look: Look, code: str) -> bool:
    """Say whether a shape that was kept is a gesture, or was meant to be the one with `code`."""
    if look.gesture is not None:
        return look.states != OPEN_HAND or code == OPEN_HAND
    if look.states in {OPEN_HAND, FIST}:
        return False
    return sum(a != b for a, b in zip(look.states, code, strict=True)) <= NEAR_FINGERS
