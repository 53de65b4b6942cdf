"""Alerts: something happened that a person should know of; once, however often it is said.

An Alert has a key of its own kind ("glove-1 silent"), from which its id follows. Raising it again while it
stands changes nothing; clearing it writes `validTo`; raising it after that makes it stand anew.
"""

import re
from datetime import UTC, datetime

from datamodels.entities import Alert, Severity
from datamodels.times import iso
from handover.broker import AlreadyExists, BrokerClient, NotFound
from handover.settings import Settings

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
) -> str:
    """Raise the Alert of `key` about the entity `source` and return its id; does nothing while it stands."""
    now = datetime.now(UTC)
    alert = Alert.model_validate(
        {
            "id": alert_id(settings, key),
            "category": category,
            "sub_category": sub_category,
            "severity": severity,
            "description": description,
            "date_issued": now,
            "valid_from": now,
            "alert_source": source,
        }
    )
    try:
        await broker.create(alert)
    except AlreadyExists:
        standing = await broker.retrieve(alert.id)
        if "validTo" in standing:
            await broker.delete(alert.id)
            await broker.create(alert)
    return alert.id


async def clear_alert(broker: BrokerClient, settings: Settings, *, key: str) -> None:
    """Say that the Alert of `key` is over; does nothing if it was never raised or is over already."""
    entity_id = alert_id(settings, key)
    try:
        standing = await broker.retrieve(entity_id)
    except NotFound:
        return
    if "validTo" not in standing:
        over = {"@type": "DateTime", "@value": iso(datetime.now(UTC))}
        await broker.append(entity_id, {"validTo": {"type": "Property", "value": over}})
