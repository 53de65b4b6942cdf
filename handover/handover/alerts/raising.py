"""Raise and clear Alerts; the states follow ISA-18.2.

The id of an Alert is derived from its key, such as "glove-1 silent". Raising an active Alert again changes
nothing. Clearing it writes `validTo` and the state `returnedToNormal`. Raising it after that makes it `new`
again, without the earlier acknowledgement; a shelving that has not ended still applies.
"""

import re
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any, Final

from handover.alerts.catalogue import AlertType
from handover.broker import AlreadyExists, BrokerClient, NotFound
from handover.messages import with_code
from handover.settings import Settings
from handover_datamodels.entities import Alert, AlertPriority, AlertState, DataModelError, Severity
from handover_datamodels.times import iso

PRIORITIES: Final[Mapping[Severity, AlertPriority]] = {
    Severity.INFORMATIONAL: AlertPriority.LOW,
    Severity.LOW: AlertPriority.LOW,
    Severity.MEDIUM: AlertPriority.MEDIUM,
    Severity.HIGH: AlertPriority.HIGH,
    Severity.CRITICAL: AlertPriority.CRITICAL,
}
"""The priority of an Alert for which none is given."""

_NOT_IN_IDS = re.compile(r"[^A-Za-z0-9_.-]+")


def alert_id(settings: Settings, key: str) -> str:
    """Return the id of the Alert with `key`."""
    return settings.entity_id("Alert", _NOT_IN_IDS.sub("-", key).strip("-"))


def unshown_key(task_id: str) -> str:
    """Return the key of the Alert that a Task asks for an unknown gesture.

    The gesture controller raises it before it fails the Task. The orchestrator clears it when a person has
    dealt with the incident of the Task, at once if the process continues without a person.
    """
    return f"{task_id.rsplit(':', 1)[-1]} cannot be shown"


async def raise_alert(
    broker: BrokerClient,
    settings: Settings,
    alert_type: AlertType,
    *,
    key: str,
    source: str,
    description: str,
    priority: AlertPriority | str | None = None,
) -> str:
    """Raise the Alert of `key` about the entity `source` and return its id; do nothing while it is active.

    Without `priority` the severity determines it. A `description` that is a `Message` keeps its code.
    """
    now = datetime.now(UTC)
    described = with_code("description", description)
    values = {
        "id": alert_id(settings, key),
        "category": alert_type.category,
        "sub_category": alert_type.sub_category,
        "severity": alert_type.severity,
        "priority": priority or PRIORITIES[alert_type.severity],
        "alert_state": AlertState.NEW,
        "description": described["description"],
        "description_code": described.get("descriptionCode"),
        "description_parameters": described.get("descriptionParameters"),
        "date_issued": now,
        "valid_from": now,
        "alert_source": source,
    }
    alert = Alert.model_validate(values)
    try:
        await broker.create(alert)
    except AlreadyExists:
        earlier = await broker.retrieve(alert.id)
        if "validTo" in earlier:
            shelving = _remaining_shelving(earlier, now)
            await broker.delete(alert.id)
            await broker.create({**alert.to_normalized(), **shelving})
    return alert.id


def _remaining_shelving(earlier: Mapping[str, Any], now: datetime) -> Mapping[str, Any]:
    """Return the attributes of a shelving that has not ended; none if there is no such shelving."""
    with suppress(DataModelError):
        until = Alert.from_ngsild(earlier).shelved_until
        if until is not None and until.value > now:
            state = {"type": "Property", "value": AlertState.SHELVED.value, "observedAt": iso(now)}
            return {"alertState": state, "shelvedUntil": until.to_normalized()}
    return {}


async def clear_alert(broker: BrokerClient, settings: Settings, *, key: str) -> None:
    """Return the Alert of `key` to normal; do nothing if it is not active."""
    entity_id = alert_id(settings, key)
    try:
        active = await broker.retrieve(entity_id)
    except NotFound:
        return
    if "validTo" not in active:
        now = iso(datetime.now(UTC))
        normal = {"type": "Property", "value": AlertState.RETURNED_TO_NORMAL.value, "observedAt": now}
        over = {"type": "Property", "value": {"@type": "DateTime", "@value": now}}
        await broker.append(entity_id, {"validTo": over, "alertState": normal})
