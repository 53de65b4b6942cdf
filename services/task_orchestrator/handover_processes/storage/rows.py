"""Rows: how records are written in the columns of the tables, and read from them."""

from collections.abc import Collection, Mapping
from datetime import datetime
from enum import StrEnum
from typing import Any

import orjson

from handover.messages import Message as MessageText
from handover.messages import message_in, with_code
from handover_bpmn.model import Fault
from handover_datamodels.entities import TaskStatus
from handover_processes.allocation.mapping import MappingTable
from handover_processes.records.messages import Message
from handover_processes.records.offers import Decision, OfferRecord, OfferStatus
from handover_processes.records.processes import (
    Act,
    ActKind,
    IncidentRecord,
    ProcessRecord,
    ReservationRecord,
    ReservationState,
    Retry,
    Unallocated,
)
from handover_processes.records.tasks import TaskAct, TaskActKind, TaskRecord
from handover_processes.tally import MAX_RESOURCE_LENGTH

_MOMENTS = frozenset(
    {
        "deployed_at",
        "started_at",
        "ended_at",
        "observed_at",
        "created_at",
        "deadline",
        "cancelled_at",
        "archived_at",
        "status_since",
        "escalates_at",
    }
)
_DOCUMENTS = frozenset(
    {
        *("parameters", "variables", "waiting", "outputs", "entity", "acts", "incidents", "declined"),
        "declined_by",
    }
)


CONSTANT_COLUMNS = frozenset({"id", "definition", "key", "parameters", "started_at", "partner", "number"})
"""Columns of a process that never change."""


def as_column(value: Any) -> Any:
    """Return a value as a column holds it; of equal length for times, so that texts have their order."""
    if isinstance(value, datetime):
        return value.isoformat(timespec="microseconds")
    if isinstance(value, Mapping | tuple):
        return orjson.dumps(value).decode()
    return str(value) if isinstance(value, StrEnum) else value


def plain_row(record: Any, *, but: Collection[str] = ()) -> dict[str, Any]:
    """Return the fields of a record, without those of `but`, as columns."""
    return {name: as_column(getattr(record, name)) for name in record.__dataclass_fields__ if name not in but}


def mapping_row(table: MappingTable) -> dict[str, Any]:
    """Return the row of a version of the mapping."""
    entries = [entry.model_dump(mode="json") for entry in table.entries]
    return {
        "version": table.version,
        "confirmed_by": table.by,
        "why": table.why,
        "at": as_column(table.at),
        "entries": orjson.dumps(entries).decode(),
        "verified": table.verified,
    }


def process_row(process: ProcessRecord, *, but: Collection[str] = ()) -> dict[str, Any]:
    """Return the row of a process; the code and parameters of its reason have a separate column."""
    incidents = orjson.dumps([_incident_values(incident) for incident in process.incidents]).decode()
    unallocated = orjson.dumps([_unallocated_values(activity) for activity in process.unallocated]).decode()
    reservations = orjson.dumps(
        [_reservation_values(reservation) for reservation in process.reservations]
    ).decode()
    retries = orjson.dumps([_retry_values(retry) for retry in process.retries]).decode()
    row = {
        **plain_row(process, but={*but, "incidents", "unallocated", "reservations", "retries"}),
        "incidents": incidents,
        "unallocated": unallocated,
        "reservations": reservations,
        "retries": retries,
    }
    reason = process.reason
    if not isinstance(reason, MessageText):
        return {**row, "reason_message": None}
    coded = orjson.dumps(with_code("reason", reason)).decode()
    return {**row, "reason": str(reason), "reason_message": coded}


def changed_process_row(process: ProcessRecord) -> dict[str, Any]:
    """Return the parameters of the update of a process that this orchestrator has read or written before."""
    row = process_row(process, but=CONSTANT_COLUMNS)
    return {**row, "its_id": process.id, "before": process.revision - 1}


def task_row(task: TaskRecord) -> dict[str, Any]:
    """Return the row of a Task."""
    allocated = None if task.allocated is None else orjson.dumps(with_code("text", task.allocated)).decode()
    performer = task.performer[:MAX_RESOURCE_LENGTH] or None
    return {**plain_row(task), "took_ms": task.took_ms, "allocated": allocated, "performer": performer}


def message_row(message: Message) -> dict[str, Any]:
    """Return the row of a message of the outbox."""
    return {**plain_row(message), "body": orjson.dumps(message.body).decode()}


def offer_row(offer: OfferRecord) -> dict[str, Any]:
    """Return the row of an offer."""
    row = plain_row(offer, but=("faults", "warnings", "decisions"))
    decisions = [
        {name: getattr(decision, name) for name in ("at", "status", "by", "why", "deployed", "verified")}
        for decision in offer.decisions
    ]
    return {
        **row,
        "faults": orjson.dumps([_fault_values(fault) for fault in offer.faults]).decode(),
        "warnings": orjson.dumps([_fault_values(warning) for warning in offer.warnings]).decode(),
        "decisions": orjson.dumps(decisions).decode(),
    }


def to_offer(row: Mapping[str, Any]) -> OfferRecord:
    """Return the record of the row of an offer."""
    return OfferRecord(
        **{
            **row,
            "status": OfferStatus(row["status"]),
            "found_at": to_time(row["found_at"]),
            "content": orjson.loads(row["content"]),
            "faults": tuple(_fault(values) for values in orjson.loads(row["faults"])),
            "warnings": tuple(_fault(values) for values in orjson.loads(row["warnings"])),
            "decisions": tuple(_decision(values) for values in orjson.loads(row["decisions"])),
        }
    )


def _fault_values(fault: Fault) -> dict[str, Any]:
    values = {name: getattr(fault, name) for name in ("element", "line", "name")}
    return {**values, **with_code("message", fault.message)}


def _fault(values: Mapping[str, Any]) -> Fault:
    others = {name: values[name] for name in ("element", "line", "name")}
    return Fault(message=message_in(values, "message") or "", **others)


def _decision(values: Mapping[str, Any]) -> Decision:
    deployed = tuple((str(name), int(version)) for name, version in values["deployed"])
    status, at = OfferStatus(values["status"]), to_time(values["at"])
    return Decision(at, status, values["by"], values["why"], deployed, values.get("verified", False))


def _unallocated_values(activity: Unallocated) -> dict[str, Any]:
    values = {name: getattr(activity, name) for name in ("token", "visit", "element", "name", "since")}
    return {**values, **with_code("reason", activity.reason)}


def _reservation_values(reservation: ReservationRecord) -> dict[str, Any]:
    names = ("key", "element", "name", "state", "since", "asked_at", "spans", "used", "held_at", "outer")
    return {**{name: getattr(reservation, name) for name in names}, **with_code("reason", reservation.reason)}


def _retry_values(retry: Retry) -> dict[str, Any]:
    names = ("token", "visit", "element", "name", "task", "failed", "attempts", "due")
    return {**{name: getattr(retry, name) for name in names}, **with_code("reason", retry.reason)}


def _incident_values(incident: IncidentRecord) -> dict[str, Any]:
    values = {name: getattr(incident, name) for name in ("token", "element", "name", "since", "task", "code")}
    return {**values, **with_code("reason", incident.reason)}


def to_values(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns of a row as the fields of a record."""
    values = dict(row)
    for name, value in values.items():
        if value is not None and name in _MOMENTS:
            values[name] = datetime.fromisoformat(value)
        elif value is not None and name in _DOCUMENTS:
            values[name] = orjson.loads(value)
    return values


def to_process(row: Mapping[str, Any]) -> ProcessRecord:
    """Return the record of the row of a process."""
    values = to_values(row)
    coded = values.pop("reason_message")
    return ProcessRecord(
        **{
            **values,
            "reason": values["reason"] if coded is None else message_in(orjson.loads(coded), "reason"),
            "status": TaskStatus(values["status"]),
            "waiting": tuple(values["waiting"]),
            "acts": tuple(_act(act) for act in values["acts"]),
            "incidents": tuple(_incident(incident) for incident in values["incidents"]),
            "unallocated": tuple(_unallocated(stored) for stored in orjson.loads(values["unallocated"])),
            "retries": tuple(_retry(stored) for stored in orjson.loads(values["retries"])),
            "declined": {key: tuple(agents) for key, agents in values["declined"].items()},
            "reservations": tuple(_reservation(stored) for stored in orjson.loads(values["reservations"])),
        }
    )


def to_task(row: Mapping[str, Any]) -> TaskRecord:
    """Return the record of the row of a Task."""
    values = to_values(row)
    del values["took_ms"], values["performer"]
    if values["allocated"] is not None:
        values["allocated"] = message_in(orjson.loads(values["allocated"]), "text")
    declined_by = tuple(values["declined_by"])
    return TaskRecord(**{**values, "status": TaskStatus(values["status"]), "declined_by": declined_by})


def to_task_act(row: Mapping[str, Any]) -> TaskAct:
    """Return the record of the row of an act."""
    changed = {"at": to_time(row["at"]), "kind": TaskActKind(row["kind"]), "verified": bool(row["verified"])}
    return TaskAct(**{**row, **changed})


def _act(values: Mapping[str, Any]) -> Act:
    return Act(**{**values, "at": to_time(values["at"]), "act": ActKind(values["act"])})


def _unallocated(values: Mapping[str, Any]) -> Unallocated:
    others = {name: values[name] for name in ("token", "visit", "element", "name")}
    return Unallocated(reason=message_in(values, "reason") or "", since=to_time(values["since"]), **others)


def _reservation(values: Mapping[str, Any]) -> ReservationRecord:
    others = {name: values[name] for name in ("key", "element", "name", "outer")}
    return ReservationRecord(
        state=ReservationState(values["state"]),
        since=to_time(values["since"]),
        asked_at=to_time(values["asked_at"]),
        held_at=to_moment(values["held_at"]),
        reason=message_in(values, "reason") or "",
        spans={span: tuple(agents) for span, agents in values["spans"].items()},
        used=tuple(values["used"]),
        **others,
    )


def _retry(values: Mapping[str, Any]) -> Retry:
    names = ("token", "visit", "element", "name", "task", "failed", "attempts")
    others = {name: values[name] for name in names}
    return Retry(reason=message_in(values, "reason") or "", due=to_moment(values["due"]), **others)


def _incident(values: Mapping[str, Any]) -> IncidentRecord:
    others = {name: values[name] for name in ("token", "element", "name", "task", "code")}
    return IncidentRecord(reason=message_in(values, "reason") or "", since=to_time(values["since"]), **others)


def to_moment(text: str | None) -> datetime | None:
    """Return the time of a column that may be empty."""
    return None if text is None else datetime.fromisoformat(text)


def to_time(text: str) -> datetime:
    """Return the time of a column."""
    return datetime.fromisoformat(text)
