"""Routes of stations: for engineers, for the screen of a station, and for the services of its gloves."""

from typing import Annotated, Any, cast

from fastapi import FastAPI
from sqlalchemy import Connection, select

from handover.errors import Problem
from handover.http.body_limit import max_body
from handover.security.caller import Caller
from handover.security.guard import require, require_signed_in, require_somewhere
from handover.security.permissions import Permission, Role
from handover_accounts.directory import Directory
from handover_accounts.routes.bodies import (
    GestureIdentification,
    Identification,
    IdentifierChange,
    NewStation,
    PerformerClaim,
    PinCheck,
    StationSignIn,
)
from handover_accounts.routes.service_routes import MAX_BODY_BYTES, Verifier, require_page_server
from handover_accounts.routes.views import (
    IdentifiersView,
    JoinedPerson,
    OpenedSession,
    PerformerProof,
    PinResult,
    StationJoins,
    StationView,
    time_of,
)
from handover_accounts.storage import sessions, stations, tables, users
from handover_accounts.storage.changes import Change
from handover_accounts.storage.grants import add_grant, checked_grant, grants_of
from handover_accounts.storage.identifiers import (
    IdentifierKind,
    checked_identifier,
    identified,
    kinds_of,
    new_qr_code,
    set_identifier,
)

SignedIn = Annotated[Caller, require_signed_in()]
Engineer = Annotated[Caller, require_somewhere(Permission.CONFIGURE)]
STATION_METHOD = "station"


def add_station_routes(app: FastAPI, directory: Directory) -> None:
    """Add the routes."""
    _add_engineer_routes(app, directory)
    _add_screen_routes(app, directory)
    _add_service_routes(app, directory)
    _add_identifier_routes(app, directory)


def _add_engineer_routes(app: FastAPI, directory: Directory) -> None:
    @app.get("/stations", tags=["stations"])
    async def list_stations(_: Engineer) -> list[StationView]:
        """List the stations by name."""
        return await directory.read(lambda connection: _views(directory, connection))

    @app.post("/stations", status_code=201, tags=["stations"])
    async def add(caller: Engineer, body: NewStation) -> StationView:
        """Add a station, which may perform Tasks of the resources for which the caller may."""
        directory.require_accounts()
        grants = [checked_grant(Role.OPERATOR, resource) for resource in body.resources]
        for grant in grants:
            if not (
                caller.may(Permission.PERFORM_TASKS, grant.resource) and caller.may(Permission.CONFIGURE)
            ):
                raise Problem(
                    403,
                    "Not allowed",
                    f"a station gives no more than its engineer has: {grant.resource}, and `configure` for *",
                )

        def added(change: Change) -> StationView:
            subject = stations.add_station(change, body.name, body.gloves, body.leave_after_min)
            for grant in grants:
                add_grant(change, subject, grant)
            return next(view for view in _views(directory, change.connection) if view["subject"] == subject)

        return await directory.change(caller.subject, added)

    @app.delete("/stations/{station}", status_code=204, tags=["stations"])
    async def remove(caller: Annotated[Caller, require(Permission.CONFIGURE)], station: str) -> None:
        """Remove a station; its screens are signed out."""

        def removed(change: Change) -> None:
            _require_known(change.connection, station)
            users.delete_user(change, station)

        await directory.change(caller.subject, removed)

    @app.post("/station-sessions", status_code=201, tags=["page server"])
    @max_body(MAX_BODY_BYTES)
    async def sign_in(caller: Verifier, body: StationSignIn) -> OpenedSession:
        """Sign a screen in as a station, in place of the engineer who does it."""
        require_page_server(caller)

        def opened(change: Change) -> str:
            connection = change.connection
            _require_known(connection, body.station)
            session = sessions.require_session(connection, body.session, directory.session_limits)
            change.actor = session["subject"]
            if not any(
                grant.allows(Permission.CONFIGURE, "*") for grant in grants_of(connection, change.actor)
            ):
                raise Problem(403, "Not allowed", 'signing a station in needs "configure" for everything')
            _, token = sessions.open_session(
                change, body.station, method=STATION_METHOD, address=body.address, device=body.device
            )
            sessions.end_session(change, session["id"])
            return token

        token = await directory.change(caller.subject, opened, method=STATION_METHOD)
        return {"session": token, "maxAgeS": int(directory.session_limits.max_s)}


def _add_screen_routes(app: FastAPI, directory: Directory) -> None:
    @app.get("/me/station", tags=["stations"])
    async def own_station(caller: SignedIn) -> StationView:
        """Return the station as which this screen is signed in: 409 if it is none."""

        def found(connection: Connection) -> StationView:
            stations.require_station(connection, caller.subject)
            return next(view for view in _views(directory, connection) if view["subject"] == caller.subject)

        return await directory.read(found)

    @app.put("/me/station/person", tags=["stations"])
    @max_body(MAX_BODY_BYTES)
    async def join(caller: SignedIn, body: Identification) -> StationView:
        """Join this station by badge number, QR code or PIN: 404 if nobody is recognized."""
        await directory.read(lambda connection: stations.require_station(connection, caller.subject))
        await directory.join(caller.subject, IdentifierKind(body.method), body.value)
        return await own_station(caller)

    @app.delete("/me/station/person", status_code=204, tags=["stations"])
    async def leave(caller: SignedIn) -> None:
        """Leave this station."""
        await directory.change(
            caller.subject, lambda change: stations.leave(change, caller.subject, "screen"), method="screen"
        )

    @app.post("/me/station/seen", status_code=204, tags=["stations"])
    async def seen(caller: SignedIn) -> None:
        """Note that the person is still there, so that they do not leave by time."""

        def noted(change: Change) -> None:
            stations.require_station(change.connection, caller.subject)
            stations.stay(change.connection, caller.subject)
            change.is_recorded = True

        await directory.change(caller.subject, noted)


def _add_service_routes(app: FastAPI, directory: Directory) -> None:
    verifier = [require(Permission.VERIFY_CALLERS)]

    @app.get("/station-joins", tags=["services"], dependencies=verifier)
    async def joins() -> StationJoins:
        """Return who has joined the station of which gloves."""
        views = await directory.read(lambda connection: _views(directory, connection))
        return {
            "stations": [
                {"station": view["subject"], "gloves": view["gloves"], "joined": view["joined"]}
                for view in views
            ]
        }

    @app.post("/station-joins", status_code=204, tags=["services"], dependencies=verifier)
    @max_body(MAX_BODY_BYTES)
    async def by_gesture(body: GestureIdentification) -> None:
        """Join or leave the station of a glove by a personal gesture; a gesture of nobody has no effect."""

        def toggle(change: Change) -> None:
            change.is_recorded = True
            connection = change.connection
            station = stations.station_with(connection, body.glove)
            if station is None:
                return
            kind = IdentifierKind.GESTURE
            try:
                change.actor = identified(connection, directory.identifiers, kind, body.gesture)
            except Problem:
                return
            present = stations.joined(connection, station)
            if present is not None and present["subject"] == change.actor:
                stations.leave(change, station, "gesture")
            else:
                stations.join(change, station, change.actor, kind)

        await directory.change("unknown", toggle, method=IdentifierKind.GESTURE)

    @app.post("/pin-checks", tags=["services"], dependencies=verifier)
    @max_body(MAX_BODY_BYTES)
    async def check_pin(body: PinCheck) -> PinResult:
        """Return whether a PIN is that of a Person, with a proof for a Task: 429 after too many attempts."""
        is_right = await directory.is_pin_of(body.person, body.pin)
        key = directory.keys.signing_key() if is_right else None
        proof = None if key is None else key.prove_pin(body.person, body.task)
        return {"isRight": is_right, "proof": proof}

    @app.post("/performer-proofs", tags=["services"], dependencies=verifier)
    @max_body(MAX_BODY_BYTES)
    async def prove_performer(body: PerformerClaim) -> PerformerProof:
        """Return a proof that a Person whom the service has identified performed a Task."""
        directory.require_accounts()
        return {"proof": directory.keys.signing_key().prove_performer(body.person, body.task)}


def _add_identifier_routes(app: FastAPI, directory: Directory) -> None:
    @app.get("/users/{subject}/identifiers", tags=["stations"])
    async def list_kinds(
        _: Annotated[Caller, require(Permission.MANAGE_PEOPLE)], subject: str
    ) -> IdentifiersView:
        """Return by what a user is recognized at stations."""
        return {"kinds": await directory.read(lambda connection: kinds_of(connection, subject)), "qr": None}

    @app.put("/users/{subject}/identifiers/{kind}", tags=["stations"])
    async def set_one(
        caller: Annotated[Caller, require(Permission.MANAGE_PEOPLE)],
        subject: str,
        kind: IdentifierKind,
        body: IdentifierChange,
    ) -> IdentifiersView:
        """Set or remove an identifier of a user; for `qr` a new code is made, and shown once."""
        return await _set(directory, caller, subject, kind, body.value)

    @app.put("/me/identifiers/{kind}", tags=["stations"])
    async def set_own(caller: SignedIn, kind: IdentifierKind, body: IdentifierChange) -> IdentifiersView:
        """Set or remove the own PIN or gesture."""
        if kind not in {IdentifierKind.PIN, IdentifierKind.GESTURE}:
            raise Problem(403, "Not allowed", "an admin assigns badges and QR codes")
        await directory.read(lambda connection: _require_person(connection, caller.subject))
        return await _set(directory, caller, caller.subject, kind, body.value)


async def _set(
    directory: Directory, caller: Caller, subject: str, kind: IdentifierKind, value: str | None
) -> IdentifiersView:
    directory.require_accounts()
    is_qr = kind is IdentifierKind.QR and value is not None
    identifier = new_qr_code() if is_qr else None if value is None else checked_identifier(kind, value)

    def change_it(change: Change) -> list[str]:
        users.find(change.connection, subject)
        set_identifier(change, directory.identifiers, subject, kind, identifier)
        return kinds_of(change.connection, subject)

    return {"kinds": await directory.change(caller.subject, change_it), "qr": identifier if is_qr else None}


def _require_person(connection: Connection, subject: str) -> None:
    users.find(connection, subject)
    if stations.station_of(connection, subject) is not None:
        raise Problem(409, "No person", "a station has no identifiers; sign in as yourself")


def _require_known(connection: Connection, station: str) -> None:
    if stations.station_of(connection, station) is None:
        raise Problem(404, "Not found", f'there is no station "{station[:64]}"')


def _views(directory: Directory, connection: Connection) -> list[StationView]:
    query = (
        select(tables.stations.c.subject, tables.stations.c.leave_after_s, tables.users.c.name)
        .select_from(tables.stations.join(tables.users, tables.users.c.subject == tables.stations.c.subject))
        .order_by(tables.users.c.name_key)
    )
    views: list[StationView] = []
    for row in connection.execute(query).mappings().all():
        station = stations.require_station(connection, row["subject"])
        opened = sessions.sessions_of(connection, row["subject"], directory.session_limits)
        views.append(
            {
                "subject": row["subject"],
                "name": row["name"],
                "gloves": station["gloves"],
                "leaveAfterMin": row["leave_after_s"] / 60,
                "sessions": len(opened),
                "joined": _joined_view(stations.joined(connection, row["subject"])),
            }
        )
    return views


def _joined_view(row: dict[str, Any] | None) -> JoinedPerson | None:
    if row is None:
        return None
    return cast(
        "JoinedPerson",
        {
            "subject": row["subject"],
            "name": row["name"],
            "person": row["person"],
            "method": row["method"],
            "since": time_of(row["joined_s"]),
        },
    )
