"""Routes for what is the caller's own: account and sessions."""

from typing import Annotated, Any, Final

from fastapi import FastAPI, Query

from handover.errors import Problem
from handover.security.caller import Caller, CallerKind
from handover.security.guard import require_signed_in
from handover.security.permissions import Permission
from handover_accounts.directory import Directory
from handover_accounts.names import subject_names
from handover_accounts.routes.views import MeView, SessionView, time_of
from handover_accounts.storage import sessions, stations, users
from handover_accounts.storage.changes import Change
from handover_accounts.storage.grants import admin_names
from handover_accounts.storage.sessions import SessionLimits

SignedIn = Annotated[Caller, require_signed_in()]
MAX_NAMES: Final = 100


def add_own_routes(app: FastAPI, directory: Directory) -> None:
    """Add the routes for every caller."""

    @app.get("/me", tags=["own account"])
    async def me(caller: SignedIn) -> MeView:
        """Return the caller."""
        return {
            "kind": caller.kind,
            "subject": caller.subject,
            "name": caller.name,
            "person": caller.person,
            "grants": [{"role": grant.role, "resource": grant.resource} for grant in caller.grants],
            "permissions": [permission for permission in Permission if caller.may_somewhere(permission)],
            "hasAccounts": directory.keys.exist(),
        }

    @app.get("/admins", tags=["own account"], dependencies=[require_signed_in()])
    async def admins() -> list[str]:
        """List the names of the users who can grant roles, for those who lack one."""
        return await directory.read(admin_names)

    @app.get("/names", tags=["own account"], dependencies=[require_signed_in()])
    async def names(subject: Annotated[list[str], Query(max_length=MAX_NAMES)]) -> dict[str, str]:
        """Return the names of users and tokens by their random ids, without those that were deleted.

        For those who see such ids, as in the list of who looked at the own health data.
        """
        names_of_subjects = await directory.read(subject_names)
        return {
            subject_id: names_of_subjects[subject_id]
            for subject_id in subject
            if subject_id in names_of_subjects
        }

    @app.get("/me/sessions", tags=["own account"])
    async def own_sessions(caller: SignedIn) -> list[SessionView]:
        """List the own sessions with their places and devices."""
        _require_user(caller)
        limits = directory.session_limits
        rows = await directory.read(
            lambda connection: sessions.sessions_of(connection, caller.subject, limits)
        )
        return [session_view(row, limits, caller) for row in rows]

    @app.delete("/me/sessions/{session}", status_code=204, tags=["own account"])
    async def end_own_session(caller: SignedIn, session: str) -> None:
        """End one of the own sessions."""
        _require_user(caller)

        def end(change: Change) -> None:
            if stations.station_of(change.connection, caller.subject) is not None:
                raise Problem(
                    403,
                    "Not allowed",
                    "a station is signed out at its own screen, with a PIN, or by an engineer",
                )
            sessions.end_session(change, session, subject=caller.subject)

        await directory.change(caller.subject, end)

    @app.delete("/me/sessions", status_code=204, tags=["own account"])
    async def end_other_sessions(caller: SignedIn) -> None:
        """End all own sessions but this one."""
        _require_user(caller)

        def end(change: Change) -> None:
            if stations.station_of(change.connection, caller.subject) is not None:
                raise Problem(
                    403,
                    "Not allowed",
                    "a station is signed out at its own screen, with a PIN, or by an engineer",
                )
            users.end_sessions_of(change, caller.subject, kept_session=caller.session)
            change.is_recorded = True  # there may be no other session

        await directory.change(caller.subject, end)


def session_view(row: dict[str, Any], limits: SessionLimits, caller: Caller) -> SessionView:
    """Return a session."""
    return {
        "id": row["id"],
        "method": row["method"],
        "address": row["address"],
        "device": row["device"],
        "createdAt": time_of(row["created_s"]),
        "seenAt": time_of(row["seen_s"]),
        "endsAt": time_of(limits.ends_s(row)),
        "isThis": row["id"] == caller.session,
    }


def _require_user(caller: Caller) -> None:
    if caller.kind is not CallerKind.USER:
        raise Problem(409, "No user", f'"{caller.name}" is no user with a password and sessions; sign in')
