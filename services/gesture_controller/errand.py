"""An errand: what a Task asks of the hand in the glove, and the answer that is awaited."""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from datamodels.states import Outcome
from handover.job import Job, RequestedAction, TaskFailed
from handover.messages import message
from handover.outcomes import reason_of
from services.gesture_controller.composed.in_turn import Turn
from services.gesture_controller.composed.together import Together
from services.gesture_controller.gestures import InTurn, Part, TwoHanded


@dataclass(frozen=True, slots=True)
class Asked:
    """What a Task asks of a person: to make a gesture. `command_id` is the command that it gives.

    `code` is that of the gesture, or of the part that comes first; `parts` are more than one where the
    gesture is composed. `answers` are the gestures for other outcomes than `ok`, where there are any; on
    the screen every outcome can be answered.
    """

    task_id: str
    description: str
    gesture: str
    code: str
    command_id: int | None
    parts: tuple[Part, ...] = ()
    answers: Mapping[Outcome, Part] = field(default_factory=dict)

    @property
    def all_parts(self) -> tuple[Part, ...]:
        """Return every gesture that answers: the parts of the one asked for, then those of other outcomes."""
        return (*self.parts, *self.answers.values())

    def outcome_of(self, gesture: str | None) -> Outcome | None:
        """Return what `gesture` answers: `ok` if it is the one asked for; None if it answers nothing."""
        if gesture is None:
            return None
        if gesture == self.gesture or any(part.gesture == gesture for part in self.parts):
            return Outcome.OK
        return next((one for one, part in self.answers.items() if part.gesture == gesture), None)

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
    """How a person answered a Task; `operator` is the person who pressed the button, if it was the screen."""

    asked: Asked
    held_ms: float
    by: Literal["gesture", "screen"]
    operator: str | None = None
    outcome: Outcome = Outcome.OK
    note: str | None = None

    @property
    def gesture(self) -> str | None:
        """Return the gesture of the answer; None where a button answered something else than `ok`."""
        if self.outcome is Outcome.OK:
            return self.asked.gesture
        return self.asked.answers[self.outcome].gesture if self.by == "gesture" else None

    @property
    def command_id(self) -> int | None:
        """Return the command that the answer gives: only `ok` gives one."""
        return self.asked.command_id if self.outcome is Outcome.OK else None

    def outputs(self) -> dict[str, Any]:
        """Return the outputParameters of the Task."""
        outputs = {
            "gesture": self.gesture,
            "commandId": self.command_id,
            "heldMs": round(self.held_ms),
            "by": self.by,
            "operator": self.operator,
            "outcome": self.outcome.value,
            "note": self.note,
        }
        return {name: value for name, value in outputs.items() if value is not None}

    def failure(self) -> TaskFailed:
        """Return the failure of a Task whose definition does not handle this outcome.

        `errorCode` is the outcome, so that an error boundary event of a process can catch it by name.
        """
        return TaskFailed(reason_of(self.outcome, self.note), **self.outputs(), errorCode=self.outcome.value)


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
        return self.listening and self.job.requested_action is RequestedAction.RUN and not self.answer.done()


class CannotComplete(ValueError):
    """The Task cannot be completed on the screen now; the message says what to do first."""


def completable(errand: Errand | None, glove: str, task: str | None, *, testing: bool) -> Errand:
    """Return the errand that a press for `task` on the screen of `glove` is meant for, or raise.

    Without `task` the present one is meant. Raises `CannotComplete`.
    """
    if errand is None or errand.answer.done():
        raise CannotComplete(
            message(
                "task.none", "{glove} has no Task at the moment; there is nothing to complete", glove=glove
            )
        )
    if task is not None and task != errand.asked.task_id:
        raise CannotComplete(
            message(
                "task.another_asked",
                "{glove} is asked for {task_id} now, no longer for {task}; look at what is "
                "asked, and complete that",
                glove=glove,
                task_id=errand.asked.task_id,
                task=task,
            )
        )
    if testing:
        raise CannotComplete(
            message(
                "task.testing_mode",
                "{glove} is in testing mode; switch testing off, then complete the Task",
                glove=glove,
            )
        )
    return errand
