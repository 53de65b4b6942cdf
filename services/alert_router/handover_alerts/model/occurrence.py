"""Which messages about an Alert are due: pure functions with the time as an argument.

An occurrence is an Alert from when it was raised until it returned to normal; raised again it is another one.
Each message is a step of a route: `raised`, `escalation-N`, `cleared`. The steps that were taken are stored
with the messages in one transaction, so that each is taken once, also after `kill -9`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Final

from handover_alerts.model.configuration import SEVERITIES, Route, matches
from handover_datamodels.states import AlertState, Severity

RAISED: Final = "raised"
CLEARED: Final = "cleared"
MAX_AGE: Final = timedelta(hours=24)
"""An Alert that is older when the router first sees it is not sent."""


@dataclass(frozen=True, slots=True)
class AlertView:
    """What messages say about an Alert."""

    id: str
    category: str
    sub_category: str
    severity: Severity
    source: str
    place: str
    description: str
    state: AlertState
    issued: datetime
    is_active: bool


@dataclass(slots=True)
class Occurrence:
    """An Alert and the steps that were taken: when, by route and step."""

    alert: AlertView
    taken: dict[str, datetime] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DueStep:
    """A step to take: its key in `Occurrence.taken`, and the channels of its messages."""

    key: str
    step: str
    channels: tuple[str, ...]


def concerns(route: Route, alert: AlertView) -> bool:
    """Return whether a route includes an Alert, at whatever time."""
    return (
        route.enabled
        and SEVERITIES.index(alert.severity) >= SEVERITIES.index(route.minimum_severity)
        and matches(route.categories, alert.category)
        and matches(route.sub_categories, alert.sub_category)
        and matches(route.sources, alert.source)
        and matches(route.places, alert.place)
    )


def due_steps(occurrence: Occurrence, routes: Mapping[str, Route], now: datetime) -> Iterator[DueStep]:
    """Yield the steps that are due now."""
    alert, taken = occurrence.alert, occurrence.taken
    for name, route in routes.items():
        if not concerns(route, alert):
            continue
        raised_at = taken.get(f"{name}:{RAISED}")
        if raised_at is None:
            may_send = alert.is_active and alert.state is AlertState.NEW and now - alert.issued < MAX_AGE
            if may_send and route.is_open(now) and not route.is_quiet(now, alert.severity):
                yield DueStep(f"{name}:{RAISED}", RAISED, route.channels)
        elif not alert.is_active:
            if route.send_cleared and f"{name}:{CLEARED}" not in taken:
                yield DueStep(f"{name}:{CLEARED}", CLEARED, route.channels)
        elif alert.state is AlertState.NEW:  # neither acknowledged nor shelved
            for number, escalation in enumerate(route.escalations, 1):
                step = f"escalation-{number}"
                is_late = now >= raised_at + timedelta(seconds=escalation.after_s)
                if is_late and f"{name}:{step}" not in taken:
                    yield DueStep(f"{name}:{step}", step, escalation.channels)
