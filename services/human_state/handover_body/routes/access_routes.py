"""REST: who looked at the data of a person, and who changed it, from the audit log of this service."""

from datetime import UTC, datetime
from typing import Annotated, Final

from fastapi import FastAPI, Query, Request
from sqlalchemy import Connection

from handover.security.audit import AuditFilter
from handover.security.audit_trail import DONE, AuditTrail
from handover.security.guard import guard_of
from handover.security.permissions import Permission
from handover_body.people.people import People
from handover_body.routes.access import SignedIn, require_own_or
from handover_body.routes.bodies import AccessView, Name

MAX_ACCESSES: Final = 200
_READING: Final = ("GET ", "WebSocket ")


def add_access_routes(app: FastAPI, people: People, audit: AuditTrail) -> None:
    """Add the route."""

    @app.get("/people/{person}/accesses", tags=["people"])
    async def accesses(
        person: Name,
        caller: SignedIn,
        request: Request,
        before: Annotated[int, Query(ge=0, le=2**62)] = 0,
        limit: Annotated[int, Query(ge=1, le=MAX_ACCESSES)] = 50,
    ) -> list[AccessView]:
        """Return who looked at the data of a person, or changed it, the newest first, before a number.

        The person may see it, and who may read the audit log. `name` is the name that the account had at its
        last access, also after the account was deleted. The same reading is recorded once in ten
        minutes. Reading the entities in the context broker is in the audit log of the broker.
        """
        await require_own_or(request, caller, Permission.READ_AUDIT, person)
        people.person(person)
        resource = guard_of(request).settings.entity_id("Person", person)
        chosen = AuditFilter(about=resource, outcome=DONE)

        def read(connection: Connection) -> list[AccessView]:
            entries = audit.log.read(connection, chosen=chosen, after=before, limit=limit, newest_first=True)
            names = audit.log.names(connection, {entry.subject for entry in entries})
            return [
                AccessView(
                    number=entry.seq,
                    at=datetime.fromtimestamp(entry.at_ms / 1000, UTC),
                    subject=entry.subject,
                    name=names.get(entry.subject),
                    is_own=entry.subject == caller.subject,
                    action=entry.action,
                    is_reading=entry.action.startswith(_READING),
                )
                for entry in entries
            ]

        views: list[AccessView] = await audit.read(read)
        return views
