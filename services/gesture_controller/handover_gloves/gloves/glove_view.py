"""The view of a glove: the JSON object that screens and other programs get."""

from typing import Any

from handover.job import RequestedAction
from handover_datamodels.states import Outcome
from handover_gloves.gloves import operator_messages as messages
from handover_gloves.gloves.glove import Glove
from handover_gloves.gloves.operator_prompts import differing_fingers, message_for
from handover_gloves.prompting.prompt import GesturePrompt
from handover_gloves.prompting.sequence_gesture import SequenceProgress, second_ms
from handover_gloves.recognition.thresholds import FINGERS


def view_of(glove: Glove, now_s: float) -> dict[str, Any]:
    """Return the view of `glove` at `now_s` (event loop clock)."""
    connection, reader, modes, observers = glove.connection, glove.reader, glove.modes, glove.observers
    is_connected, prompt = glove.is_connected, glove.responder.prompt
    is_paused_by_task = prompt is not None and prompt.job.requested_action is RequestedAction.PAUSE
    drift = reader.state.drift
    return {
        "glove": glove.name,
        "hand": glove.hand,
        "person": glove.person,
        "connected": is_connected,
        "deviceState": glove.device_state,
        "battery": connection.battery,
        "task": _task(glove),
        "message": message_for(glove, now_s).as_dict(),
        "answered": _answered(glove),
        "hold": _hold(glove),
        "bend": reader.bend if is_connected else None,
        "states": (reader.state.states or None) if is_connected else None,
        "gesture": reader.state.gesture if is_connected else None,
        "differs": differing_fingers(glove),
        "testing": modes.testing,
        "filtering": modes.filtering,
        "warning": None if modes.filtering else messages.unfiltered().as_dict(),
        "accuracyTest": observers.accuracy_test() if observers.accuracy_test is not None else None,
        "paused": modes.paused or is_paused_by_task,
        "lost": connection.is_lost,
        "thresholds": reader.config.thresholds.as_dict(),
        "recognizer": {"name": reader.config.recognizer_name, "missing": reader.config.missing},
        "certainty": _certainty(glove) if is_connected else None,
        "drift": dict(zip(FINGERS, [round(offset, 2) for offset in drift.offsets], strict=True)),
        "calibrationNeeded": drift.wants_calibration,
        "calibration": observers.calibration() if observers.calibration is not None else None,
        "frames": connection.traffic.frames,
        "dropped": sum(connection.traffic.dropped.values()),
        "droppedBy": dict(connection.traffic.dropped),
        "rate_hz": connection.traffic.rate_hz,
    }


def _certainty(glove: Glove) -> float | None:
    seen = glove.reader.state.recognition
    return None if seen is None else round(seen.certainty, 3)


def _task(glove: Glove) -> dict[str, Any] | None:
    prompt, due = glove.responder.prompt, glove.responder.due
    if prompt is None:
        return None
    return {
        "id": prompt.spec.task_id,
        "description": prompt.spec.description,
        "gesture": prompt.spec.gesture,
        "code": due.code if due else prompt.spec.code,
        "commandId": prompt.spec.command_id,
        "parts": _parts(glove, prompt),
        "status": str(prompt.job.task.status.value),
        "answers": _answers(prompt),
        "needsPin": glove.responder.needs_pin,
    }


def _answers(prompt: GesturePrompt) -> list[dict[str, Any]]:
    """Return the answers other than `ok`; `gesture` is null for those that only the screen can give."""
    answers: list[dict[str, Any]] = []
    for outcome in (Outcome.NOT_GOOD, Outcome.PROBLEM):
        part = prompt.spec.answers.get(outcome)
        answers.append(
            {
                "outcome": outcome.value,
                "gesture": part.gesture if part else None,
                "code": part.code if part else None,
                "parts": [],
            }
        )
    return answers


def _parts(glove: Glove, prompt: GesturePrompt) -> list[dict[str, Any]]:
    """Return the parts of a composite gesture with the state of each; empty for a single gesture."""
    if prompt.spec.composite is None:
        return []
    progress = prompt.progress
    parts = []
    for number, part in enumerate(prompt.spec.parts):
        if isinstance(progress, SequenceProgress):
            state = ("done", "now", "next")[1 + number - progress.step]
        else:
            state = "held" if glove.responder.shows(part) else "now"
        parts.append({"gesture": part.gesture, "code": part.code, "hand": part.hand, "state": state})
    return parts


def _hold(glove: Glove) -> dict[str, Any]:
    """Return how long the gesture, or the part that is due, has been held.

    `outcome` is the answer that the gesture would give to the Task; null if it is no answer.
    """
    hold, timing, is_connected = glove.reader.state.hold, glove.reader.config.timing, glove.is_connected
    held_ms, confirm_ms = 0.0 if hold.is_spent else hold.held_ms, timing.confirm_ms
    prompt = glove.responder.prompt
    outcome = prompt.spec.outcome_of(hold.gesture) if prompt is not None and is_connected else None
    if prompt is not None and prompt.spec.composite is not None and outcome in {None, Outcome.OK}:
        held_ms = prompt.progress.held_ms
        if isinstance(prompt.progress, SequenceProgress):
            confirm_ms = second_ms(timing) if prompt.progress.step else timing.announce_ms
    return {
        "gesture": hold.gesture if is_connected else None,
        "heldMs": round(held_ms) if is_connected else 0,
        "announceMs": min(timing.announce_ms, confirm_ms),
        "confirmMs": confirm_ms,
        "spent": is_connected and hold.is_spent,
        "outcome": outcome.value if outcome is not None else None,
    }


def _answered(glove: Glove) -> dict[str, Any] | None:
    """Return the last answer of this hand or its screen, so that no screen misses a fast one."""
    if glove.responder.last_answer is None:
        return None
    answer, _ = glove.responder.last_answer
    return {
        "task": answer.spec.task_id,
        "gesture": answer.gesture,
        "by": answer.by,
        "operator": answer.operator,
        "outcome": answer.outcome.value,
        "note": answer.note,
    }
