"""Operator prompts: the message that the wearer of a glove needs now."""

from handover_datamodels.states import Outcome
from handover_gloves.gloves import operator_messages as messages
from handover_gloves.gloves.gesture_responder import GestureResponder
from handover_gloves.gloves.glove import Glove
from handover_gloves.gloves.operator_messages import OperatorMessage
from handover_gloves.prompting.prompt import GesturePrompt, PromptSpec
from handover_gloves.prompting.sequence_gesture import SequenceProgress, second_ms
from handover_gloves.prompting.two_hand_gesture import TwoHandProgress
from handover_gloves.recognition.gestures import Part, SequenceGesture
from handover_gloves.recognition.hold import HoldEvent

CONFIRMATION_SHOWN_S = 5.0
"""How long "Confirmed" is shown when no other Task follows."""


def differing_fingers(glove: Glove) -> list[str]:
    """Return the fingers that differ from the prompted gesture, or are not shown clearly enough."""
    responder, state = glove.responder, glove.reader.state
    if responder.prompt is None or not glove.is_connected or not state.states:
        return []
    due, seen = responder.due, state.recognition
    differing = messages.differing(state.states, due.code if due else responder.prompt.spec.code)
    return differing or list(seen.unclear_fingers if seen is not None else ())


def message_for(glove: Glove, now_s: float) -> OperatorMessage:
    """Return the message to the wearer of `glove` at `now_s`."""
    prompt = glove.responder.prompt
    if glove.modes.testing:
        return messages.testing(glove.reader.state.gesture if glove.is_connected else None)
    if prompt is None or prompt.answer.done():
        return _confirmation(glove, now_s) or messages.nothing_to_do(glove.name, glove.is_connected)
    if glove.connection.is_lost:
        return messages.silent(glove.name)
    if glove.device_state == "paused":
        return messages.paused_on_screen() if glove.modes.paused else messages.paused_by_process()
    if glove.responder.needs_pin:
        return messages.needs_pin()
    return _for_prompt(glove, prompt)


def _for_prompt(glove: Glove, prompt: GesturePrompt) -> OperatorMessage:
    if not glove.is_connected:
        return messages.put_on(glove.name)
    hold, timing = glove.reader.state.hold, glove.reader.config.timing
    outcome = prompt.spec.outcome_of(hold.gesture)
    if outcome not in {None, Outcome.OK} and hold.reached is not HoldEvent.NONE and not hold.is_spent:
        return messages.hold_on_to(outcome, timing.confirm_ms - timing.announce_ms)
    if prompt.spec.hands == "both":
        return _for_both_hands(glove, prompt)
    if isinstance(prompt.progress, SequenceProgress) and prompt.progress.step:
        if prompt.progress.held_ms >= timing.announce_ms:
            return messages.hold_on(second_ms(timing) - timing.announce_ms)
        return messages.then(prompt.spec.parts[1].gesture)
    return _for_one_hand(glove, prompt.spec)


def _confirmation(glove: Glove, now_s: float) -> OperatorMessage | None:
    if glove.responder.last_answer is None:
        return None
    answer, at_s = glove.responder.last_answer
    if now_s - at_s > CONFIRMATION_SHOWN_S:
        return None
    if answer.outcome is not Outcome.OK:
        return messages.answered(answer.outcome)
    return messages.by_screen(answer.operator) if answer.operator else messages.confirmed(answer.spec.gesture)


def _for_both_hands(glove: Glove, prompt: GesturePrompt) -> OperatorMessage:
    spec, other, progress = prompt.spec, glove.responder.partner, prompt.progress
    other_hand = "left" if glove.hand == "right" else "right"
    if other is None:
        return messages.wear_both(spec.gesture, other_hand, glove.person)
    if not other.connection.is_connected:
        return messages.put_on(other.name)
    if isinstance(progress, TwoHandProgress):
        if progress.apart:
            return messages.begin_together(spec.gesture)
        if progress.reached is not HoldEvent.NONE:
            timing = glove.reader.config.timing
            return messages.hold_on(timing.confirm_ms - timing.announce_ms)
    return _for_missing_hand(glove.responder, other, other_hand) or _for_one_hand(glove, spec)


def _for_missing_hand(
    own: GestureResponder, other: GestureResponder, other_hand: str
) -> OperatorMessage | None:
    due, others_due = own.due, other.due
    if due is not None and others_due is not None and own.shows(due) and not other.shows(others_due):
        return messages.other_hand(others_due.gesture, other_hand)
    return None


def _for_one_hand(glove: Glove, spec: PromptSpec) -> OperatorMessage:
    state, timing = glove.reader.state, glove.reader.config.timing
    hold, differing = state.hold, differing_fingers(glove)
    due = glove.responder.due or Part(spec.gesture, spec.code)
    if hold.is_spent and hold.gesture == due.gesture:
        return messages.let_go(due.gesture)
    if hold.reached is not HoldEvent.NONE and hold.gesture is not None:
        if hold.gesture != due.gesture:
            return messages.wrong(hold.gesture, messages.advice(differing, due.code))
        if spec.composite is None:
            return messages.hold_on(timing.confirm_ms - timing.announce_ms)
    still_ms = (hold.seen_s - state.states_since_s) * 1000
    if state.gesture is None and differing and still_ms >= timing.announce_ms:
        hint = messages.advice(differing, due.code)
        almost = len(differing) <= messages.MAX_ALMOST_FINGERS
        return messages.almost(due.gesture, hint) if almost else messages.differs(due.gesture, hint)
    return _invitation(glove, spec, due)


def _invitation(glove: Glove, spec: PromptSpec, due: Part) -> OperatorMessage:
    if isinstance(spec.composite, SequenceGesture):
        return messages.first(spec.gesture, due.gesture)
    if not due.hand:
        return messages.show(due.gesture)
    if any(glove.responder.shows(part) for part in spec.parts):
        return messages.show_with(due.gesture, glove.hand)
    return messages.show_both(*(part.gesture for part in spec.parts))
