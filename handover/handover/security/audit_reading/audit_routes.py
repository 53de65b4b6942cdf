"""The routes of an audit log, the same in every service: read with filters, export, verify.

Reading a page is not recorded; an export is.
"""

from collections.abc import Awaitable, Callable, Mapping
from datetime import UTC, datetime
from typing import Annotated, Any, Final, Literal, Protocol

import orjson
from fastapi import Depends, FastAPI, Query, Response
from sqlalchemy import Connection
from typing_extensions import TypedDict

from handover.formats.tables import csv_table
from handover.http.api_description import TaggedRoutes, sends
from handover.security.audit import AuditFilter, AuditLog, AuditRecord
from handover.security.caller import Caller
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_datamodels.times import iso

MAX_RECORDS: Final = 500
MAX_EXPORTED: Final = 100_000

Auditor = Annotated[Caller, require(Permission.READ_AUDIT)]
Text = Annotated[str | None, Query(max_length=400)]
Milliseconds = Annotated[int | None, Query(ge=0, le=2**53)]
Names = Callable[[Connection], Mapping[str, str]]
"""Returns the names of subjects, for the service that knows them."""


class AuditView(TypedDict):
    """An audit record; `text` is null where there was none, or where it was deleted.

    `intent` is the number of the intent whose outcome this is. An intent, with the outcome `intended`, was
    recorded before its act; `endedBy` is the number of the record with its outcome, null where there is none:
    the act still runs, or the process ended in between and it may have happened.
    """

    service: str
    seq: int
    at: str
    subject: str
    action: str
    resource: str
    outcome: str
    method: str
    text: str | None
    hash: str
    intent: int | None
    endedBy: int | None
    subjectName: str | None
    resourceName: str | None


class AuditVerification(TypedDict):
    """How many records are intact, the hash of the last, and the first fault if there is one.

    `withoutOutcome` has the numbers of the intents without an outcome.
    """

    records: int
    head: str
    fault: str | None
    withoutOutcome: list[int]


class AuditSource(Protocol):
    """An audit log with its database."""

    service: str
    log: AuditLog

    def read(self, function: Callable[[Connection], Any], /) -> Awaitable[Any]:
        """Return the result of `function` on a connection."""
        ...

    def record(self, caller: Caller, action: str, resource: str, /) -> Awaitable[None]:
        """Append a record."""
        ...


def _chosen(  # noqa: PLR0917 - query parameters
    subject: Text = None,
    action: Text = None,
    resource: Text = None,
    outcome: Text = None,
    since: Milliseconds = None,
    until: Milliseconds = None,
) -> AuditFilter:
    return AuditFilter(subject, action, resource, outcome, since, until)


Chosen = Annotated[AuditFilter, Depends(_chosen)]


def add_audit_routes(
    app: FastAPI, source: AuditSource, names: Names = lambda _: {}, *, prefix: str = ""
) -> None:
    """Add the routes below `prefix`; filters: subject, part of action or resource, outcome, times in ms."""
    routes = TaggedRoutes(app, "audit")

    @routes.get(f"{prefix}/audit")
    async def audit_records(
        _: Auditor,
        chosen: Chosen,
        before: Annotated[int, Query(ge=0, le=2**62)] = 0,
        limit: Annotated[int, Query(ge=1, le=MAX_RECORDS)] = 100,
    ) -> list[AuditView]:
        """Return the records that match all filters, the newest first, before a number.

        An intent whose outcome is recorded is only in the list of the filter `outcome=intended`, and in the
        export.
        """

        def read(connection: Connection) -> list[AuditView]:
            records = source.log.read(
                connection, chosen=chosen, after=before, limit=limit, newest_first=True, is_short=True
            )
            return _views(source.service, names(connection), records)

        views: list[AuditView] = await source.read(read)
        return views

    @routes.get(f"{prefix}/audit/verification")
    async def audit_verification(_: Auditor) -> AuditVerification:
        """Check the chain of all records."""
        verification = await source.read(source.log.verify)
        return {
            "records": verification.records,
            "head": verification.head,
            "fault": verification.fault,
            "withoutOutcome": await source.read(source.log.open_intents),
        }

    @routes.get(
        f"{prefix}/audit/export",
        response_class=Response,
        responses=sends("text/csv", or_json=list[AuditView]),
    )
    async def audit_export(
        caller: Auditor,
        chosen: Chosen,
        file_format: Annotated[Literal["csv", "json"], Query(alias="format")] = "csv",
    ) -> Response:
        """Return up to 100,000 records that match all filters, oldest first; the export is recorded."""
        await source.record(caller, "audit.exported", "*")

        def read(connection: Connection) -> bytes:
            records = source.log.read(connection, chosen=chosen, limit=MAX_EXPORTED)
            views = _views(source.service, names(connection), records)
            return csv_of(views) if file_format == "csv" else orjson.dumps(views)

        return Response(
            await source.read(read),
            media_type="text/csv; charset=utf-8" if file_format == "csv" else "application/json",
            headers={"Content-Disposition": f'attachment; filename="audit-{source.service}.{file_format}"'},
        )


def csv_of(views: list[AuditView]) -> bytes:
    """Return records as CSV."""
    return csv_table(tuple(AuditView.__annotations__), views)


def view_of(service: str, record: AuditRecord, names: Mapping[str, str]) -> AuditView:
    """Return a record with the names that are known."""
    return {
        "service": service,
        "seq": record.seq,
        "at": iso(datetime.fromtimestamp(record.at_ms / 1000, UTC)),
        "subject": record.subject,
        "action": record.action,
        "resource": record.resource,
        "outcome": record.outcome,
        "method": record.method,
        "text": record.text,
        "hash": record.hash,
        "intent": record.intent,
        "endedBy": record.ended_by,
        "subjectName": names.get(record.subject),
        "resourceName": names.get(record.resource),
    }


def _views(service: str, names: Mapping[str, str], records: list[AuditRecord]) -> list[AuditView]:
    return [view_of(service, record, names) for record in records]
