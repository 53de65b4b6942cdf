"""Outcomes: the reason of a Task that fails because of its outcome."""

from datamodels.states import Outcome
from handover.messages import Message, message


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
