"""A gesture prompt: what a Task asks a person to show, and the answer to it."""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from handover.job import Job, RequestedAction, TaskFailed
from handover.messages import message
from handover.security.proofs import performer_proof, pin_check
from handover.security.proofs.pin_check import ProvenPin
from handover.tasks.outcomes import reason_of
from handover_datamodels.states import Outcome
from handover_gloves.prompting.sequence_gesture import SequenceProgress
from handover_gloves.prompting.two_hand_gesture import TwoHandProgress
from handover_gloves.recognition.gestures import Part, SequenceGesture, TwoHandGesture


@dataclass(frozen=True, slots=True)
class PromptSpec:
    """The gesture that a Task asks for; `command_id` is the command that it gives.

    `code` is the code of the gesture, or of its first part. A composite gesture has two `parts`. `answers`
    are the gestures for other outcomes than `ok`; on the screen every outcome is possible.
    """

    task_id: str
    description: str
    gesture: str
    code: str
    command_id: int | None
    parts: tuple[Part, ...] = ()
    answers: Mapping[Outcome, Part] = field(default_factory=dict)
    requires_pin: bool = False
    """Whether the person gives the own PIN on the screen before any answer."""

    @property
    def all_parts(self) -> tuple[Part, ...]:
        """The parts of the expected gesture, then those of the other answers."""
        return (*self.parts, *self.answers.values())

    def outcome_of(self, gesture: str | None) -> Outcome | None:
        """Return the outcome that `gesture` answers; None if it is no answer."""
        if gesture is None:
            return None
        if gesture == self.gesture or any(part.gesture == gesture for part in self.parts):
            return Outcome.OK
        return next((outcome for outcome, part in self.answers.items() if part.gesture == gesture), None)

    @property
    def hands(self) -> Literal["one", "both"]:
        """Whether the gesture takes one hand or both."""
        return "both" if any(part.hand for part in self.parts) else "one"

    @property
    def composite(self) -> SequenceGesture | TwoHandGesture | None:
        """The two parts of a composite gesture; None for a single gesture."""
        if len(self.parts) < 2:
            return None
        first, second = self.parts
        kind = TwoHandGesture if self.hands == "both" else SequenceGesture
        return kind(first.gesture, second.gesture)


@dataclass(frozen=True, slots=True)
class PromptAnswer:
    """The answer to a prompt; `operator` is the person who pressed the button, if it came from the screen.

    `performed_by` is the Person who was signed in or has joined the station of the glove, as far as known.
    """

    spec: PromptSpec
    held_ms: float
    by: Literal["gesture", "screen"]
    operator: str | None = None
    outcome: Outcome = Outcome.OK
    note: str | None = None
    performed_by: str | None = None
    pin_proof: str | None = None
    """Shows that this Person has given the own PIN for the Task (`handover.security.proofs.pin_check`)."""
    performer_proof: str | None = None
    """Shows that this Person has answered (`handover.security.proofs.performer_proof`)."""

    @property
    def gesture(self) -> str | None:
        """The gesture of the answer; None if a button answered with another outcome than `ok`."""
        if self.outcome is Outcome.OK:
            return self.spec.gesture
        return self.spec.answers[self.outcome].gesture if self.by == "gesture" else None

    @property
    def command_id(self) -> int | None:
        """The command that the answer gives; only `ok` gives one."""
        return self.spec.command_id if self.outcome is Outcome.OK else None

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
            performer_proof.PERFORMER_MEMBER: self.performed_by,
            performer_proof.PROOF_MEMBER: self.performer_proof,
            pin_check.PROOF_MEMBER: self.pin_proof,
        }
        return {name: value for name, value in outputs.items() if value is not None}

    def failure(self) -> TaskFailed:
        """Return the failure of a Task whose definition does not handle this outcome.

        `errorCode` is the outcome, so that an error boundary event of a process can catch it by name.
        """
        return TaskFailed(reason_of(self.outcome, self.note), **self.outputs(), errorCode=self.outcome.value)


@dataclass(slots=True, eq=False)
class GesturePrompt:
    """A Task that waits for an answer from one glove."""

    spec: PromptSpec
    job: Job
    answer: asyncio.Future[PromptAnswer]
    listening: bool = False
    """True while a gesture may answer; the controller sets it."""
    progress: SequenceProgress | TwoHandProgress = field(default_factory=TwoHandProgress)
    """The progress with a composite gesture."""
    pin: ProvenPin | None = None
    """The PIN that was given for this Task."""

    @property
    def pin_person(self) -> str | None:
        """The Person who has given the own PIN for this Task."""
        return None if self.pin is None else self.pin.person

    def needs_pin(self, person: str | None) -> bool:
        """Return whether a PIN is missing while `person` has joined the station (None: nobody is known)."""
        if not self.spec.requires_pin:
            return False
        return self.pin_person is None or person not in {None, self.pin_person}

    @property
    def is_open(self) -> bool:
        """True if a gesture would count now."""
        return self.listening and self.job.requested_action is RequestedAction.RUN and not self.answer.done()


class CannotComplete(ValueError):
    """The Task cannot be completed on the screen now; the message says what to do first."""


def require_completable(
    prompt: GesturePrompt | None, glove: str, task: str | None, *, testing: bool
) -> GesturePrompt:
    """Return the prompt that a press for `task` on the screen of `glove` belongs to, or raise.

    Without `task` it is the current prompt. Raises `CannotComplete`.
    """
    if prompt is None or prompt.answer.done():
        raise CannotComplete(
            message(
                "task.none", "{glove} has no Task at the moment; there is nothing to complete", glove=glove
            )
        )
    if task is not None and task != prompt.spec.task_id:
        raise CannotComplete(
            message(
                "task.another_asked",
                "{glove} is asked for {task_id} now, no longer for {task}; look at what is "
                "asked, and complete that",
                glove=glove,
                task_id=prompt.spec.task_id,
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
    return prompt
