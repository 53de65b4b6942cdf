"""REST of Alerts: acknowledge and shelve them."""

from datetime import UTC, datetime, timedelta
from typing import Annotated

from fastapi import FastAPI
from pydantic import ConfigDict, Field

from handover.formats.strict_json import StrictModel
from handover.http.body_limit import max_body
from handover.security.caller import Caller, CallerKind
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_web.live.views import AlertsResult, AlertView
from handover_web.sources.alerts import MAX_ALERTS_AT_ONCE, MAX_SHELVING, Alerts

MAX_ALERTS_BODY_BYTES = 256 * 1024
"""Enough for the ids of `MAX_ALERTS_AT_ONCE` Alerts."""

Acknowledger = Annotated[Caller, require(Permission.ACKNOWLEDGE_ALERTS)]

Ids = Annotated[
    list[Annotated[str, Field(min_length=1, max_length=2000)]],
    Field(min_length=1, max_length=MAX_ALERTS_AT_ONCE),
]


class AcknowledgeRequest(StrictModel):
    """The person who acknowledges an alert."""

    model_config = ConfigDict(extra="forbid")

    by: Annotated[str, Field(min_length=1, max_length=100, pattern=r"\S")]


class AlertsRequest(AcknowledgeRequest):
    """Alerts, and the person who acts on them."""

    alerts: Ids


class ShelveRequest(AlertsRequest):
    """Alerts to shelve, and the duration."""

    minutes: Annotated[float, Field(gt=0, le=MAX_SHELVING.total_seconds() / 60)]


def add_alerts(app: FastAPI, alerts: Alerts) -> None:
    """Add the routes."""

    @app.post("/api/alerts/{alert}/acknowledge", tags=["alerts"])
    async def acknowledge(caller: Acknowledger, alert: str, body: AcknowledgeRequest) -> AlertView:
        """Acknowledge an alert: 404 for an unknown one, 409 if it is acknowledged already."""
        return await alerts.acknowledge(alert, _name(caller, body))

    @app.post("/api/alerts/acknowledge", tags=["alerts"])
    @max_body(MAX_ALERTS_BODY_BYTES)
    async def acknowledge_many(caller: Acknowledger, body: AlertsRequest) -> AlertsResult:
        """Acknowledge alerts: `done` lists ids, `failed` the others with problem details."""
        return await alerts.acknowledge_many(body.alerts, _name(caller, body))

    @app.post("/api/alerts/shelve", tags=["alerts"])
    @max_body(MAX_ALERTS_BODY_BYTES)
    async def shelve(caller: Acknowledger, body: ShelveRequest) -> AlertsResult:
        """Shelve alerts for some minutes, after which they return by themselves."""
        until = datetime.now(UTC) + timedelta(minutes=body.minutes)
        return await alerts.shelve_many(body.alerts, _name(caller, body), until)

    @app.post("/api/alerts/unshelve", tags=["alerts"])
    @max_body(MAX_ALERTS_BODY_BYTES)
    async def unshelve(caller: Acknowledger, body: AlertsRequest) -> AlertsResult:
        """End the shelving of alerts now."""
        return await alerts.unshelve_many(body.alerts, _name(caller, body))


def _name(caller: Caller, body: AcknowledgeRequest) -> str:
    """Return who acts: the user, or in local mode the name that the page asked for."""
    return body.by.strip() if caller.kind is CallerKind.LOCAL else caller.name
