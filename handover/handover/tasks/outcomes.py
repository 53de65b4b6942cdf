"""Outcomes: the reason of a Task that fails because of its outcome."""

from collections.abc import Mapping
from typing import Any

from handover.messages import Message, message
from handover_datamodels.states import Outcome

OUTCOME_UNKNOWN = "outcome unknown"
"""How the reason of a failed Task begins if nobody knows whether the act was done."""

OUTCOME_UNKNOWN_CODE = "outcomeUnknown"
"""The error code of such a failure, unless its performer gives another one."""


def outcome_unknown(why: str) -> Message:
    """Return the reason of a failed Task whose performer does not know whether the act was done.

    Such a Task is never posted again without a decision of a person. Only an error event that names the code
    catches it.
    """
    return message("task.outcome_unknown", "outcome unknown: {why}", why=why)


def is_outcome_unknown(outputs: Mapping[str, Any]) -> bool:
    """Return whether the performer of a failed Task does not know whether the act was done."""
    reason = outputs.get("reason")
    is_named = isinstance(reason, str) and reason.strip().lower().startswith(OUTCOME_UNKNOWN)
    return is_named or outputs.get("reasonCode") == "task.outcome_unknown"


def reason_of(outcome: str, note: str | None) -> Message:
    """Return the reason for the failure of a Task with this `outcome` (other than `ok`) and `note`."""
    if outcome == Outcome.NOT_GOOD:
        if note:
            return message("task.not_good_because", 'answered "not good": {note}', note=note)
        return message("task.not_good", 'answered "not good"')
    if outcome == Outcome.PROBLEM:
        if note:
            return message("task.problem_because", 'answered "problem": {note}', note=note)
        return message("task.problem", 'answered "problem"')
    return message(
        "task.other_outcome", 'the process does not handle the outcome "{outcome}"', outcome=outcome
    )
