"""Alerts: what pages show of them, and the actions acknowledge, shelve and unshelve.

The broker stores the state, so it survives a restart and all components see the same. The view is derived
from the attributes and the time, because an Alert of another component may lack ours, and a shelving ends by
itself. When a shelving ends, this server writes the earlier state back to the broker.
"""

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Any, Final, cast

import orjson

from handover.alerts import PRIORITIES
from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.errors import Problem
from handover.messages import message
from handover.runtime.retry import Backoff
from handover.telemetry import get_logger
from handover_datamodels.attributes import Relationship
from handover_datamodels.entities import Alert, AlertState, DataModelError, Severity
from handover_datamodels.times import iso
from handover_web.live.event_log import Event, EventLog, Level, normalized_timestamp
from handover_web.live.live_state import LiveState
from handover_web.live.views import AcknowledgementView, AlertProblem, AlertsResult, AlertView
from handover_web.sources.broker_entities import EntityHandler
from handover_web.sources.devices import short_name
from handover_web.sources.source import Source

log = get_logger(__name__)

MAX_PAST_ALERTS: Final = 50
MAX_ALERTS_AT_ONCE: Final = 1000
MAX_SHELVING: Final = timedelta(days=7)
MAX_CONCURRENT_WRITES: Final = 16
QUERY_BATCH_SIZE: Final = 40
MAX_WAIT_S: Final = 3600.0
MIN_INTERVAL_S: Final = 0.05
INITIAL_RETRY_S, MAX_RETRY_S = 0.5, 2.0

LEVELS: Final[Mapping[Severity, Level]] = {
    Severity.INFORMATIONAL: "info",
    Severity.LOW: "info",
    Severity.MEDIUM: "attention",
    Severity.HIGH: "stop",
    Severity.CRITICAL: "stop",
}

OWN_ATTRIBUTES: Final = (
    "alertState", "priority", "acknowledgedBy", "shelvedUntil", "descriptionCode", "descriptionParameters",
)  # fmt: skip
"""Attributes added to the published Alert model; other components may use these names otherwise."""

Change = Callable[[Alert], Mapping[str, Any]]
"""Returns the attributes to write for the current Alert; raises `Problem` if the action is not allowed."""


class Alerts(EntityHandler, Source):
    """Publishes Alerts, and writes the actions of people to the broker."""

    ngsi_type = "Alert"

    def __init__(
        self,
        state: LiveState,
        events: EventLog,
        broker: BrokerClient,
        on_process: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._state = state
        self._events = events
        self._broker = broker
        self._on_process = on_process
        """Called with the URN of a process when an Alert about it has changed."""
        self._digests: dict[str, int] = {}
        self._active: dict[str, Alert] = {}
        self._past: OrderedDict[str, str] = OrderedDict()
        self._due: dict[str, datetime] = {}
        self._due_changed = asyncio.Event()
        self._writing = asyncio.Lock()

    def update(self, entity: Mapping[str, Any]) -> None:
        """Handle the current state of an Alert; an unchanged one is not validated again."""
        digest = hash(orjson.dumps(entity, option=orjson.OPT_SORT_KEYS))
        alert_id = str(entity.get("id"))
        if self._digests.get(alert_id) != digest:
            self._show(alert_in(entity))
            self._digests[alert_id] = digest

    def active_ids(self) -> Collection[str]:
        """Return all known Alerts: one that returned to normal may be raised again."""
        return self._active.keys() | self._past.keys()

    def remove(self, entity_id: str) -> None:
        """Forget an Alert."""
        self._digests.pop(entity_id, None)
        self._active.pop(entity_id, None)
        self._past.pop(entity_id, None)
        self._due.pop(entity_id, None)
        self._state.remove(f"alert/{entity_id}")

    async def run(self) -> None:
        """Publish Alerts when their shelving or their validity ends."""
        backoff = Backoff(INITIAL_RETRY_S, MAX_RETRY_S)
        while True:
            self._due_changed.clear()
            now = datetime.now(UTC)
            due = [alert_id for alert_id, timestamp in self._due.items() if timestamp <= now]
            if due:
                if await self._end_shelvings(due):
                    backoff.reset()
                    await asyncio.sleep(MIN_INTERVAL_S)
                else:
                    await backoff.wait()
                continue
            try:
                async with asyncio.timeout(self._seconds_to_next(now)):
                    await self._due_changed.wait()
            except TimeoutError:
                continue

    async def acknowledge(self, alert_id: str, by: str) -> AlertView:
        """Acknowledge an Alert as `by`, and return its view.

        Raises `Problem`: 404 for an unknown Alert, 409 if it is acknowledged already.
        """
        return await self._change(alert_id, lambda alert: _acknowledgement(alert, by))

    async def acknowledge_many(self, alert_ids: Sequence[str], by: str) -> AlertsResult:
        """Acknowledge Alerts; return `done` (ids) and `failed` (problem details with the id as `alert`)."""
        return await self._change_many(alert_ids, lambda alert: _acknowledgement(alert, by))

    async def shelve_many(self, alert_ids: Sequence[str], by: str, until: datetime) -> AlertsResult:
        """Shelve Alerts until a time; return `done` and `failed`."""
        return await self._change_many(alert_ids, lambda alert: _shelving(alert, by, until))

    async def unshelve_many(self, alert_ids: Sequence[str], by: str) -> AlertsResult:
        """End the shelving of Alerts now; return `done` and `failed`."""
        return await self._change_many(alert_ids, lambda alert: _unshelving(alert, by))

    async def _change(self, alert_id: str, change: Change) -> AlertView:
        async with self._writing:
            try:
                alert = alert_in(await self._broker.retrieve(alert_id))
            except (NotFound, DataModelError):  # what is no Alert is on no page, either
                raise self._missing(alert_id) from None
            return await self._write(alert, change)

    async def _change_many(self, alert_ids: Sequence[str], change: Change) -> AlertsResult:
        """Change Alerts concurrently; once the broker is unreachable, the rest fail at once."""
        requested = list(dict.fromkeys(alert_ids))
        slots = asyncio.Semaphore(MAX_CONCURRENT_WRITES)
        unreachable: list[Problem] = []

        async def failure(alert_id: str, alert: Alert | None) -> AlertProblem | None:
            async with slots:
                try:
                    if unreachable:
                        raise unreachable[0]
                    if alert is None:
                        raise self._missing(alert_id)
                    await self._write(alert, change)
                except Problem as problem:
                    if isinstance(problem, BrokerUnavailable) and not unreachable:
                        unreachable.append(problem)
                    return cast("AlertProblem", {**problem.body(), "alert": alert_id})
            return None

        async with self._writing:
            alerts_by_id: dict[str, Alert] = {}
            for start in range(0, len(requested), QUERY_BATCH_SIZE):
                ids = requested[start : start + QUERY_BATCH_SIZE]
                for entity in await self._broker.query(type=Alert.ngsi_type(), id=ids):
                    with suppress(DataModelError):  # pages do not show it either
                        alerts_by_id[str(entity["id"])] = alert_in(entity)
            failures = await asyncio.gather(*(failure(alert, alerts_by_id.get(alert)) for alert in requested))
        return {
            "done": [alert for alert, failed in zip(requested, failures, strict=True) if failed is None],
            "failed": [failed for failed in failures if failed is not None],
        }

    async def _write(self, alert: Alert, change: Change) -> AlertView:
        attributes = change(alert)
        try:
            await self._broker.append(alert.id, attributes)
        except NotFound:
            raise self._missing(alert.id) from None
        changed = Alert.from_ngsild({**alert.to_normalized(), **attributes})
        self.update(changed.to_normalized())
        return view_of(changed)

    def _missing(self, alert_id: str) -> Problem:
        self.remove(alert_id)
        return Problem(
            404,
            "No such alert",
            message("alert.unknown", "there is no alert {alert}; it may have been deleted", alert=alert_id),
        )

    def _show(self, alert: Alert) -> None:
        view = view_of(alert)
        alert_id = alert.id
        if view["state"] == "returnedToNormal":
            self._active.pop(alert_id, None)
            self._keep_past(alert_id, normalized_timestamp(view["validTo"] or view["dateIssued"]))
        else:
            self._past.pop(alert_id, None)
            self._active[alert_id] = alert
        if alert_id in self._active or alert_id in self._past:
            self._state.publish(f"alert/{alert_id}", view, (alert_id, view["source"]))
        self._log(view)
        if ":Process:" in view["source"]:
            self._on_process(view["source"])
        timestamp = _next_change(alert)
        if timestamp is None:
            self._due.pop(alert_id, None)
        elif self._due.get(alert_id) != timestamp:
            self._due[alert_id] = timestamp
            self._due_changed.set()

    async def _end_shelvings(self, due: Sequence[str]) -> bool:
        """Publish the due Alerts; return whether their states were written to the broker."""
        written = True
        for alert_id in due:
            del self._due[alert_id]
            alert = self._active.get(alert_id)
            if alert is None:
                continue
            self._show(alert)
            if alert_id not in self._due:
                continue
            try:
                await self._change(alert_id, _end_of_shelving)
            except BrokerError as error:
                log.warning("end of shelving not written", alert=alert_id, error=str(error))
                written = False
            except Problem:
                continue  # it was deleted, or another server has written it
        return written

    def _seconds_to_next(self, now: datetime) -> float:
        soonest = min(self._due.values(), default=now + timedelta(seconds=MAX_WAIT_S))
        return min(max((soonest - now).total_seconds(), 0.0), MAX_WAIT_S)

    def _keep_past(self, alert_id: str, over_at: str) -> None:
        self._past[alert_id] = over_at
        while len(self._past) > MAX_PAST_ALERTS:
            oldest = min(self._past, key=self._past.__getitem__)
            del self._past[oldest]
            self._state.remove(f"alert/{oldest}")

    def _log(self, view: AlertView) -> None:
        description = view["description"]
        level = LEVELS[Severity(view["severity"])]
        self._record(view, "raised", view["dateIssued"], f"alert: {description}", level=level)
        if (acknowledged := view["acknowledged"]) is not None:
            text = f"{acknowledged['by'] or 'somebody'} acknowledged: {description}"
            self._record(view, "acknowledged", acknowledged["at"], text, by=acknowledged["by"])
        if view["state"] == "shelved":
            who, end = view["shelvedBy"] or "", view["shelvedUntil"] or ""
            text = f"{who or 'somebody'} shelved until {end}: {description}"
            self._record(view, "shelved", view["stateAt"] or end, text, by=who, until=end)
        elif view["shelvedUntil"] is not None and view["shelvedUntil"] <= iso(datetime.now(UTC)):
            text = f"no longer shelved: {description}"
            self._record(view, "unshelved", view["shelvedUntil"], text)
        if view["state"] == "returnedToNormal":
            self._record(
                view,
                "over",
                view["validTo"] or view["stateAt"] or view["dateIssued"],
                f"alert over: {description}",
            )

    def _record(
        self, view: AlertView, act: str, timestamp: str, text: str, *, level: Level = "info", **values: str
    ) -> None:
        at = normalized_timestamp(timestamp)
        self._events.record(
            Event(
                subject=view["id"],
                mark=f"{act}@{at}",
                key=f"alert.{act}",
                source=short_name(view["source"]),
                text=text,
                at=at,
                level=level,
                values={
                    "alert": view["id"],
                    "description": view["description"],
                    "category": view["category"],
                    "subCategory": view["subCategory"] or "",
                    "by": "",
                    **values,
                },
            ),
            # An Alert that is older than the log, but has not returned to normal, concerns the reader now.
            is_current=view["state"] != "returnedToNormal",
        )


def alert_in(entity: Mapping[str, Any]) -> Alert:
    """Return the Alert of an entity, without those of `OWN_ATTRIBUTES` that have another meaning in it.

    Raises `DataModelError` if the entity is not a valid Alert even without them.
    """
    try:
        return Alert.from_ngsild(entity)
    except DataModelError:
        others = {name: value for name, value in entity.items() if name not in OWN_ATTRIBUTES}
        alert = Alert.from_ngsild(others)
        for name in OWN_ATTRIBUTES:
            if name in entity:
                with suppress(DataModelError):
                    alert = Alert.from_ngsild({**others, name: entity[name]})
                    others[name] = entity[name]
        return alert


def view_of(alert: Alert, now: datetime | None = None) -> AlertView:
    """Return an Alert as sent to pages; missing attributes are derived."""
    now = now or datetime.now(UTC)
    state = state_of(alert, now)
    severity = alert.severity.value if alert.severity else Severity.MEDIUM
    written = alert.alert_state
    return {
        "id": alert.id,
        "category": alert.category.value,
        "subCategory": alert.sub_category.value if alert.sub_category else None,
        "severity": severity.value,
        "priority": (alert.priority.value if alert.priority else PRIORITIES[severity]).value,
        "state": state.value,
        "stateAt": iso(written.observed_at) if written and written.observed_at else None,
        "description": alert.description.value if alert.description else alert.category.value,
        "descriptionCode": alert.description_code.value if alert.description_code else None,
        "descriptionParameters": alert.description_parameters.value if alert.description_parameters else {},
        "source": alert.alert_source.object,
        "dateIssued": iso(alert.date_issued.value),
        "validTo": iso(alert.valid_to.value) if alert.valid_to and alert.valid_to.value <= now else None,
        "shelvedUntil": iso(alert.shelved_until.value) if alert.shelved_until else None,
        "shelvedBy": _by(written) if state is AlertState.SHELVED else None,
        "acknowledged": _acknowledged(alert),
    }


def state_of(alert: Alert, now: datetime) -> AlertState:
    """Return the state at `now`: an end that has passed counts, whatever state is stored."""
    written = alert.alert_state.value if alert.alert_state else None
    if alert.valid_to is not None and alert.valid_to.value <= now:
        return AlertState.RETURNED_TO_NORMAL
    if written is AlertState.RETURNED_TO_NORMAL:
        return AlertState.RETURNED_TO_NORMAL
    if written is AlertState.SHELVED and (alert.shelved_until is None or alert.shelved_until.value > now):
        return AlertState.SHELVED
    return AlertState.NEW if _acknowledged(alert) is None else AlertState.ACKNOWLEDGED


def _acknowledged(alert: Alert) -> AcknowledgementView | None:
    """Return who acknowledged it and when, from our attributes or from those of another component."""
    verified, state, person = alert.human_verified, alert.alert_state, alert.acknowledged_by
    is_verified = verified is not None and verified.value
    is_acknowledged = state is not None and state.value is AlertState.ACKNOWLEDGED
    if not (is_verified or is_acknowledged or person is not None):
        return None
    by = _by(verified)
    if not by and person is not None:
        by = short_name(person.object) if isinstance(person, Relationship) else person.value
    seen = (verified.observed_at if verified else None) or (state.observed_at if state else None)
    return {"by": by, "at": iso(seen or alert.date_issued.value)}


def _next_change(alert: Alert) -> datetime | None:
    """Return when the state will change by itself, None if it will not."""
    now = datetime.now(UTC)
    timestamps = [alert.valid_to.value] if alert.valid_to else []
    if alert.shelved_until and alert.alert_state and alert.alert_state.value is AlertState.SHELVED:
        if state_of(alert, now) not in {AlertState.SHELVED, AlertState.RETURNED_TO_NORMAL}:
            return alert.shelved_until.value  # it has ended, but the broker does not know yet
        timestamps.append(alert.shelved_until.value)
    return min((timestamp for timestamp in timestamps if timestamp > now), default=None)


def _acknowledgement(alert: Alert, by: str) -> Mapping[str, Any]:
    view = view_of(alert)
    acknowledged = view["acknowledged"]
    if acknowledged is not None:
        raise Problem(
            409,
            "Already acknowledged",
            message(
                "alert.acknowledged",
                "{by} acknowledged the alert at {at}",
                by=acknowledged["by"] or "somebody",
                at=acknowledged["at"],
            ),
            extra={"acknowledged": acknowledged},
        )
    verified = {**_property(True), "observedAt": iso(datetime.now(UTC)), "by": _property(by)}
    is_person = by.startswith("urn:ngsi-ld:Person:")
    who = {"type": "Relationship", "object": by} if is_person else _property(by)
    written = {"humanVerified": verified, "acknowledgedBy": who}
    # A shelved Alert stays shelved, and one that returned to normal stays normal.
    return (
        {**written, "alertState": _state(AlertState.ACKNOWLEDGED, by)} if view["state"] == "new" else written
    )


def _shelving(alert: Alert, by: str, until: datetime) -> Mapping[str, Any]:
    if state_of(alert, datetime.now(UTC)) is AlertState.RETURNED_TO_NORMAL:
        over = message("alert.over", "the alert has returned to normal and cannot be shelved")
        raise Problem(409, "Already returned to normal", over)
    return {"alertState": _state(AlertState.SHELVED, by), "shelvedUntil": _date_time(until)}


def _unshelving(alert: Alert, by: str) -> Mapping[str, Any]:
    if state_of(alert, datetime.now(UTC)) is not AlertState.SHELVED:
        unshelved = message("alert.not_shelved", "the alert is not shelved")
        raise Problem(409, "Not shelved", unshelved)
    return {"alertState": _state(_unshelved(alert), by), "shelvedUntil": _date_time(datetime.now(UTC))}


def _end_of_shelving(alert: Alert) -> Mapping[str, Any]:
    if _next_change(alert) is None or state_of(alert, datetime.now(UTC)) is AlertState.SHELVED:
        changed = message("alert.changed", "the alert was changed before its shelving ended")
        raise Problem(409, "Changed in the meantime", changed)
    return {"alertState": _state(_unshelved(alert), "")}


def _unshelved(alert: Alert) -> AlertState:
    return AlertState.NEW if _acknowledged(alert) is None else AlertState.ACKNOWLEDGED


def _state(state: AlertState, by: str) -> dict[str, Any]:
    written = {"type": "Property", "value": state.value, "observedAt": iso(datetime.now(UTC))}
    return {**written, "by": _property(by)} if by else written


def _property(value: Any) -> dict[str, Any]:
    return {"type": "Property", "value": value}


def _date_time(timestamp: datetime) -> dict[str, Any]:
    return _property({"@type": "DateTime", "@value": iso(timestamp)})


def _by(attribute: Any) -> str:
    """Return the text of the sub-attribute `by`, "" if there is none."""
    who = (attribute.model_extra or {}).get("by") if attribute is not None else None
    return str(who.get("value", "")) if isinstance(who, Mapping) else ""
