"""An errand: what a Task asks of the hand in the glove, and the answer that is awaited."""

import asyncio
from dataclasses import dataclass, field
from typing import Any, Literal

from handover.job import Job, Wants
from services.gesture_controller.composed.in_turn import Turn
from services.gesture_controller.composed.together import Together
from services.gesture_controller.gestures import InTurn, Part, TwoHanded


@dataclass(frozen=True, slots=True)
class Asked:
    """What a Task asks of a person: to make a gesture. `command_id` is the command that it gives.

    `code` is that of the gesture, or of the part that comes first; `parts` are more than one where the
    gesture is composed.
    """

    task_id: str
    description: str
    gesture: str
    code: str
    command_id: int | None
    parts: tuple[Part, ...] = ()

    @property
    def hands(self) -> Literal["one", "both"]:
        """Say whether it takes one hand or both."""
        return "both" if any(part.hand for part in self.parts) else "one"

    @property
    def composed(self) -> InTurn | TwoHanded | None:
        """Return of what the gesture is composed; None if it is a single one."""
        if len(self.parts) < 2:
            return None
        first, second = self.parts
        kind = TwoHanded if self.hands == "both" else InTurn
        return kind(first.gesture, second.gesture)


@dataclass(frozen=True, slots=True)
class Answer:
    """How a person completed a Task; `operator` is whoever pressed the button, if it was the screen."""

    asked: Asked
    held_ms: float
    by: Literal["gesture", "screen"]
    operator: str | None = None

    @property
    def gesture(self) -> str:
        """Return the gesture that was asked for."""
        return self.asked.gesture

    def outputs(self) -> dict[str, Any]:
        """Return the outputParameters of the completed Task."""
        outputs = {
            "gesture": self.gesture,
            "commandId": self.asked.command_id,
            "heldMs": round(self.held_ms),
            "by": self.by,
            "operator": self.operator,
        }
        return {name: value for name, value in outputs.items() if value is not None}


@dataclass(slots=True, eq=False)
class Errand:
    """A Task that waits for its answer from one glove."""

    asked: Asked
    job: Job
    answer: asyncio.Future[Answer]
    listening: bool = False
    """True while a gesture may answer; the controller opens and closes it."""
    progress: Turn | Together = field(default_factory=Together)
    """How far hands have come with a gesture that is composed."""

    @property
    def is_open(self) -> bool:
        """Say whether a gesture would count now."""
        return self.listening and self.job.wants is Wants.GO and not self.answer.done()


class CannotComplete(ValueError):
    """The Task cannot be completed on the screen now; the message says what to do first."""


def completable(errand: Errand | None, glove: str, task: str | None, *, testing: bool) -> Errand:
    """Return the errand that a press for `task` on the screen of `glove` is meant for, or raise.

    Without `task` the present one is meant. Raises `CannotComplete`.
    """
    if errand is None or errand.answer.done():
        raise CannotComplete(f"{glove} has no Task at the moment; there is nothing to complete")
    if task is not None and task != errand.asked.task_id:
        raise CannotComplete(
            f"{glove} is asked for {errand.asked.task_id} now, no longer for {task}; "
            "look at what is asked, and complete that"
        )
    if testing:
        raise CannotComplete(f"{glove} is in testing mode; switch testing off, then complete the Task")
    return errand
