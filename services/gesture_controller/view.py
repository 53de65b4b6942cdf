"""The view of a glove: what screens and other programs see of it, as one JSON object."""

from typing import Any

from handover.job import Wants
from services.gesture_controller import wording
from services.gesture_controller.errand import Asked
from services.gesture_controller.glove import Glove
from services.gesture_controller.hold import HoldEvent
from services.gesture_controller.thresholds import FINGERS
from services.gesture_controller.wording import Message

THANKS_S = 5.0
"""How long "Confirmed" stays when no other Task follows."""


def view_of(glove: Glove, now_s: float) -> dict[str, Any]:
    """Return the state of `glove` at `now_s` (the event loop's clock)."""
    there = glove.connected
    hold, timing = glove.sight.hold, glove.senses.timing
    wants_pause = glove.errand is not None and glove.errand.job.wants is Wants.PAUSE
    return {
        "glove": glove.name,
        "hand": glove.hand,
        "person": glove.person,
        "connected": there,
        "deviceState": glove.device_state,
        "battery": glove.battery,
        "task": _task(glove),
        "message": message(glove, now_s).as_dict(),
        "answered": _answered(glove),
        "hold": {
            "gesture": hold.gesture if there else None,
            "heldMs": round(hold.held_ms) if there and not hold.is_spent else 0,
            "announceMs": timing.announce_ms,
            "confirmMs": timing.confirm_ms,
            "spent": there and hold.is_spent,
        },
        "bend": glove.bend if there else None,
        "states": (glove.sight.states or None) if there else None,
        "gesture": glove.sight.gesture if there else None,
        "differs": differing_fingers(glove),
        "testing": glove.testing,
        "filtering": glove.filtering,
        "examination": glove.examination() if glove.examination is not None else None,
        "paused": glove.paused or wants_pause,
        "lost": glove.lost,
        "thresholds": glove.senses.thresholds.as_dict(),
        "recognizer": {"name": glove.senses.recognizer, "missing": glove.senses.missing},
        "certainty": _certainty(glove) if there else None,
        "drift": dict(zip(FINGERS, [round(one, 2) for one in glove.sight.drift.offsets], strict=True)),
        "calibrationNeeded": glove.sight.drift.wants_calibration,
        "calibration": glove.guidance() if glove.guidance is not None else None,
        "frames": glove.frames,
        "dropped": sum(glove.dropped.values()),
        "droppedBy": dict(glove.dropped),
        "rate_hz": glove.rate_hz,
    }


def _certainty(glove: Glove) -> float | None:
    seen = glove.sight.recognition
    return None if seen is None else round(seen.certainty, 3)


def _task(glove: Glove) -> dict[str, Any] | None:
    errand = glove.errand
    if errand is None:
        return None
    return {
        "id": errand.asked.task_id,
        "description": errand.asked.description,
        "gesture": errand.asked.gesture,
        "code": errand.asked.code,
        "commandId": errand.asked.command_id,
        "status": str(errand.job.task.status.value),
    }


def _answered(glove: Glove) -> dict[str, Any] | None:
    """Return the last answer that this hand or its screen gave, so that no screen misses a quick one."""
    if glove.last_answer is None:
        return None
    answer, _ = glove.last_answer
    return {
        "task": answer.asked.task_id,
        "gesture": answer.gesture,
        "by": answer.by,
        "operator": answer.operator,
    }


def differing_fingers(glove: Glove) -> list[str]:
    """Return the fingers that are not as the Task's gesture has them."""
    if glove.errand is None or not glove.connected or not glove.sight.states:
        return []
    return wording.differing(glove.sight.states, glove.errand.asked.code)


def message(glove: Glove, now_s: float) -> Message:
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
    if not glove.connected:
        return wording.put_on(glove.name)
    return _about_the_hand(glove, errand.asked)


def _thanks(glove: Glove, now_s: float) -> Message | None:
    if glove.last_answer is None:
        return None
    answer, at_s = glove.last_answer
    if now_s - at_s > THANKS_S:
        return None
    return wording.by_screen(answer.operator) if answer.operator else wording.confirmed(answer.gesture)


def _about_the_hand(glove: Glove, asked: Asked) -> Message:
    sight, timing = glove.sight, glove.senses.timing
    hold, differs = sight.hold, differing_fingers(glove)
    if hold.is_spent and hold.gesture == asked.gesture:
        return wording.let_go(asked.gesture)
    if hold.reached is not HoldEvent.NONE and hold.gesture is not None:
        if hold.gesture == asked.gesture:
            return wording.hold_on(timing.confirm_ms - timing.announce_ms)
        return wording.wrong(hold.gesture, wording.advice(differs, asked.code))
    still_ms = (hold.seen_s - sight.states_since_s) * 1000
    if sight.gesture is None and 0 < len(differs) <= 2 and still_ms >= timing.announce_ms:
        return wording.almost(asked.gesture, wording.advice(differs, asked.code))
    return wording.show(asked.gesture)
