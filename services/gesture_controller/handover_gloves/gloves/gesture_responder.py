"""The gesture responder: turns what a hand shows into answers to prompts, and into commands."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Protocol

from handover.job import RequestedAction
from handover.messages import message
from handover.security.proofs.pin_check import ProvenPin
from handover_datamodels.states import Outcome
from handover_gloves import metrics
from handover_gloves.gloves.connection_state import ConnectionState
from handover_gloves.prompting import composite
from handover_gloves.prompting.modes import GloveModes
from handover_gloves.prompting.prompt import CannotComplete, GesturePrompt, PromptAnswer, require_completable
from handover_gloves.recognition.gestures import Commands, Part
from handover_gloves.recognition.hand_reader import HandReader
from handover_gloves.recognition.hold import HoldEvent
from handover_gloves.recognition.pipeline import Rules, Verdict, judge

PAUSED_ON_SCREEN = "paused on the screen"


class OnChange(Protocol):
    """Called when the glove has changed; `is_urgent` is False if only the hand moved."""

    def __call__(self, *, is_urgent: bool = True) -> None:
        """Notify listener and screens."""


@dataclass(slots=True)
class Station:
    """The station of a glove: who has joined it, and who is notified of gestures without a Task."""

    person: Callable[[], str | None] = lambda: None
    held: Callable[[str], None] = lambda _: None


class GestureResponder:
    """Answers prompts and gives commands with one hand, or together with the other hand of the person."""

    def __init__(
        self,
        connection: ConnectionState,
        reader: HandReader,
        modes: GloveModes,
        commands: Commands,
        on_change: OnChange,
    ) -> None:
        self.connection = connection
        self.reader = reader
        self.modes = modes
        self.commands = commands
        self.prompt: GesturePrompt | None = None
        self.partner: GestureResponder | None = None
        """The other hand, while both answer one prompt."""
        self.other_hand: Callable[[], GestureResponder | None] = lambda: None
        """Returns the other hand of the wearer, if it has a glove."""
        self.tracker = composite.CompositeTracker()
        self.free = asyncio.Event()
        """Set while there is no prompt."""
        self.free.set()
        self.last_answer: tuple[PromptAnswer, float] | None = None
        """The last answer, and when it was given (event loop clock)."""
        self.station = Station()
        self.command: tuple[int, datetime] | None = None
        """The last command, and when it was given."""
        self._on_change = on_change

    @property
    def name(self) -> str:
        """The name of the glove."""
        return self.connection.hello.glove

    @property
    def hand(self) -> str:
        """`left` or `right`."""
        return self.connection.hello.hand

    @property
    def last_s(self) -> float:
        """When the last frame arrived."""
        return self.connection.last_s

    @property
    def is_paused(self) -> bool:
        """True while the wearer or the process has paused the work."""
        return self.modes.paused or (
            self.prompt is not None and self.prompt.job.requested_action is RequestedAction.PAUSE
        )

    # Prompts

    def begin(self, prompt: GesturePrompt) -> None:
        """Start `prompt`; gestures answer it only after `listen`."""
        self.prompt = prompt
        prompt.progress = composite.initial_progress(prompt)
        self.free.clear()
        self.connection.was_present = self.connection.is_connected
        if self.modes.paused:
            prompt.job.pause(PAUSED_ON_SCREEN)
        self._on_change()

    def join(self, partner: "GestureResponder") -> None:
        """Let `partner`, the other hand, answer the prompt together with this hand."""
        if self.prompt is not None and self.partner is None:
            self.partner, partner.partner = partner, self
            partner.begin(self.prompt)
            partner.restart()

    def listen(self) -> None:
        """Let gestures answer the prompt; holds that began before do not count."""
        if self.prompt is not None and not self.prompt.listening:
            self.prompt.listening = True
            for hand in self._hands():
                hand.restart()

    def stop_listening(self) -> None:
        """Let no gesture answer until `listen`."""
        if self.prompt is not None:
            self.prompt.listening = False

    def end(self) -> None:
        """Drop the prompt, answered or not."""
        for hand in self._hands():
            hand.prompt = hand.partner = None
            hand.free.set()
            hand._on_change()

    def complete_on_screen(
        self,
        operator: str,
        now_s: float,
        task: str | None = None,
        outcome: Outcome = Outcome.OK,
        note: str | None = None,
        *,
        performed_by: str | None = None,
    ) -> None:
        """Answer the prompt for `operator`, who pressed the button; raises `CannotComplete`.

        `performed_by` is the Person who is signed in at the screen.

        `task` is the id of the Task that the button belonged to. If another Task is prompted by now, because
        somebody else or the hand was faster, the press must not answer it.
        """
        prompt = self.completable(task)
        if prompt.spec.requires_pin and (performed_by is None or performed_by != prompt.pin_person):
            raise CannotComplete(
                message("task.needs_pin", "the Task of {glove} needs a PIN; enter it first", glove=self.name)
            )
        for hand in self._hands():
            prompt.job.resume(hand._silence_reason)
        if prompt.job.requested_action is not RequestedAction.RUN:
            for hand in self._hands():
                if hand.connection.is_lost:
                    prompt.job.pause(hand._silence_reason)
            raise CannotComplete(f"the Task of {self.name} is paused; resume it, then complete it")
        answer = PromptAnswer(prompt.spec, 0, "screen", operator, outcome, note, performed_by)
        self._answer(prompt, answer, now_s)

    def completable(self, task: str | None = None) -> GesturePrompt:
        """Return the prompt, if it is of `task` and can be answered now; raises `CannotComplete`."""
        return require_completable(self.prompt, self.name, task, testing=self.modes.testing)

    def give_pin(self, proof: ProvenPin, task: str | None = None) -> None:
        """Note who has given the own PIN for the prompt; raises `CannotComplete`."""
        self.completable(task).pin = proof
        for hand in self._hands():
            hand.restart()
            hand._on_change()

    @property
    def needs_pin(self) -> bool:
        """Whether a PIN is missing, so that no gesture counts."""
        return self.prompt is not None and self.prompt.needs_pin(self.station.person())

    def pause(self) -> None:
        """Pause the Task for the wearer."""
        if self.prompt is not None:
            self.prompt.job.pause(PAUSED_ON_SCREEN)

    def resume(self) -> None:
        """Resume the Task for the wearer, unless the other hand is paused."""
        if self.prompt is not None and not any(hand.modes.paused for hand in self._hands()):
            self._resume(self.prompt, PAUSED_ON_SCREEN)
        self.restart()

    def pause_for_silence(self) -> None:
        """Pause the Task: the glove stopped sending."""
        if self.prompt is not None:
            self.prompt.job.pause(self._silence_reason)

    def resume_after_silence(self) -> None:
        """Resume the Task: the glove sends again."""
        if self.prompt is not None:
            self.connection.was_present = True
            self._resume(self.prompt, self._silence_reason)

    def restart(self) -> None:
        """Count no hold, and no part of a composite gesture, that began before."""
        self.reader.restart_hold()
        self.tracker.clear()
        if self.prompt is not None:
            self.prompt.progress = composite.initial_progress(self.prompt)

    @property
    def due(self) -> Part | None:
        """What the prompt asks this hand to show now."""
        return None if self.prompt is None else composite.due_part(self.prompt, self.hand)

    def shows(self, part: Part) -> bool:
        """Return True if this hand, or its partner, shows `part` now."""
        hands = [hand for hand in self._hands() if part.hand in {None, hand.hand}]
        return any(
            hand.connection.is_connected and hand.reader.state.gesture == part.gesture for hand in hands
        )

    # Frames

    def respond(self, now_s: float) -> None:
        """Answer the prompt or give a command, if the last frame completed a hold."""
        self._interpret(now_s)
        for hand in self._hands():  # the screen of each hand shows both
            hand._on_change(is_urgent=False)

    def _interpret(self, now_s: float) -> None:
        hold, prompt = self.reader.state.hold, self.prompt
        if hold.last is HoldEvent.CONFIRMED and prompt is None and hold.gesture is not None:
            self.station.held(hold.gesture)
        if hold.last is not HoldEvent.NONE:
            due = self.due
            answers = prompt.spec.answers if prompt is not None else {}
            rules = Rules(
                due.gesture if due else None, self.commands, self.modes.filtering, self._is_open(), answers
            )
            self._apply(judge(hold, rules), now_s)
        if self.modes.filtering and (prompt is None or prompt.spec.composite is None):
            return
        if self._is_open():
            self._respond_to_composite(prompt, now_s)
        elif prompt is not None:
            prompt.progress = composite.initial_progress(prompt)

    def _respond_to_composite(self, prompt: GesturePrompt | None, now_s: float) -> None:
        held_ms = None if prompt is None else composite.advance_prompt(prompt, self, self.partner, now_s)
        if prompt is not None and held_ms is not None and not prompt.answer.done():
            self._mark_spent()
            self._answer(prompt, PromptAnswer(prompt.spec, held_ms, "gesture"), now_s)
        if self.modes.filtering:
            return
        command = self.tracker.completed_command(self, prompt.spec.gesture if prompt else None, now_s)
        if command is not None:
            metrics.COMMANDS_SENT.inc()
            for hand in command.hands:
                hand._mark_spent()
                hand._give_command(self.commands.ids[command.gesture])

    def _apply(self, verdict: Verdict, now_s: float) -> None:
        hold, prompt = self.reader.state.hold, self.prompt
        if verdict is Verdict.WRONG:
            metrics.WRONG_GESTURES.inc()
        elif verdict is Verdict.COMPLETE and prompt is not None:
            outcome = prompt.spec.outcome_of(hold.gesture) or Outcome.OK
            if outcome is Outcome.OK and prompt.spec.composite is not None:
                return  # a part of a composite gesture counts only with the other part
            self._mark_spent()
            self._answer(prompt, PromptAnswer(prompt.spec, hold.held_ms, "gesture", outcome=outcome), now_s)
        elif (
            verdict is Verdict.COMMAND
            and hold.gesture is not None
            and not composite.is_part_of_composite(hold.gesture, self, prompt)
        ):
            self._mark_spent()
            metrics.COMMANDS_SENT.inc()
            self._give_command(self.commands.ids[hold.gesture])

    def _answer(self, prompt: GesturePrompt, answer: PromptAnswer, now_s: float) -> None:
        if answer.performed_by is None:
            answer = replace(answer, performed_by=self.station.person() or prompt.pin_person)
        if prompt.pin is not None:
            answer = replace(answer, pin_proof=prompt.pin.proof)
        prompt.answer.set_result(answer)
        metrics.TASKS_ANSWERED.labels(answer.by, answer.outcome.value).inc()
        for hand in self._hands():
            hand.last_answer = (answer, now_s)
            if answer.command_id is None:
                hand._on_change()
            else:
                hand._give_command(answer.command_id)

    def _give_command(self, command_id: int) -> None:
        self.command = (command_id, datetime.now(UTC))
        self._on_change()

    def _mark_spent(self) -> None:
        for hand in self._hands():
            hand.reader.mark_hold_spent()

    def _resume(self, prompt: GesturePrompt, reason: str) -> None:
        was_paused = prompt.job.requested_action is RequestedAction.PAUSE
        prompt.job.resume(reason)
        if was_paused and prompt.job.requested_action is RequestedAction.RUN:
            self.listen()  # the hand need not wait for the broker

    def _is_open(self) -> bool:
        """Return True if anything that this hand shows counts now."""
        is_counting = not any(hand.modes.testing or hand.modes.paused for hand in self._hands())
        return is_counting and not self.needs_pin and (self.prompt is None or self.prompt.is_open)

    def _hands(self) -> "tuple[GestureResponder, ...]":
        """Return this hand, and the other one while both answer the same prompt."""
        return (self,) if self.partner is None else (self, self.partner)

    @property
    def _silence_reason(self) -> str:
        return f"{self.name} silent"
