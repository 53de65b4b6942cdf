"""Alerts: raised and cleared as entities; their catalogue."""

from handover.alerts.raising import (
    PRIORITIES,
    alert_id,
    clear_alert,
    raise_alert,
    unshown_key,
)

__all__ = [
    "PRIORITIES",
    "alert_id",
    "clear_alert",
    "raise_alert",
    "unshown_key",
]
