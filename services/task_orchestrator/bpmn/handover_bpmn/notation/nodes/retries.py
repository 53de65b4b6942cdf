"""Retries: how often the failed Task of an activity is posted again, in all dialects.

    <handover:retry attempts="5" delay="PT10S" factor="2" maxDelay="PT5M" codes="gripFailed notGood"/>

`failedJobRetryTimeCycle` of Camunda 7 (`R3/PT10M`, or a list of delays such as `PT1M,PT5M`) and `retries` of
a `taskDefinition` of Camunda 8 mean the same as there: the number of attempts, or the delays between them.
"""

from collections.abc import Mapping

from lxml import etree

from handover.formats.durations import parse_duration
from handover_bpmn.model import RetryPolicy, Value
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.base import attempt
from handover_bpmn.notation.dialects.handover_elements import extension_of
from handover_bpmn.notation.elements import warn_without_effect
from handover_bpmn.timing.timers import RepeatingInterval, parse_cycle

MAX_ATTEMPTS = 1000
MAX_FACTOR = 100.0


def read_retry(element: etree._Element, hints: Mapping[str, str], context: Context) -> RetryPolicy | None:
    """Return the retry policy of an activity; ours decides if a file has several."""
    findings = context.findings
    ours = extension_of(element, "retry", findings)
    if ours is not None:
        return attempt(ours, lambda: _ours(ours), None, findings)
    if "retry" in hints:
        cycle = hints["retry"]
        policy = attempt(element, lambda: _cycle(cycle), None, findings) if "{" not in cycle else None
        if policy is None and element.get("id") not in findings.broken:
            warn_without_effect(element, findings, f"failedJobRetryTimeCycle {cycle[:64]}")
        return policy
    if "retries" in hints:
        return attempt(element, lambda: RetryPolicy(_attempts(context, hints["retries"])), None, findings)
    return None


def _ours(extension: etree._Element) -> RetryPolicy:
    attempts = _number(extension, "attempts", 3)
    factor = float(_number(extension, "factor", 1))
    if not 1 <= factor <= MAX_FACTOR:
        raise ValueError(f'factor="{factor:g}" is not between 1 and {MAX_FACTOR:g}')
    if not 1 <= attempts <= MAX_ATTEMPTS or attempts != int(attempts):
        raise ValueError(f'attempts="{attempts:g}" is no whole number from 1 to {MAX_ATTEMPTS}')
    longest = extension.get("maxDelay")
    codes = extension.get("codes")
    return RetryPolicy(
        Value(int(attempts)),
        (parse_duration((extension.get("delay") or "PT0S").strip()),),
        factor,
        None if longest is None else parse_duration(longest.strip()),
        None if codes is None else frozenset(codes.split()),
    )


def _number(extension: etree._Element, name: str, default: float) -> float:
    text = extension.get(name)
    try:
        return default if text is None else float(text)
    except ValueError:
        raise ValueError(f'{name}="{text}" is no number') from None


def _cycle(text: str) -> RetryPolicy:
    if not text.lstrip().startswith("R"):
        delays = tuple(parse_duration(delay.strip()) for delay in text.split(","))
        return RetryPolicy(Value(len(delays) + 1), delays)
    cycle = parse_cycle(text)
    if not isinstance(cycle, RepeatingInterval) or cycle.count is None or cycle.start or cycle.end:
        raise ValueError(f'"{text[:64]}" is no retry cycle such as R3/PT10M or PT1M,PT5M')
    return RetryPolicy(Value(min(cycle.count, MAX_ATTEMPTS)), (cycle.interval,))


def _attempts(context: Context, text: str) -> Value:
    text = text.strip()
    if text.isascii() and text.isdecimal():
        return Value(min(max(int(text[:9]), 1), MAX_ATTEMPTS))
    return context.dialects.main.value(text)
