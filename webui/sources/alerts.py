"""Alerts as pages see them, and the acts of a person on them: acknowledge, shelve, unshelve.

The broker holds the state, so that it survives a restart and every component sees the same. What is shown is
derived from the attributes and the time: an Alert of another component may lack those of ours, and a
shelving ends by itself. When a shelving ends, this server writes the earlier state back to the broker.
"""

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Any, Final

import orjson

from datamodels.attributes import Relationship
from datamodels.entities import Alert, AlertState, DataModelError, Severity
from datamodels.times import iso
from handover.alerts import PRIORITIES
from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.errors import Problem
from handover.messages import message
from handover.telemetry import get_logger
from webui.events import EventLog, Happening, Level, in_milliseconds
from webui.sources.devices import short
from webui.sources.entities import Kind
from webui.sources.source import Source
from webui.world import World

log = get_logger(__name__)

KEPT_PAST: Final = 50
MAX_ALERTS_AT_ONCE: Final = 1000
MAX_SHELVING: Final = timedelta(days=7)
MAX_CONCURRENT_WRITES: Final = 16
ASKED_AT_ONCE: Final = 40
MAX_WAIT_S: Final = 3600.0
LEAST_PAUSE_S: Final = 0.05
RETRY_S: Final = 2.0

LEVELS: Final[Mapping[Severity, Level]] = {
    Severity.INFORMATIONAL: "info",
    Severity.LOW: "info",
    Severity.MEDIUM: "attention",
    Severity.HIGH: "stop",
    Severity.CRITICAL: "stop",
}

OURS: Final = (
    "alertState", "priority", "acknowledgedBy", "shelvedUntil", "descriptionCode", "descriptionParameters",
)  # fmt: skip
"""Attributes that we have added to Alert; another component may use these names for something else."""

AlertView = dict[str, Any]
Outcome = dict[str, Any]
Change = Callable[[Alert], Mapping[str, Any]]
"""What to write on an Alert as it is now; raises `Problem` if nothing may be written."""


class Alerts(Kind, Source):
    """Publishes Alerts to the world and writes to the broker what people do with them."""

    ngsi_type = "Alert"

    def __init__(self, world: World, events: EventLog, broker: BrokerClient) -> None:
        self._world = world
        self._events = events
        self._broker = broker
        self._digests: dict[str, int] = {}
        self._active: dict[str, Alert] = {}
        self._past: OrderedDict[str, str] = OrderedDict()
        self._due: dict[str, datetime] = {}
        self._due_changed = asyncio.Event()
        self._writing = asyncio.Lock()

    def take(self, entity: Mapping[str, Any]) -> None:
        """Take an Alert as it is now; one that has not changed costs no validation."""
        digest = hash(orjson.dumps(entity, option=orjson.OPT_SORT_KEYS))
        alert_id = str(entity.get("id"))
        if self._digests.get(alert_id) != digest:
            self._show(alert_in(entity))
            self._digests[alert_id] = digest

    def still_open(self) -> Collection[str]:
        """Return all that are known: one that is over may be raised again."""
        return self._active.keys() | self._past.keys()

    def gone(self, entity_id: str) -> None:
        """Forget an Alert."""
        self._digests.pop(entity_id, None)
        self._active.pop(entity_id, None)
        self._past.pop(entity_id, None)
        self._due.pop(entity_id, None)
        self._world.forget(f"alert/{entity_id}")

    async def follow(self) -> None:
        """End shelvings, and show what is over, when their time comes."""
        while True:
            self._due_changed.clear()
            now = datetime.now(UTC)
            due = [alert_id for alert_id, moment in self._due.items() if moment <= now]
            if due:
                await asyncio.sleep(LEAST_PAUSE_S if await self._end_shelvings(due) else RETRY_S)
                continue
            try:
                async with asyncio.timeout(self._seconds_to_next(now)):
                    await self._due_changed.wait()
            except TimeoutError:
                continue

    # Acts of people

    async def acknowledge(self, alert_id: str, by: str) -> AlertView:
        """Write that `by` has acknowledged an Alert, and return it as it is then.

        Raises `Problem`: 404 if there is none, 409 if somebody has acknowledged it.
        """
        return await self._change(alert_id, lambda alert: _acknowledgement(alert, by))

    async def acknowledge_many(self, alert_ids: Sequence[str], by: str) -> Outcome:
        """Acknowledge many Alerts; return `done` (their ids) and `failed` (each with the reason)."""
        return await self._change_many(alert_ids, lambda alert: _acknowledgement(alert, by))

    async def shelve_many(self, alert_ids: Sequence[str], by: str, until: datetime) -> Outcome:
        """Shelve many Alerts until a moment; return `done` and `failed`."""
        return await self._change_many(alert_ids, lambda alert: _shelving(alert, by, until))

    async def unshelve_many(self, alert_ids: Sequence[str], by: str) -> Outcome:
        """End the shelving of many Alerts now; return `done` and `failed`."""
        return await self._change_many(alert_ids, lambda alert: _unshelving(alert, by))

    # Within

    async def _change(self, alert_id: str, change: Change) -> AlertView:
        async with self._writing:
            try:
                alert = alert_in(await self._broker.retrieve(alert_id))
            except NotFound:
                raise self._missing(alert_id) from None
            return await self._write(alert, change)

    async def _change_many(self, alert_ids: Sequence[str], change: Change) -> Outcome:
        """Change Alerts, a few at a time; when the broker is away, the rest fail without another wait."""
        asked = list(dict.fromkeys(alert_ids))
        slots = asyncio.Semaphore(MAX_CONCURRENT_WRITES)
        away: list[Problem] = []

        async def failure(alert_id: str, alert: Alert | None) -> Outcome | None:
            async with slots:
                try:
                    if away:
                        raise away[0]
                    if alert is None:
                        raise self._missing(alert_id)
                    await self._write(alert, change)
                except Problem as problem:
                    if isinstance(problem, BrokerUnavailable) and not away:
                        away.append(problem)
                    return {**problem.body(), "alert": alert_id}
            return None

        async with self._writing:
            found: dict[str, Alert] = {}
            for start in range(0, len(asked), ASKED_AT_ONCE):
                ids = asked[start : start + ASKED_AT_ONCE]
                for entity in await self._broker.query(type=Alert.ngsi_type(), id=ids):
                    with suppress(DataModelError):  # such a one is not shown either
                        found[str(entity["id"])] = alert_in(entity)
            failures = await asyncio.gather(*(failure(each, found.get(each)) for each in asked))
        return {
            "done": [each for each, failed in zip(asked, failures, strict=True) if failed is None],
            "failed": [failed for failed in failures if failed is not None],
        }

    async def _write(self, alert: Alert, change: Change) -> AlertView:
        attributes = change(alert)
        try:
            await self._broker.append(alert.id, attributes)
        except NotFound:
            raise self._missing(alert.id) from None
        changed = Alert.from_ngsild({**alert.to_normalized(), **attributes})
        self.take(changed.to_normalized())
        return view_of(changed)

    def _missing(self, alert_id: str) -> Problem:
        self.gone(alert_id)
        return Problem(
            404,
            "No such alert",
            message("alert.unknown", "there is no alert {alert}; it may have been deleted", alert=alert_id),
        )

    def _show(self, alert: Alert) -> None:
        view = view_of(alert)
        alert_id = alert.id
        if view["state"] == AlertState.RETURNED_TO_NORMAL:
            self._active.pop(alert_id, None)
            self._keep_past(alert_id, in_milliseconds(view["validTo"] or view["dateIssued"]))
        else:
            self._past.pop(alert_id, None)
            self._active[alert_id] = alert
        if alert_id in self._active or alert_id in self._past:
            self._world.tell(f"alert/{alert_id}", view)
        self._log(view)
        moment = _next_change(alert)
        if moment is None:
            self._due.pop(alert_id, None)
        elif self._due.get(alert_id) != moment:
            self._due[alert_id] = moment
            self._due_changed.set()

    async def _end_shelvings(self, due: Sequence[str]) -> bool:
        """Show the Alerts whose time has come; return whether the broker has the new states too."""
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
                log.warning("the end of a shelving could not be written", alert=alert_id, error=str(error))
                written = False
            except Problem:
                continue  # it has been deleted, or another server was first
        return written

    def _seconds_to_next(self, now: datetime) -> float:
        soonest = min(self._due.values(), default=now + timedelta(seconds=MAX_WAIT_S))
        return min(max((soonest - now).total_seconds(), 0.0), MAX_WAIT_S)

    def _keep_past(self, alert_id: str, over_at: str) -> None:
        self._past[alert_id] = over_at
        while len(self._past) > KEPT_PAST:
            oldest = min(self._past, key=self._past.__getitem__)
            del self._past[oldest]
            self._world.forget(f"alert/{oldest}")

    def _log(self, view: AlertView) -> None:
        said = view["description"]
        level = LEVELS[Severity(view["severity"])]
        self._record(view, "raised", view["dateIssued"], f"alert: {said}", level=level)
        if (known := view["acknowledged"]) is not None:
            text = f"{known['by'] or 'somebody'} acknowledged: {said}"
            self._record(view, "acknowledged", known["at"], text, by=known["by"])
        if view["state"] == AlertState.SHELVED:
            who, end = view["shelvedBy"] or "", view["shelvedUntil"] or ""
            text = f"{who or 'somebody'} shelved until {end}: {said}"
            self._record(view, "shelved", view["stateAt"] or end, text, by=who, until=end)
        elif view["shelvedUntil"] is not None and view["shelvedUntil"] <= iso(datetime.now(UTC)):
            text = f"no longer shelved: {said}"
            self._record(view, "unshelved", view["shelvedUntil"], text)
        if view["state"] == AlertState.RETURNED_TO_NORMAL:
            self._record(
                view, "over", view["validTo"] or view["stateAt"] or view["dateIssued"], f"alert over: {said}"
            )

    def _record(
        self, view: AlertView, act: str, moment: str, text: str, *, level: Level = "info", **values: str
    ) -> None:
        at = in_milliseconds(moment)
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
                    "by": "",
                    **values,
                },
            )
        )


def alert_in(entity: Mapping[str, Any]) -> Alert:
    """Return the Alert that an entity states, without attributes of ours that have another meaning in it.

    Raises `DataModelError` if the rest is no Alert either.
    """
    try:
        return Alert.from_ngsild(entity)
    except DataModelError:
        others = {name: value for name, value in entity.items() if name not in OURS}
        alert = Alert.from_ngsild(others)
        for name in OURS:
            if name in entity:
                with suppress(DataModelError):
                    alert = Alert.from_ngsild({**others, name: entity[name]})
                    others[name] = entity[name]
        return alert


def view_of(alert: Alert, now: datetime | None = None) -> AlertView:
    """Return an Alert as pages get it, `now` or at this moment; what it does not state is derived."""
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
    """Return the state at a moment: what has ended by then counts as ended, whatever is written."""
    written = alert.alert_state.value if alert.alert_state else None
    if alert.valid_to is not None and alert.valid_to.value <= now:
        return AlertState.RETURNED_TO_NORMAL
    if written is AlertState.RETURNED_TO_NORMAL:
        return AlertState.RETURNED_TO_NORMAL
    if written is AlertState.SHELVED and (alert.shelved_until is None or alert.shelved_until.value > now):
        return AlertState.SHELVED
    return AlertState.NEW if _acknowledged(alert) is None else AlertState.ACKNOWLEDGED


def _acknowledged(alert: Alert) -> dict[str, str] | None:
    """Return by whom and when it was acknowledged: as we write it, or as another component may have."""
    verified, state, person = alert.human_verified, alert.alert_state, alert.acknowledged_by
    is_verified = verified is not None and verified.value
    is_acknowledged = state is not None and state.value is AlertState.ACKNOWLEDGED
    if not (is_verified or is_acknowledged or person is not None):
        return None
    by = _by(verified)
    if not by and person is not None:
        by = short(person.object) if isinstance(person, Relationship) else person.value
    seen = (verified.observed_at if verified else None) or (state.observed_at if state else None)
    return {"by": by, "at": iso(seen or alert.date_issued.value)}


def _next_change(alert: Alert) -> datetime | None:
    """Return when time alone will change the state, None if it will not."""
    now = datetime.now(UTC)
    moments = [alert.valid_to.value] if alert.valid_to else []
    if alert.shelved_until and alert.alert_state and alert.alert_state.value is AlertState.SHELVED:
        if state_of(alert, now) not in {AlertState.SHELVED, AlertState.RETURNED_TO_NORMAL}:
            return alert.shelved_until.value  # it has ended, and the broker does not have that yet
        moments.append(alert.shelved_until.value)
    return min((moment for moment in moments if moment > now), default=None)


def _acknowledgement(alert: Alert, by: str) -> Mapping[str, Any]:
    view = view_of(alert)
    known = view["acknowledged"]
    if known is not None:
        raise Problem(
            409,
            "Acknowledged already",
            message(
                "alert.acknowledged",
                "{by} acknowledged it at {at}; nothing more is needed",
                by=known["by"] or "somebody",
                at=known["at"],
            ),
            extra={"acknowledged": known},
        )
    verified = {**_property(True), "observedAt": iso(datetime.now(UTC)), "by": _property(by)}
    is_person = by.startswith("urn:ngsi-ld:Person:")
    who = {"type": "Relationship", "object": by} if is_person else _property(by)
    written = {"humanVerified": verified, "acknowledgedBy": who}
    # A shelved Alert stays shelved, and one that is over stays so.
    return (
        {**written, "alertState": _state(AlertState.ACKNOWLEDGED, by)} if view["state"] == "new" else written
    )


def _shelving(alert: Alert, by: str, until: datetime) -> Mapping[str, Any]:
    if state_of(alert, datetime.now(UTC)) is AlertState.RETURNED_TO_NORMAL:
        over = message("alert.over", "the alert has returned to normal; it needs no shelving")
        raise Problem(409, "Over already", over)
    return {"alertState": _state(AlertState.SHELVED, by), "shelvedUntil": _moment(until)}


def _unshelving(alert: Alert, by: str) -> Mapping[str, Any]:
    if state_of(alert, datetime.now(UTC)) is not AlertState.SHELVED:
        unshelved = message("alert.not_shelved", "the alert is not shelved; nothing more is needed")
        raise Problem(409, "Not shelved", unshelved)
    return {"alertState": _state(_unshelved(alert), by), "shelvedUntil": _moment(datetime.now(UTC))}


def _end_of_shelving(alert: Alert) -> Mapping[str, Any]:
    if _next_change(alert) is None or state_of(alert, datetime.now(UTC)) is AlertState.SHELVED:
        changed = message("alert.changed", "the alert was changed when its shelving ended")
        raise Problem(409, "Changed meanwhile", changed)
    return {"alertState": _state(_unshelved(alert), "")}


def _unshelved(alert: Alert) -> AlertState:
    return AlertState.NEW if _acknowledged(alert) is None else AlertState.ACKNOWLEDGED


def _state(state: AlertState, by: str) -> dict[str, Any]:
    written = {"type": "Property", "value": state.value, "observedAt": iso(datetime.now(UTC))}
    return {**written, "by": _property(by)} if by else written


def _property(value: Any) -> dict[str, Any]:
    return {"type": "Property", "value": value}


def _moment(moment: datetime) -> dict[str, Any]:
    return _property({"@type": "DateTime", "@value": iso(moment)})


def _by(attribute: Any) -> str:
    """Return the text of the sub-attribute `by`, "" if there is none."""
    who = (attribute.model_extra or {}).get("by") if attribute is not None else None
    return str(who.get("value", "")) if isinstance(who, Mapping) else ""
