"""REST of people: their gloves and commands."""

from collections.abc import Mapping
from typing import Annotated, cast

from fastapi import FastAPI, Request, Response
from pydantic import Field

from handover.formats.strict_json import RequestBody
from handover.http.api_description import TaggedRoutes
from handover.security.guard import authenticated, guard_of, require, require_by_handler
from handover.security.permissions import Permission
from handover_gloves.gloves.glove import Glove
from handover_gloves.people.views import PersonView, PersonWithGestures, Side, WearerView
from handover_gloves.recognition.gestures import listed
from handover_gloves.routes.people_views import GestureName, Name, PeopleParts, of_person, person_view

CommandId = Annotated[int, Field(ge=0, le=2**31 - 1)]


class Title(RequestBody):
    """The title of a person; left out it stays unchanged, an empty one is removed."""

    title: Annotated[str, Field(max_length=200)] | None = None


class Wearer(RequestBody):
    """The wearer of a glove; null for nobody by name."""

    person: Name | None


class CommandGesture(RequestBody):
    """The gesture of a person for a command; null: no gesture."""

    gesture: GestureName | None


def add_people(app: FastAPI, parts: PeopleParts) -> None:
    """Add the routes of people, their commands and the gloves that they wear."""
    _add_persons(app, parts)
    _add_commands(app, parts)
    wearers = parts.wearers

    @app.put(
        "/gloves/{glove}/person",
        tags=["people"],
        dependencies=[
            require_by_handler(Permission.PERFORM_TASKS, "to wear the glove oneself, `configure` for others")
        ],
    )
    async def wear(glove: str, wearer: Wearer, connection: Request) -> WearerView:
        """Choose the wearer of a glove: their fit, gestures and commands apply at once.

        The current Task continues. Another glove of the same hand that they wore has no wearer then.
        """
        worn = parts.gloves.named(glove)
        await _require_may_wear(connection, worn, wearer.person)
        if wearer.person is not None:
            wearers.people.named(wearer.person)
        if wearer.person != worn.person:
            wearers.conditions.require_none(glove=worn.name, person=worn.person)
            wearers.conditions.require_none(person=wearer.person)
        await wearers.wear(worn, wearer.person)
        return {"glove": worn.name, "hand": cast("Side", worn.hand), "person": worn.person}


async def _require_may_wear(connection: Request, glove: Glove, person: str | None) -> None:
    """Raise `Problem` 403 unless the caller puts on or takes off the glove, or may configure it."""
    guard, caller = guard_of(connection), await authenticated(connection)
    own = {None} if caller.person is None else {None, caller.person}
    present, new = (
        None if name is None else guard.settings.entity_id("Person", name) for name in (glove.person, person)
    )
    is_own = caller.person is not None and {present, new} <= own
    permission = Permission.PERFORM_TASKS if is_own else Permission.CONFIGURE
    guard.require(caller, permission, guard.settings.entity_id("Device", glove.name))


def _add_persons(app: FastAPI, parts: PeopleParts) -> None:
    routes = TaggedRoutes(app, "people")

    @routes.get("/people", dependencies=[require(Permission.READ)])
    async def list_people() -> list[PersonView]:
        """List all people with their gloves, commands and own gestures."""
        return [person_view(name, parts) for name in parts.people.names()]

    @routes.get("/people/{person}", dependencies=[require(Permission.READ, of_person)])
    async def one(person: str) -> PersonWithGestures:
        """Return a person with all their gestures."""
        name = parts.people.named(person).name
        every = listed(parts.people.gestures_of(name), parts.people.commands_of(name))
        return {**person_view(name, parts), "gestures": every}

    @routes.put(
        "/people/{person}",
        responses={201: {"model": PersonView}},
        dependencies=[require(Permission.MANAGE_PEOPLE, of_person)],
    )
    async def add(person: str, response: Response, body: Title | None = None) -> PersonView:
        """Add a person, or change their title: 201, or 200 if they were known."""
        response.status_code = 201 if await parts.people.add(person, body.title if body else None) else 200
        return person_view(person, parts)

    @routes.delete(
        "/people/{person}", status_code=204, dependencies=[require(Permission.MANAGE_PEOPLE, of_person)]
    )
    async def remove(person: str) -> Response:
        """Delete a person with their fits; the gloves they wear have no wearer then."""
        parts.people.named(person)
        parts.require_no_study(person)
        for glove in parts.gloves.worn_by(person):
            await parts.wearers.wear(glove, None)
        await parts.people.remove(person)
        parts.records.forget_fits(person)
        return Response(status_code=204)


def _add_commands(app: FastAPI, parts: PeopleParts) -> None:
    routes = TaggedRoutes(app, "people")

    @routes.put("/people/{person}/commands", dependencies=[require(Permission.CONFIGURE, of_person)])
    async def commands(person: str, gestures: Mapping[CommandId, GestureName | None]) -> PersonView:
        """Set all own commands of a person: `{"3": "Horns", "8": null}`."""
        parts.require_no_study(person)
        await parts.people.set_commands(person, gestures, whole=True)
        return person_view(person, parts)

    @routes.patch("/people/{person}/commands", dependencies=[require(Permission.CONFIGURE, of_person)])
    async def some_commands(person: str, gestures: Mapping[CommandId, GestureName | None]) -> PersonView:
        """Set some own commands; the others stay. Send two commands at once to exchange their gestures."""
        parts.require_no_study(person)
        await parts.people.set_commands(person, gestures, whole=False)
        return person_view(person, parts)

    @routes.put(
        "/people/{person}/commands/{command}", dependencies=[require(Permission.CONFIGURE, of_person)]
    )
    async def command(person: str, command: CommandId, body: CommandGesture) -> PersonView:
        """Set the gesture of a person for one command."""
        parts.require_no_study(person)
        await parts.people.set_commands(person, {command: body.gesture}, whole=False)
        return person_view(person, parts)

    @routes.delete(
        "/people/{person}/commands/{command}", dependencies=[require(Permission.CONFIGURE, of_person)]
    )
    async def reset_command(person: str, command: CommandId) -> PersonView:
        """Use the gesture of the site for a command again."""
        parts.require_no_study(person)
        await parts.people.reset_command(person, command)
        return person_view(person, parts)
