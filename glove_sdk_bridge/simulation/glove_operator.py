"""The simulated operator: a person who reads the screen and shows the gesture that the Task asks for.

The operator reads, thinks, moves, holds the gesture until the Task is completed, and relaxes. Sometimes the
operator shows a wrong gesture or releases too early, sees on the screen that it did not count, and tries
again. The class has no side effects: its inputs are the time and the view, its output is the movement of the
hand.
"""

import random
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Self

from glove_sdk_bridge.frames import FINGERS, is_number
from glove_sdk_bridge.simulation.hand import AT_REST, HALF_BENT, Posture

REACTION_MEDIAN_S, REACTION_SPREAD = 0.95, 0.25
"""Lognormal: two of three reactions to a new Task take 0.74 to 1.22 s, reading included."""
MIN_REACTION_S, MAX_REACTION_S = 0.6, 1.5
MOVEMENT_S = (0.25, 0.5)
NOTICE_S = (0.2, 0.5)
"""The reaction time to an expected change of the screen."""

CARELESSNESS = 0.04
"""The standard deviation of finger positions, as a share of the span."""

CORRECTION = 0.25
MAX_CORRECTION = 0.5
CORRECT_AFTER_S = 0.4
"""A finger that the screen shows with a wrong state is moved further by a share of its span, repeatedly after
this
time, before another gesture counts."""

MAX_HOLDS = 3.0
"""A gesture that has not counted after this multiple of the hold time is released and shown again."""

MAX_STILL_S = 20.0
"""How long a shape is held during a calibration, unless the screen asks for the next one."""

WRONG_FOR = (0.3, 0.42)
SHORT_FOR = (0.3, 0.6)
"""How long wrong and too short gestures are held, as shares of the confirmation time."""

MAX_MISTAKES = 2
"""The largest number of consecutive mistakes."""


@dataclass(frozen=True, slots=True)
class View:
    """The view of a glove: the Task, if there is one, and the recognized finger states."""

    task: str | None = None
    code: str = ""
    states: str = ""
    confirm_s: float = 1.5
    waits: bool = False
    """True if no gesture would count: the work is paused, or the glove is in testing mode."""
    keeps_still: bool = False
    """True during a calibration: the operator makes no mistakes then."""

    @classmethod
    def of(cls, shown: Mapping[str, Any]) -> Self:
        """Return the view from the controller's JSON; missing or invalid values are ignored."""
        hold, states = _mapping(shown.get("hold")), shown.get("states")
        confirm_ms = hold.get("confirmMs")
        asked, code = _asked(shown)
        return cls(
            task=asked if _is_code(code) else None,
            code=code,
            states=states if isinstance(states, str) and _is_code(states) else "",
            confirm_s=confirm_ms / 1000 if is_number(confirm_ms) and confirm_ms > 0 else 1.5,
            waits=bool(shown.get("paused")) or (bool(shown.get("testing")) and not _is_tried(shown)),
            keeps_still=_is_guided(shown),
        )


@dataclass(frozen=True, slots=True)
class Movement:
    """The target of the fingers, and the duration."""

    to: Posture
    duration_s: float


class Stage(Enum):
    """The stage of an attempt."""

    AT_REST = "at rest"
    ABOUT_TO = "about to show"
    SHOWING = "showing"
    LETTING_GO = "letting go"


class Attempt(Enum):
    """The kind of an attempt."""

    RIGHT = "right"
    WRONG = "wrong"
    TOO_SHORT = "too short"


@dataclass(slots=True)
class SimulatedOperator:
    """A person; `mistakes` is the share of wrong attempts, `speed` the factor of reactions and movements.

    The controller determines how long a gesture must be held, at any speed.
    """

    seed: int | None = None
    mistakes: float = 0.15
    speed: float = 1.0
    stage: Stage = Stage.AT_REST
    attempt: Attempt = Attempt.RIGHT
    _chance: random.Random = field(init=False)
    _task: str | None = None
    _due_s: float = 0.0
    _corrected_s: float = 0.0
    _made: int = 0
    _effort: list[float] = field(default_factory=lambda: [0.0] * len(FINGERS))

    def __post_init__(self) -> None:
        self._chance = random.Random(self.seed)  # noqa: S311 - a simulation, no secret

    def look(self, view: View, at_s: float) -> Movement | None:
        """Return the movement for `view`, or None if the hand continues as before."""
        wanted = None if view.waits else view.task
        if wanted != self._task:
            self._notice(wanted, at_s)
        if at_s < self._due_s:
            return self._correct(view, at_s) if self.stage is Stage.SHOWING else None
        if self.stage is Stage.LETTING_GO:
            return self._relax(at_s)
        if self.stage is Stage.ABOUT_TO:
            return self._show(view, at_s)
        if self.stage is Stage.SHOWING:
            return self._relax(at_s)
        return None

    def _notice(self, wanted: str | None, at_s: float) -> None:
        """React to another Task, or none: a shown gesture is released first."""
        self._task, self._made = wanted, 0
        if self.stage is Stage.SHOWING:
            self.stage, self._due_s = Stage.LETTING_GO, at_s + self._takes(*NOTICE_S)
        elif self.stage is not Stage.LETTING_GO:
            self._think(at_s)

    def _think(self, at_s: float) -> None:
        self.stage = Stage.AT_REST if self._task is None else Stage.ABOUT_TO
        self._due_s = at_s + self._reaction_s()

    def _relax(self, at_s: float) -> Movement:
        duration_s = self._takes(*MOVEMENT_S)
        self._think(at_s + duration_s)
        return Movement(AT_REST, duration_s)

    def _show(self, view: View, at_s: float) -> Movement:
        self.stage, self.attempt = Stage.SHOWING, Attempt.RIGHT if view.keeps_still else self._choose()
        self._effort = [self._chance.gauss(0, CARELESSNESS) for _ in FINGERS]
        duration_s = self._takes(*MOVEMENT_S)
        code, hold_s = view.code, MAX_STILL_S if view.keeps_still else MAX_HOLDS * view.confirm_s
        if self.attempt is Attempt.WRONG:
            code, hold_s = self._mistaken(code), self._chance.uniform(*WRONG_FOR) * view.confirm_s
        elif self.attempt is Attempt.TOO_SHORT:
            hold_s = self._chance.uniform(*SHORT_FOR) * view.confirm_s
        self._due_s = at_s + duration_s + hold_s
        self._corrected_s = at_s + duration_s
        return Movement(self._posture(code), duration_s)

    def _correct(self, view: View, at_s: float) -> Movement | None:
        """Bend or stretch the fingers further that differ from the Task on the screen."""
        if (
            self.attempt is not Attempt.RIGHT
            or view.keeps_still
            or at_s < self._corrected_s + CORRECT_AFTER_S
        ):
            return None
        differs = [
            place
            for place, (seen, asked) in enumerate(zip(view.states, view.code, strict=False))
            if seen != asked
        ]
        if not differs:
            return None
        for place in differs:
            push = CORRECTION if view.states[place] > view.code[place] else -CORRECTION
            self._effort[place] = max(-MAX_CORRECTION, min(MAX_CORRECTION, self._effort[place] + push))
        self._corrected_s = at_s
        return Movement(self._posture(view.code), self._takes(*MOVEMENT_S))

    def _choose(self) -> Attempt:
        if self._made >= MAX_MISTAKES or self._chance.random() >= self.mistakes:
            return Attempt.RIGHT
        self._made += 1
        return self._chance.choice((Attempt.WRONG, Attempt.TOO_SHORT))

    def _mistaken(self, code: str) -> str:
        """Return `code` with one wrong finger, usually a bent one beside a straight one."""
        bent = [place for place, state in enumerate(code) if state != "0"]
        beside = [place for place in bent if "0" in code[max(0, place - 1) : place + 2]]
        place = self._chance.choice(beside or bent or range(len(code)))
        state = "0" if code[place] != "0" else "2"
        return code[:place] + state + code[place + 1 :]

    def _posture(self, code: str) -> Posture:
        shares = {"0": 1.0, "1": HALF_BENT, "2": 0.0}
        thumb, index, middle, ring, little = (
            shares[state] + effort for state, effort in zip(code, self._effort, strict=True)
        )
        return thumb, index, middle, ring, little

    def _reaction_s(self) -> float:
        reaction_s = REACTION_MEDIAN_S * self._chance.lognormvariate(0, REACTION_SPREAD)
        return min(max(reaction_s, MIN_REACTION_S), MAX_REACTION_S) / self.speed

    def _takes(self, least_s: float, most_s: float) -> float:
        return self._chance.uniform(least_s, most_s) / self.speed


def _mapping(member: object) -> Mapping[str, Any]:
    return member if isinstance(member, dict) else {}


def _asked(shown: Mapping[str, Any]) -> tuple[str | None, str]:
    """Return an identifier of the present request, and its code.

    A calibration counts before a test, a test before a Task, as on the screen.
    """
    if _is_guided(shown):
        guide = _mapping(shown["calibration"])
        return f"calibration {guide.get('step')}", str(guide.get("code", ""))
    if _is_tried(shown):
        test = _mapping(shown["accuracyTest"])
        return f"test {test.get('id')} {test.get('done')}", str(_mapping(test.get("asked")).get("code", ""))
    task = _mapping(shown.get("task"))
    if not task.get("id"):
        return None, str(task.get("code", ""))
    parts = task.get("parts")
    done = sum(_mapping(part).get("state") == "done" for part in parts) if isinstance(parts, list) else 0
    return f"{task['id']} part {done}" if done else str(task["id"]), str(task.get("code", ""))


def _is_guided(shown: Mapping[str, Any]) -> bool:
    guide = _mapping(shown.get("calibration"))
    return bool(guide) and guide.get("outcome") is None


def _is_tried(shown: Mapping[str, Any]) -> bool:
    """Return True if a calibration or an accuracy test asks for a gesture in testing mode."""
    return _is_guided(shown) or bool(_mapping(_mapping(shown.get("accuracyTest")).get("asked")))


def _is_code(code: str) -> bool:
    return len(code) == len(FINGERS) and set(code) <= set("012")
