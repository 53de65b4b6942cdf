"""Alerts: what a person should know of, until it is over; and who has said that they know."""

import asyncio
from collections import OrderedDict
from collections.abc import Collection, Mapping
from datetime import UTC, datetime
from typing import Any, Final

from datamodels.entities import Alert, Severity
from datamodels.times import iso
from handover.broker import BrokerClient, NotFound
from handover.errors import Problem
from webui.events import EventLog, Happening, Level, in_milliseconds
from webui.sources.devices import short
from webui.sources.entities import Kind
from webui.world import World

KEPT_PAST: Final = 50

LEVELS: Final[Mapping[Severity, Level]] = {
    Severity.INFORMATIONAL: "info",
    Severity.LOW: "info",
    Severity.MEDIUM: "attention",
    Severity.HIGH: "stop",
    Severity.CRITICAL: "stop",
}

AlertView = dict[str, Any]


class Alerts(Kind):
    """Tells the world about Alerts, and writes down who acknowledges one."""

    ngsi_type = "Alert"

    def __init__(self, world: World, events: EventLog, broker: BrokerClient) -> None:
        self._world = world
        self._events = events
        self._broker = broker
        self._standing: set[str] = set()
        self._past: OrderedDict[str, str] = OrderedDict()
        self._acknowledging = asyncio.Lock()

    def take(self, entity: Mapping[str, Any]) -> None:
        """Take an Alert as it is now."""
        view = view_of(Alert.from_ngsild(entity))
        alert_id, over_at = view["id"], view["validTo"]
        if over_at is None:
            self._past.pop(alert_id, None)
            self._standing.add(alert_id)
        else:
            self._standing.discard(alert_id)
            self._keep_past(alert_id, in_milliseconds(over_at))
        if alert_id in self._standing or alert_id in self._past:
            self._world.tell(f"alert/{alert_id}", view)
        self._log(view)

    def still_open(self) -> Collection[str]:
        """Return all that are known: one that is over may yet stand anew."""
        return self._standing | self._past.keys()

    def gone(self, entity_id: str) -> None:
        """Forget an Alert."""
        self._standing.discard(entity_id)
        self._past.pop(entity_id, None)
        self._world.forget(f"alert/{entity_id}")

    async def acknowledge(self, alert_id: str, by: str) -> AlertView:
        """Write down that `by` knows of an Alert, and return it as it is then.

        Raises `Problem`: 404 if there is none, 409 if somebody has acknowledged it.
        """
        async with self._acknowledging:
            alert = await self._now(alert_id)
            known = view_of(alert)["acknowledged"]
            if known is not None:
                raise Problem(
                    409,
                    "Acknowledged already",
                    f"{known['by'] or 'somebody'} acknowledged it at {known['at']}; nothing more is needed",
                    extra={"acknowledged": known},
                )
            said = {
                "type": "Property",
                "value": True,
                "observedAt": iso(datetime.now(UTC)),
                "by": {"type": "Property", "value": by},
            }
            await self._broker.append(alert_id, {"humanVerified": said})
            alert = await self._now(alert_id)
        self.take(alert.to_normalized())
        return view_of(alert)

    async def _now(self, alert_id: str) -> Alert:
        try:
            return await self._broker.get(alert_id, Alert)
        except NotFound:
            self.gone(alert_id)
            raise Problem(
                404, "No such alert", f"there is no alert {alert_id}; it may have been deleted"
            ) from None

    def _keep_past(self, alert_id: str, over_at: str) -> None:
        self._past[alert_id] = over_at
        while len(self._past) > KEPT_PAST:
            oldest = min(self._past, key=self._past.__getitem__)
            del self._past[oldest]
            self._world.forget(f"alert/{oldest}")

    def _log(self, view: AlertView) -> None:
        issued = in_milliseconds(view["dateIssued"])
        level = LEVELS[Severity(view["severity"])]
        self._record(view, "raised", issued, f"alert: {view['description']}", level=level)
        if view["acknowledged"] is not None:
            by, at = view["acknowledged"]["by"], in_milliseconds(view["acknowledged"]["at"])
            self._record(view, "acknowledged", at, f"{by} knows of: {view['description']}", by=by)
        if view["validTo"] is not None:
            over = in_milliseconds(view["validTo"])
            self._record(view, "over", over, f"alert over: {view['description']}")

    def _record(
        self, view: AlertView, act: str, at: str, text: str, *, level: Level = "info", by: str = ""
    ) -> None:
        self._events.record(
            Happening(
                subject=view["id"],
                mark=f"{act}@{at}",
                key=f"alert.{act}",
                source=short(view["source"]),
                text=text,
                at=at,
                level=level,
                values={
                    "alert": view["id"],
                    "description": view["description"],
                    "category": view["category"],
                    "subCategory": view["subCategory"] or "",
                    "by": by,
                },
            )
        )


def view_of(alert: Alert) -> AlertView:
    """Return an Alert as pages get it."""
    verified = alert.human_verified
    acknowledged = None
    if verified is not None and verified.value:
        who = (verified.model_extra or {}).get("by")
        acknowledged = {
            "by": str(who.get("value", "")) if isinstance(who, Mapping) else "",
            "at": iso(verified.observed_at or alert.date_issued.value),
        }
    return {
        "id": alert.id,
        "category": alert.category.value,
        "subCategory": alert.sub_category.value if alert.sub_category else None,
        "severity": (alert.severity.value if alert.severity else Severity.MEDIUM).value,
        "description": alert.description.value if alert.description else alert.category.value,
        "source": alert.alert_source.object,
        "dateIssued": iso(alert.date_issued.value),
        "validTo": iso(alert.valid_to.value) if alert.valid_to else None,
        "acknowledged": acknowledged,
    }
