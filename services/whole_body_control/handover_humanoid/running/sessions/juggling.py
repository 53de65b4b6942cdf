"""The throws of a session: the next one when the robot stands, and how each ended, from ball and hands.

A throw that the robot refuses, or does not begin, is asked for again with another target; after
`MAX_REFUSALS` in a row the session ends. So is one that was cancelled, by a pause or since the wish came
late: then the hand keeps the ball. That says nothing of the robot, so the session ends after `MAX_CANCELLED`.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from handover_humanoid.patterns.regions import Side
from handover_humanoid.running.humanoid_control import HumanoidControl
from handover_humanoid.sessions.catching import CatchDetector, CatchRules, HandSample
from handover_humanoid.sessions.difficulty import Difficulty
from handover_humanoid.sessions.exercise import EndReason, Exercise, State

REST_S: Final = 1.5
"""Between the outcome of a throw and the next one; longer with a lower speed limit."""
LEAST_SHARE: Final = 0.1
BEGIN_WITHIN_S: Final = 15.0
"""In the time of the robot, from the plan to the release."""
MAX_REFUSALS: Final = 3
MAX_CANCELLED: Final = 30
STANDING, REFUSED = 0.0, 6.0
HELD, FLYING, LANDED, LOST = 1.0, 2.0, 3.0, 4.0
THROWN: Final = frozenset({FLYING, LANDED, LOST})
"""The codes of `throw_phase` and `ball_phase`."""


class Juggling:
    """The throws of one session; `on_catch` gets the hand that caught."""

    def __init__(self, difficulty: Difficulty, rules: CatchRules, on_catch: Callable[[Side], None]) -> None:
        self._difficulty, self._rules, self._on_catch = difficulty, rules, on_catch
        self._asked: int | None = None
        self._asked_s = 0.0
        self._thrown_level = difficulty.level
        self._detector: CatchDetector | None = None
        self._next_s = 0.0
        self._refusals, self._cancelled = 0, 0
        self.number = 0
        """Of the last throw that this session asked for."""
        self.shown_phase: str | None = None
        """What the live document says of the ball after an outcome, until the next throw."""

    @property
    def level(self) -> float:
        """Return the difficulty, from 0 to 1."""
        return self._difficulty.level

    def tick(self, control: HumanoidControl, exercise: Exercise, now_s: float) -> None:
        """Advance by the newest state; `now_s` is of the clock of the exercise.

        A machine that is very busy may show no state of a flight: then the ball counts from where it lies.
        """
        if not control.links.is_live:
            return
        if self._detector is not None:
            self._follow(control, exercise, now_s)
        elif self._asked is not None:
            self._await_release(control, exercise, now_s)
        elif self._may_throw(control, exercise, now_s):
            self._ask(control)

    def _may_throw(self, control: HumanoidControl, exercise: Exercise, now_s: float) -> bool:
        values = control.links.values
        is_ready = values.get("behaviour") == control.motion.behaviour and control.is_standing
        is_idle = values.get("throw_phase") in {STANDING, REFUSED} and values.get("ball_phase") != FLYING
        is_free = is_idle and not control.throws.is_busy
        may_move = control.motion.stopped is None and control.motion.limit.fraction > 0
        return exercise.state is State.RUNNING and now_s >= self._next_s and is_ready and is_free and may_move

    def _ask(self, control: HumanoidControl) -> None:
        wish = self._difficulty.next_throw()
        self._thrown_level = self._difficulty.level
        self._asked = self.number = control.throws.request(wish.target.tolist(), wish.hand)
        self._asked_s = control.links.values["robot_time_s"]
        self.shown_phase = None

    def _await_release(self, control: HumanoidControl, exercise: Exercise, now_s: float) -> None:
        assert self._asked is not None  # noqa: S101 - the caller has looked
        values = control.links.values
        time_s = values["robot_time_s"]
        is_of_this = values.get("throw_number") == self._asked
        ball, phase = values.get("ball_phase"), values.get("throw_phase")
        is_refused = control.throws.refusal(self._asked) is not None or (is_of_this and phase == REFUSED)
        is_waiting = control.throws.is_pending(self._asked) or exercise.state is not State.RUNNING
        if is_of_this and ball in THROWN:
            self._detector, self._asked = CatchDetector(time_s, self._rules), None
            self._refusals = self._cancelled = 0
        elif is_of_this and ball == HELD and phase == STANDING:
            self._cancelled += 1
            self._ask_again(exercise, now_s)
        elif is_waiting and not is_refused:
            self._asked_s = time_s
        elif is_refused or time_s - self._asked_s > BEGIN_WITHIN_S:
            self._refusals += 1
            self._ask_again(exercise, now_s)

    def _ask_again(self, exercise: Exercise, now_s: float) -> None:
        self._asked = None
        self._next_s = now_s + REST_S
        if self._refusals >= MAX_REFUSALS or self._cancelled >= MAX_CANCELLED:
            exercise.end(EndReason.FAULT, now_s)

    def _follow(self, control: HumanoidControl, exercise: Exercise, now_s: float) -> None:
        assert self._detector is not None  # noqa: S101 - the caller has looked
        values = control.links.values
        ball = np.array([values.get(f"ball.{axis}", np.nan) for axis in "xyz"])
        hands = {
            side: HandSample(np.array(hand.position), hand.grip)
            for side, hand in control.inputs.hands(now_s).items()
        }
        outcome = self._detector.update(values["robot_time_s"], ball, hands)
        if outcome is None:
            return
        self._detector = None
        exercise.add(outcome, self._thrown_level, now_s)
        self._difficulty.learn(outcome.result == "caught")
        self._next_s = now_s + REST_S / max(control.motion.limit.fraction, LEAST_SHARE)
        self.shown_phase = "caught" if outcome.result == "caught" else "missed"
        if outcome.result == "caught" and outcome.side is not None:
            self._on_catch(outcome.side)
