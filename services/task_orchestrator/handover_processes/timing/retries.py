"""Retries: whether and when a failed Task is posted again.

Every failure is retried but one whose error code an event catches, which occurs at once. A policy that names
codes retries those, also if they are caught; the event then catches the last failure. Failures that nobody
may repeat without a decision are never retried: an unknown outcome, a cancelled Task, and one that the broker
has rejected.
"""

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any

from handover.tasks.outcomes import is_outcome_unknown
from handover_bpmn.languages.base import ExpressionError, Variables
from handover_bpmn.model import RetryPolicy

MAX_DELAY_S = 30 * 86_400.0
_NEVER = frozenset({"task.refused_by_broker", "task.definition_refused", "task.specification_refused"})


def is_retried(policy: RetryPolicy, code: str | None, outputs: Mapping[str, Any], *, is_caught: bool) -> bool:
    """Return whether a failure may be retried; `is_caught` if an event catches its code."""
    if is_outcome_unknown(outputs) or outputs.get("reason") == "cancelled":
        return False
    if outputs.get("reasonCode") in _NEVER:
        return False
    if policy.codes is not None:
        return code in policy.codes
    return code is None or not is_caught


def attempts_of(policy: RetryPolicy, variables: Variables) -> int:
    """Return how often an activity is tried in all; 1 if the number cannot be evaluated."""
    try:
        attempts = policy.attempts.value(variables)
    except ExpressionError:
        return 1
    return int(attempts) if isinstance(attempts, int | float) and not isinstance(attempts, bool) else 1


def retry_at(policy: RetryPolicy, failed: int, now: datetime) -> datetime:
    """Return when the Task is posted again after `failed` attempts."""
    if not policy.delays:
        return now
    listed = policy.delays[min(failed, len(policy.delays)) - 1]
    limit_s = MAX_DELAY_S if policy.max_delay is None else min(policy.max_delay.nominal_s, MAX_DELAY_S)
    delay_s = listed.nominal_s
    for _ in range(failed - len(policy.delays)):
        if delay_s >= limit_s or policy.factor == 1:
            break
        delay_s *= policy.factor
    return now + timedelta(seconds=min(delay_s, limit_s))
