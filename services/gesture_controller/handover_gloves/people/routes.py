"""REST routes of people: their gloves, commands, own gestures and profile files."""

import asyncio
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any, Self, cast

import orjson
from fastapi import FastAPI, Request, Response
from pydantic import Field, FiniteFloat, model_validator

from handover.errors import Problem
from handover.formats.strict_json import RequestBody
from handover.http.api_description import sends
from handover.http.body_limit import max_body
from handover.messages import message, text_of
from handover.runtime.offload import Offload, OffloadFailed
from handover.security.guard import authenticated, guard_of, in_path, require, require_by_handler
from handover.security.permissions import Permission
from handover.serving.service import YAML_TYPES, accepts
from handover_gloves.calibration.glove_records import GloveRecords
from handover_gloves.calibration.glove_store import Fit
from handover_gloves.calibration.sensor_diagnostics import find_lasting_faults
from handover_gloves.configuration.lined_yaml import WrongFile
from handover_gloves.gloves.glove import Glove
from handover_gloves.gloves.known_gloves import KnownGloves
from handover_gloves.people import profile_file
from handover_gloves.people.people import People, neighbour_view, require_person_name
from handover_gloves.people.person import OwnGesture
from handover_gloves.people.profile_file import Profile
from handover_gloves.people.sample import UnclearSample, read_sample
from handover_gloves.people.views import (
    DefinedGesture,
    FitView,
    OwnGestureView,
    PersonView,
    PersonWithFreedCommands,
    PersonWithGestures,
    Side,
    WearerView,
)
from handover_gloves.people.wearers import Wearers
from handover_gloves.recognition.gestures import Shape, listed

YAML = "application/yaml"
MAX_PROFILE_BYTES = 1_000_000
MAX_INLINE_BYTES = 4_096
"""A longer profile is read and written in another process, since it would block the event loop."""
MAX_RECORDED_FRAMES = 2_000
MAX_RECORDING_BYTES = 256 * 1024

Name = Annotated[str, Field(min_length=1, max_length=100)]
GestureName = Annotated[str, Field(min_length=1, max_length=100)]
CommandId = Annotated[int, Field(ge=0, le=2**31 - 1)]

of_person = in_path("Person", "person")


class Title(RequestBody):
    """The title of a person; left out it stays unchanged, an empty one is removed."""

    title: Annotated[str, Field(max_length=200)] | None = None


class Wearer(RequestBody):
    """The wearer of a glove; null for nobody by name."""

    person: Name | None


class CommandGesture(RequestBody):
    """The gesture of a person for a command; null: no gesture."""

    gesture: GestureName | None


class Recording(RequestBody):
    """An own gesture: a `code`, a part for each hand, two gestures in `sequence`, or a recording.

    For a recording, name the `glove` and either send `frames` (five raw values each, thumb first) or let it
    be recorded now for `recordMs`.
    """

    code: Annotated[str, Field(max_length=5)] | None = None
    left: GestureName | None = None
    right: GestureName | None = None
    sequence: tuple[GestureName, GestureName] | None = None
    glove: Name | None = None
    frames: (
        Annotated[
            list[Annotated[list[FiniteFloat], Field(min_length=5, max_length=5)]],
            Field(max_length=MAX_RECORDED_FRAMES, fail_fast=True),
        ]
        | None
    ) = None
    record_ms: Annotated[int | None, Field(alias="recordMs", ge=200, le=5_000)] = None

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        ways = [
            self.code is not None,
            self.left is not None or self.right is not None,
            self.sequence is not None,
            self.frames is not None or self.record_ms is not None,
        ]
        if sum(ways) != 1 or (self.frames is not None and self.record_ms is not None):
            raise ValueError(
                "give one of code, left and right, sequence, or frames or recordMs of a glove, and no other"
            )
        if ways[3] and self.glove is None:
            raise ValueError("name the glove with which the gesture is made")
        return self


@dataclass(frozen=True, slots=True)
class _Site:
    wearers: Wearers
    gloves: KnownGloves
    records: GloveRecords

    @property
    def people(self) -> People:
        return self.wearers.people

    def require_no_study(self, person: str) -> None:
        self.wearers.conditions.require_none(person=person)


def add_people(app: FastAPI, wearers: Wearers, gloves: KnownGloves, records: GloveRecords) -> None:
    """Add the routes of people."""
    site = _Site(wearers, gloves, records)
    _add_persons(app, site)
    _add_commands(app, site)
    _add_gestures(app, site)
    _add_profiles(app, site)

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
        worn = gloves.named(glove)
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


def _add_persons(app: FastAPI, site: _Site) -> None:
    @app.get("/people", tags=["people"], dependencies=[require(Permission.READ)])
    async def list_people() -> list[PersonView]:
        """List all people with their gloves, commands and own gestures."""
        return [_view(name, site) for name in site.people.names()]

    @app.get("/people/{person}", tags=["people"], dependencies=[require(Permission.READ, of_person)])
    async def one(person: str) -> PersonWithGestures:
        """Return a person with all their gestures."""
        known = site.people.named(person).name
        every = listed(site.people.gestures_of(known), site.people.commands_of(known))
        return {**_view(known, site), "gestures": every}

    @app.put(
        "/people/{person}",
        tags=["people"],
        responses={201: {"model": PersonView}},
        dependencies=[require(Permission.MANAGE_PEOPLE, of_person)],
    )
    async def add(person: str, response: Response, given: Title | None = None) -> PersonView:
        """Add a person, or change their title: 201, or 200 if they were known."""
        response.status_code = 201 if await site.people.add(person, given.title if given else None) else 200
        return _view(person, site)

    @app.delete(
        "/people/{person}",
        tags=["people"],
        status_code=204,
        dependencies=[require(Permission.MANAGE_PEOPLE, of_person)],
    )
    async def remove(person: str) -> Response:
        """Delete a person with their fits; the gloves they wear have no wearer then."""
        site.people.named(person)
        site.require_no_study(person)
        for glove in site.gloves.worn_by(person):
            await site.wearers.wear(glove, None)
        await site.people.remove(person)
        site.records.forget_fits(person)
        return Response(status_code=204)


def _add_commands(app: FastAPI, site: _Site) -> None:
    @app.put(
        "/people/{person}/commands", tags=["people"], dependencies=[require(Permission.CONFIGURE, of_person)]
    )
    async def commands(person: str, given: Mapping[CommandId, GestureName | None]) -> PersonView:
        """Set all own commands of a person: `{"3": "Horns", "8": null}`."""
        site.require_no_study(person)
        await site.people.set_commands(person, given, whole=True)
        return _view(person, site)

    @app.patch(
        "/people/{person}/commands", tags=["people"], dependencies=[require(Permission.CONFIGURE, of_person)]
    )
    async def some_commands(person: str, given: Mapping[CommandId, GestureName | None]) -> PersonView:
        """Set some own commands; the others stay. Send two commands at once to exchange their gestures."""
        site.require_no_study(person)
        await site.people.set_commands(person, given, whole=False)
        return _view(person, site)

    @app.put(
        "/people/{person}/commands/{command}",
        tags=["people"],
        dependencies=[require(Permission.CONFIGURE, of_person)],
    )
    async def command(person: str, command: CommandId, given: CommandGesture) -> PersonView:
        """Set the gesture of a person for one command."""
        site.require_no_study(person)
        await site.people.set_commands(person, {command: given.gesture}, whole=False)
        return _view(person, site)

    @app.delete(
        "/people/{person}/commands/{command}",
        tags=["people"],
        dependencies=[require(Permission.CONFIGURE, of_person)],
    )
    async def reset_command(person: str, command: CommandId) -> PersonView:
        """Use the gesture of the site for a command again."""
        site.require_no_study(person)
        await site.people.reset_command(person, command)
        return _view(person, site)


def _add_gestures(app: FastAPI, site: _Site) -> None:
    @app.put(
        "/people/{person}/gestures/{gesture}",
        tags=["people"],
        responses={201: {"model": DefinedGesture}},
        dependencies=[require(Permission.CONFIGURE, of_person)],
    )
    @max_body(MAX_RECORDING_BYTES)
    async def define(person: str, gesture: str, given: Recording, response: Response) -> DefinedGesture:
        """Define an own gesture of a person: 201, or 200 if it replaces one of that name.

        409 names the gesture that it is too near to, and the distance. 422 names the finger that moved, or
        that is neither bent nor straight.
        """
        site.people.named(person)
        site.require_no_study(person)
        glove = None if given.glove is None else site.gloves.named(given.glove)
        own = await _own(given, glove)
        thresholds = glove.reader.config.thresholds if glove and own.sample else None
        unreliable = list(_unreliable_fingers([glove] if glove else site.gloves.worn_by(person)))
        is_new, nearest = await site.people.define(person, gesture, own, thresholds, unreliable)
        response.status_code = 201 if is_new else 200
        return {"person": person, "name": gesture, **_own_view(own), "nearest": neighbour_view(nearest)}

    @app.delete(
        "/people/{person}/gestures/{gesture}",
        tags=["people"],
        dependencies=[require(Permission.CONFIGURE, of_person)],
    )
    async def drop_gesture(person: str, gesture: str) -> PersonWithFreedCommands:
        """Delete an own gesture of a person; its commands get the gesture of the site again."""
        site.require_no_study(person)
        freed = await site.people.drop_gesture(person, gesture)
        return {**_view(person, site), "givenAsBefore": freed}


def _add_profiles(app: FastAPI, site: _Site) -> None:
    offload = Offload()

    @app.get(
        "/people/{person}/profile.yaml",
        tags=["people"],
        response_class=Response,
        responses=sends(YAML),
        dependencies=[require(Permission.READ, of_person)],
    )
    async def profile(person: str) -> Response:
        """Return the profile of a person as a file, to be imported here or at another site."""
        known = site.people.named(person)
        kept = Profile(known, site.records.fits_of(known.name))
        learnt = [fit.learnt for fit in kept.fits.values()]
        if len(orjson.dumps(learnt)) + 200 * len(known.gestures) <= MAX_INLINE_BYTES:
            text = profile_file.written(kept)
        else:
            text = await offload.run(profile_file.written, kept)
        name = f'attachment; filename="{known.name}.yaml"'
        return Response(text, media_type=YAML, headers={"Content-Disposition": name})

    @app.put(
        "/people/{person}/profile.yaml",
        tags=["people"],
        dependencies=[require(Permission.CONFIGURE, of_person)],
    )
    @accepts(*YAML_TYPES)
    @max_body(2 * MAX_PROFILE_BYTES)
    async def import_profile(person: str, request: Request) -> PersonView:
        """Import a profile in place of everything stored for this person, in one transaction.

        422 names the line, the rule and the remedy. The name in the URL counts, not the one in the file.
        """
        require_person_name(person)
        if person not in site.people.names():
            guard_of(request).require(
                await authenticated(request), Permission.MANAGE_PEOPLE, of_person(request)
            )
        site.require_no_study(person)
        body = bytearray()
        async for chunk in request.stream():
            body += chunk
            if len(body) > MAX_PROFILE_BYTES:
                raise Problem(
                    413,
                    "Too long",
                    message(
                        "people.profile_too_long",
                        "a profile has {limit} bytes at most",
                        limit=MAX_PROFILE_BYTES,
                    ),
                )
        with _profile_errors():
            text = body.decode("utf-8")
            if len(body) <= MAX_INLINE_BYTES:
                given = profile_file.read(text, site.people.site, person=person)
            else:
                given = await offload.run(profile_file.read, text, site.people.site, person=person)
        await site.wearers.import_profile(given.person, given.fits)
        return _view(person, site)


@contextmanager
def _profile_errors() -> Iterator[None]:
    try:
        yield
    except UnicodeDecodeError:
        raise Problem(
            422,
            "Wrong profile",
            message("people.profile_not_utf8", "profile.yaml: not UTF-8 text; save it as UTF-8"),
        ) from None
    except WrongFile as error:
        raise Problem(422, "Wrong profile", text_of(error)) from None
    except OffloadFailed as error:
        raise Problem(
            422,
            "Wrong profile",
            message(
                "people.profile_not_read",
                "profile.yaml cannot be read ({error}); make it smaller",
                error=text_of(error),
            ),
        ) from None


async def _own(recording: Recording, glove: Glove | None) -> OwnGesture:
    if recording.code is not None:
        return OwnGesture(Shape(recording.code))
    if recording.sequence is not None:
        return OwnGesture(Shape(sequence=recording.sequence))
    if glove is None or recording.left is not None or recording.right is not None:
        return OwnGesture(Shape(left=recording.left, right=recording.right))
    frames = recording.frames
    if frames is None:
        frames = await _recorded(glove, recording.record_ms or 0)
    try:
        code, sample = read_sample(glove.name, frames, glove.reader.config.thresholds)
    except UnclearSample as error:
        raise Problem(422, "Unclear gesture", text_of(error)) from None
    return OwnGesture(Shape(code), sample)


async def _recorded(glove: Glove, for_ms: int) -> list[list[float]]:
    """Return the frames of the next `for_ms`."""
    frames: list[list[float]] = []
    before = counted = glove.connection.traffic.frames

    def record(_: bool) -> None:
        nonlocal counted
        is_new = glove.connection.traffic.frames > counted
        if glove.reader.bend is not None and is_new and len(frames) < MAX_RECORDED_FRAMES:
            counted = glove.connection.traffic.frames
            frames.append(glove.reader.state.drift.corrected(glove.reader.bend))

    glove.observers.watchers.add(record)
    try:
        await asyncio.sleep(for_ms / 1000)
    finally:
        glove.observers.watchers.discard(record)
    if glove.connection.traffic.frames == before:
        raise Problem(
            409,
            "Glove silent",
            message(
                "people.glove_silent",
                "{glove} has sent nothing for {seconds} s; put it on and switch it on first",
                glove=glove.name,
                seconds=f"{for_ms / 1000:g}",
            ),
        )
    return frames


def _unreliable_fingers(worn: list[Glove]) -> Iterator[str]:
    for glove in worn:
        if glove.reader.config.calibration is not None:
            yield from (fault.finger for fault in find_lasting_faults(glove.reader.config.calibration))


def _view(name: str, site: _Site) -> PersonView:
    person = site.people.named(name)
    commands = site.people.commands_of(name)
    return {
        "name": person.name,
        "title": person.title,
        "gloves": [
            {"glove": glove.name, "hand": cast("Side", glove.hand), "connected": glove.is_connected}
            for glove in site.gloves.worn_by(name)
        ],
        "fits": {glove: _fit_view(fit) for glove, fit in site.records.fits_of(name).items()},
        "commands": {str(command): gesture for command, gesture in sorted(commands.gestures.items())},
        "ownCommands": {str(command): gesture for command, gesture in person.commands.items()},
        "ownGestures": {gesture: _own_view(own) for gesture, own in person.gestures.items()},
        "faults": site.people.faults_of(name),
    }


def _own_view(own: OwnGesture) -> OwnGestureView:
    return cast("OwnGestureView", own.as_dict())


def _fit_view(fit: Fit) -> FitView:
    thresholds = cast("Any", fit.thresholds.as_dict()) if fit.thresholds else None
    return {"thresholds": thresholds, "recognizer": fit.recognizer, "changedAt": fit.changed_at or None}
