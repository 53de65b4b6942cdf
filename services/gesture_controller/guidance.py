"""Guidance: which word the wearer of a glove needs now."""

from datamodels.states import Outcome
from services.gesture_controller import wording
from services.gesture_controller.composed.in_turn import Turn, second_ms
from services.gesture_controller.composed.together import Together
from services.gesture_controller.errand import Asked, Errand
from services.gesture_controller.gestures import InTurn, Part
from services.gesture_controller.glove import Glove
from services.gesture_controller.hold import HoldEvent
from services.gesture_controller.wording import Message

THANKS_S = 5.0
"""How long "Confirmed" stays when no other Task follows."""


def differing_fingers(glove: Glove) -> list[str]:
    """Return the fingers that are not as the Task's gesture has them, or not clearly enough."""
    if glove.errand is None or not glove.connected or not glove.sight.states:
        return []
    due, seen = glove.due, glove.sight.recognition
    differing = wording.differing(glove.sight.states, due.code if due else glove.errand.asked.code)
    return differing or list(seen.doubtful if seen is not None else ())


def said_to(glove: Glove, now_s: float) -> Message:
    """Return what the controller says to the wearer of `glove` at `now_s`."""
    errand = glove.errand
    if glove.testing:
        return wording.testing(glove.sight.gesture if glove.connected else None)
    if errand is None or errand.answer.done():
        return _thanks(glove, now_s) or wording.nothing_to_do(glove.name, glove.connected)
    if glove.lost:
        return wording.silent(glove.name)
    if glove.device_state == "paused":
        return wording.paused_on_screen() if glove.paused else wording.paused_by_process()
    return _asked_of(glove, errand)


def _asked_of(glove: Glove, errand: Errand) -> Message:
    if not glove.connected:
        return wording.put_on(glove.name)
    hold, timing = glove.sight.hold, glove.senses.timing
    outcome = errand.asked.outcome_of(hold.gesture)
    if outcome not in {None, Outcome.OK} and hold.reached is not HoldEvent.NONE and not hold.is_spent:
        return wording.hold_on_to(outcome, timing.confirm_ms - timing.announce_ms)
    if errand.asked.hands == "both":
        return _about_both(glove, errand)
    if isinstance(errand.progress, Turn) and errand.progress.step:
        due = errand.asked.parts[1].gesture
        if errand.progress.held_ms >= glove.senses.timing.announce_ms:
            return wording.hold_on(second_ms(glove.senses.timing) - glove.senses.timing.announce_ms)
        return wording.then(due)
    return _about_the_hand(glove, errand.asked)


def _thanks(glove: Glove, now_s: float) -> Message | None:
    if glove.last_answer is None:
        return None
    answer, at_s = glove.last_answer
    if now_s - at_s > THANKS_S:
        return None
    if answer.outcome is not Outcome.OK:
        return wording.answered(answer.outcome)
    return wording.by_screen(answer.operator) if answer.operator else wording.confirmed(answer.asked.gesture)


def _about_both(glove: Glove, errand: Errand) -> Message:
    asked, other, progress = errand.asked, glove.partner, errand.progress
    other_hand = "left" if glove.hand == "right" else "right"
    if other is None:
        return wording.wear_both(asked.gesture, other_hand, glove.person)
    if not other.connected:
        return wording.put_on(other.name)
    if isinstance(progress, Together):
        if progress.apart:
            return wording.begin_together(asked.gesture)
        if progress.reached is not HoldEvent.NONE:
            return wording.hold_on(glove.senses.timing.confirm_ms - glove.senses.timing.announce_ms)
    due, others = glove.due, other.due
    if due is not None and others is not None and glove.shows(due) and not other.shows(others):
        return wording.other_hand(others.gesture, other_hand)
    return _about_the_hand(glove, asked)


def _about_the_hand(glove: Glove, asked: Asked) -> Message:
    sight, timing = glove.sight, glove.senses.timing
    hold, differs = sight.hold, differing_fingers(glove)
    due = glove.due or Part(asked.gesture, asked.code)
    if hold.is_spent and hold.gesture == due.gesture:
        return wording.let_go(due.gesture)
    if hold.reached is not HoldEvent.NONE and hold.gesture is not None:
        if hold.gesture != due.gesture:
            return wording.wrong(hold.gesture, wording.advice(differs, due.code))
        if asked.composed is None:
            return wording.hold_on(timing.confirm_ms - timing.announce_ms)
    still_ms = (hold.seen_s - sight.states_since_s) * 1000
    if sight.gesture is None and 0 < len(differs) <= 2 and still_ms >= timing.announce_ms:
        return wording.almost(due.gesture, wording.advice(differs, due.code))
    return _invitation(glove, asked, due)


def _invitation(glove: Glove, asked: Asked, due: Part) -> Message:
    if isinstance(asked.composed, InTurn):
        return wording.first(asked.gesture, due.gesture)
    if not due.hand:
        return wording.show(due.gesture)
    if any(glove.shows(part) for part in asked.parts):
        return wording.show_with(due.gesture, glove.hand)
    return wording.show_both(*(part.gesture for part in asked.parts))
