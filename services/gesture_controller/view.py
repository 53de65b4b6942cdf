"""The view of a glove: what screens and other programs see of it, as one JSON object."""

from typing import Any

from datamodels.states import Outcome
from handover.job import RequestedAction
from services.gesture_controller import wording
from services.gesture_controller.composed.in_turn import Turn, second_ms
from services.gesture_controller.errand import Errand
from services.gesture_controller.glove import Glove
from services.gesture_controller.guidance import differing_fingers, said_to
from services.gesture_controller.thresholds import FINGERS


def view_of(glove: Glove, now_s: float) -> dict[str, Any]:
    """Return the state of `glove` at `now_s` (the event loop's clock)."""
    there = glove.connected
    wants_pause = glove.errand is not None and glove.errand.job.requested_action is RequestedAction.PAUSE
    return {
        "glove": glove.name,
        "hand": glove.hand,
        "person": glove.person,
        "connected": there,
        "deviceState": glove.device_state,
        "battery": glove.battery,
        "task": _task(glove),
        "message": said_to(glove, now_s).as_dict(),
        "answered": _answered(glove),
        "hold": _hold(glove),
        "bend": glove.bend if there else None,
        "states": (glove.sight.states or None) if there else None,
        "gesture": glove.sight.gesture if there else None,
        "differs": differing_fingers(glove),
        "testing": glove.testing,
        "filtering": glove.filtering,
        "warning": None if glove.filtering else wording.unfiltered().as_dict(),
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
        "code": glove.due.code if glove.due else errand.asked.code,
        "commandId": errand.asked.command_id,
        "parts": _parts(glove, errand),
        "status": str(errand.job.task.status.value),
        "answers": _answers(errand),
    }


def _answers(errand: Errand) -> list[dict[str, Any]]:
    """Return the answers other than `ok`: always on the screen, by gesture where `gesture` is not null."""
    answers: list[dict[str, Any]] = []
    for outcome in (Outcome.NOT_GOOD, Outcome.PROBLEM):
        part = errand.asked.answers.get(outcome)
        answers.append(
            {
                "outcome": outcome.value,
                "gesture": part.gesture if part else None,
                "code": part.code if part else None,
                "parts": [],
            }
        )
    return answers


def _parts(glove: Glove, errand: Errand) -> list[dict[str, Any]]:
    """Return the parts of a composed gesture and which is next; none of a single one."""
    if errand.asked.composed is None:
        return []
    progress = errand.progress
    parts = []
    for place, part in enumerate(errand.asked.parts):
        if isinstance(progress, Turn):
            state = ("done", "now", "next")[1 + place - progress.step]
        else:
            state = "held" if glove.shows(part) else "now"
        parts.append({"gesture": part.gesture, "code": part.code, "hand": part.hand, "state": state})
    return parts


def _hold(glove: Glove) -> dict[str, Any]:
    """Return how long the gesture has been held; of a composed one, what is due of it.

    `outcome` is what the gesture would answer to the Task; null if it is none of its answers.
    """
    hold, timing, there = glove.sight.hold, glove.senses.timing, glove.connected
    held_ms, confirm_ms = 0.0 if hold.is_spent else hold.held_ms, timing.confirm_ms
    errand = glove.errand
    outcome = errand.asked.outcome_of(hold.gesture) if errand is not None and there else None
    if errand is not None and errand.asked.composed is not None and outcome in {None, Outcome.OK}:
        held_ms = errand.progress.held_ms
        if isinstance(errand.progress, Turn):
            confirm_ms = second_ms(timing) if errand.progress.step else timing.announce_ms
    return {
        "gesture": hold.gesture if there else None,
        "heldMs": round(held_ms) if there else 0,
        "announceMs": min(timing.announce_ms, confirm_ms),
        "confirmMs": confirm_ms,
        "spent": there and hold.is_spent,
        "outcome": outcome.value if outcome is not None else None,
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
        "outcome": answer.outcome.value,
        "note": answer.note,
    }
