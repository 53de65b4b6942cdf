"""Raise and clear Alerts; the states follow ISA-18.2.

An Alert has a key of its own kind ("glove-1 silent"), from which its id follows. Raising it again while it
is active changes nothing. Clearing it writes `validTo` and the state `returnedToNormal`. Raising it after
that makes it `new` again, without the earlier acknowledgement; a shelving that has not ended still applies.
"""

import re
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any, Final

from datamodels.entities import Alert, AlertPriority, AlertState, DataModelError, Severity
from datamodels.times import iso
from handover.broker import AlreadyExists, BrokerClient, NotFound
from handover.messages import with_code
from handover.settings import Settings

PRIORITIES: Final[Mapping[Severity, AlertPriority]] = {
    Severity.INFORMATIONAL: AlertPriority.LOW,
    Severity.LOW: AlertPriority.LOW,
    Severity.MEDIUM: AlertPriority.MEDIUM,
    Severity.HIGH: AlertPriority.HIGH,
    Severity.CRITICAL: AlertPriority.CRITICAL,
}
"""The priority of an Alert that states only its severity."""

_NOT_IN_IDS = re.compile(r"[^A-Za-z0-9_.-]+")


def alert_id(settings: Settings, key: str) -> str:
    """Return the id of the Alert that `key` stands for."""
    return settings.entity_id("Alert", _NOT_IN_IDS.sub("-", key).strip("-"))


async def raise_alert(
    broker: BrokerClient,
    settings: Settings,
    *,
    key: str,
    source: str,
    category: str,
    description: str,
    sub_category: str | None = None,
    severity: Severity | str = Severity.HIGH,
    priority: AlertPriority | str | None = None,
) -> str:
    """Raise the Alert of `key` about the entity `source` and return its id; do nothing while it is active.

    Without `priority` the severity determines it. A `description` that is a `Message` keeps its code.
    """
    now = datetime.now(UTC)
    said = with_code("description", description)
    values = {
        "id": alert_id(settings, key),
        "category": category,
        "sub_category": sub_category,
        "severity": severity,
        "priority": priority or PRIORITIES[Severity(severity)],
        "alert_state": AlertState.NEW,
        "description": said["description"],
        "description_code": said.get("descriptionCode"),
        "description_parameters": said.get("descriptionParameters"),
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
    """Return the attributes that keep an Alert shelved which was shelved for longer than it was active."""
    with suppress(DataModelError):
        until = Alert.from_ngsild(earlier).shelved_until
        if until is not None and until.value > now:
            state = {"type": "Property", "value": AlertState.SHELVED.value, "observedAt": iso(now)}
            return {"alertState": state, "shelvedUntil": until.to_normalized()}
    return {}


async def clear_alert(broker: BrokerClient, settings: Settings, *, key: str) -> None:
    """Return the Alert of `key` to normal; do nothing if it was never raised or is over already."""
    entity_id = alert_id(settings, key)
    try:
        standing = await broker.retrieve(entity_id)
    except NotFound:
        return
    if "validTo" not in standing:
        now = iso(datetime.now(UTC))
        normal = {"type": "Property", "value": AlertState.RETURNED_TO_NORMAL.value, "observedAt": now}
        over = {"type": "Property", "value": {"@type": "DateTime", "@value": now}}
        await broker.append(entity_id, {"validTo": over, "alertState": normal})
