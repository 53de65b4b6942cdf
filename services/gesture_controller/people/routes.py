"""REST of people: who there is, who wears which glove, which gesture is whose, and profiles as files."""

import asyncio
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Annotated, Any, Self

import orjson
from fastapi import FastAPI, Request, Response
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from handover.body_limit import max_body
from handover.errors import Problem
from handover.messages import message, text_of
from handover.offload import Offload, OffloadFailed
from handover.service import YAML_TYPES, accepts
from services.gesture_controller.calibration.doubts import lasting_doubts
from services.gesture_controller.gestures import Shape, listed
from services.gesture_controller.glove import Glove
from services.gesture_controller.glove_store import Fit
from services.gesture_controller.gloves import Gloves
from services.gesture_controller.lined_yaml import WrongFile
from services.gesture_controller.people import profile_file
from services.gesture_controller.people.people import People, neighbour_view, require_person_name
from services.gesture_controller.people.person import OwnGesture
from services.gesture_controller.people.profile_file import Profile
from services.gesture_controller.people.sample import UnclearSample, read_sample

YAML = "application/yaml"
LONGEST_PROFILE = 1_000_000
"""Bytes of a profile at most."""
MAX_READ_IN_PLACE = 4_096
"""A longer profile is read and written by a process of its own: it could hold up every glove."""
MOST_FRAMES = 2_000
MAX_RECORDING_BYTES = 256 * 1024

Name = Annotated[str, Field(min_length=1, max_length=100)]
GestureName = Annotated[str, Field(min_length=1, max_length=100)]
CommandId = Annotated[int, Field(ge=0, le=2**31 - 1)]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Title(_Body):
    """What people call a person; left out it stays, empty it goes."""

    title: Annotated[str, Field(max_length=200)] | None = None


class Wearer(_Body):
    """Who wears a glove; null for nobody by name."""

    person: Name | None


class CommandGesture(_Body):
    """The gesture that a person likes for a command; null: none at all."""

    gesture: GestureName | None


class Recording(_Body):
    """A gesture as a person likes it: a `code`, a part for each hand, two in `sequence`, or made for us.

    To make it, name the `glove` and either send `frames` (five raw values each, thumb first) or let it be
    recorded now for `recordMs`.
    """

    code: Annotated[str, Field(max_length=5)] | None = None
    left: GestureName | None = None
    right: GestureName | None = None
    sequence: tuple[GestureName, GestureName] | None = None
    glove: Name | None = None
    frames: (
        Annotated[
            list[Annotated[list[FiniteFloat], Field(min_length=5, max_length=5)]],
            Field(max_length=MOST_FRAMES, fail_fast=True),
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


def add_people(app: FastAPI, people: People, gloves: Gloves) -> None:
    """Add the routes of people."""
    _add_persons(app, people, gloves)
    _add_commands(app, people, gloves)
    _add_gestures(app, people, gloves)
    _add_profiles(app, people, gloves)

    @app.put("/gloves/{glove}/person", tags=["people"])
    async def wear(glove: str, wearer: Wearer) -> dict[str, Any]:
        """Choose who wears a glove: their fit, gestures and commands apply at once, a Task in hand goes on.

        Another glove of the same hand that they wore is nobody's then.
        """
        worn = gloves.named(glove)
        if wearer.person is not None:
            people.named(wearer.person)
        if wearer.person != worn.person:
            gloves.require_free(glove=worn.name, person=worn.person)
            gloves.require_free(person=wearer.person)
        await gloves.wear(worn, wearer.person)
        return {"glove": worn.name, "hand": worn.hand, "person": worn.person}


def _add_persons(app: FastAPI, people: People, gloves: Gloves) -> None:
    @app.get("/people", tags=["people"])
    async def everybody() -> list[dict[str, Any]]:
        """List all people: what they wear, the commands as they give them, the gestures of their own."""
        return [_view(name, people, gloves) for name in people.names()]

    @app.get("/people/{person}", tags=["people"])
    async def one(person: str) -> dict[str, Any]:
        """Return a person, with all gestures that they can make."""
        known = people.named(person).name
        every = listed(people.gestures_of(known), people.commands_of(known))
        return {**_view(known, people, gloves), "gestures": every}

    @app.put("/people/{person}", tags=["people"])
    async def add(person: str, response: Response, given: Title | None = None) -> dict[str, Any]:
        """Make a person known, or call them otherwise: 201, or 200 if they were known."""
        response.status_code = 201 if await people.add(person, given.title if given else None) else 200
        return _view(person, people, gloves)

    @app.delete("/people/{person}", tags=["people"], status_code=204)
    async def remove(person: str) -> Response:
        """Forget what is a person's own, how gloves fit them included; gloves they wear are nobody's."""
        people.named(person)
        gloves.require_free(person=person)
        for glove in gloves.worn_by(person):
            await gloves.wear(glove, None)
        await people.remove(person)
        gloves.forget_fits(person)
        return Response(status_code=204)


def _add_commands(app: FastAPI, people: People, gloves: Gloves) -> None:
    @app.put("/people/{person}/commands", tags=["people"])
    async def commands(person: str, given: Mapping[CommandId, GestureName | None]) -> dict[str, Any]:
        """Set all commands that a person gives otherwise than the site: `{"3": "Horns", "8": null}`."""
        gloves.require_free(person=person)
        await people.give_commands(person, given, whole=True)
        return _view(person, people, gloves)

    @app.patch("/people/{person}/commands", tags=["people"])
    async def some_commands(person: str, given: Mapping[CommandId, GestureName | None]) -> dict[str, Any]:
        """Set some of them; the others stay. Two gestures are exchanged by giving both commands at once."""
        gloves.require_free(person=person)
        await people.give_commands(person, given, whole=False)
        return _view(person, people, gloves)

    @app.put("/people/{person}/commands/{command}", tags=["people"])
    async def command(person: str, command: CommandId, given: CommandGesture) -> dict[str, Any]:
        """Set the gesture that a person likes for one command."""
        gloves.require_free(person=person)
        await people.give_commands(person, {command: given.gesture}, whole=False)
        return _view(person, people, gloves)

    @app.delete("/people/{person}/commands/{command}", tags=["people"])
    async def take_back(person: str, command: CommandId) -> dict[str, Any]:
        """Give a command as the site has it again."""
        gloves.require_free(person=person)
        await people.take_command_back(person, command)
        return _view(person, people, gloves)


def _add_gestures(app: FastAPI, people: People, gloves: Gloves) -> None:
    @app.put("/people/{person}/gestures/{gesture}", tags=["people"])
    @max_body(MAX_RECORDING_BYTES)
    async def define(person: str, gesture: str, given: Recording, response: Response) -> dict[str, Any]:
        """Define a gesture of a person's own: 201, or 200 in place of the one of that name.

        409 if it is too near another: which one, and how far, is said. Frames in which the hand moved, or in
        which a finger is neither bent nor straight, are refused with the finger's name.
        """
        people.named(person)
        gloves.require_free(person=person)
        glove = None if given.glove is None else gloves.named(given.glove)
        own = await _own(given, glove)
        thresholds = glove.senses.thresholds if glove and own.sample else None
        doubtful = list(_doubtful([glove] if glove else gloves.worn_by(person)))
        is_new, nearest = await people.define(person, gesture, own, thresholds, doubtful)
        response.status_code = 201 if is_new else 200
        return {"person": person, "name": gesture, **own.as_dict(), "nearest": neighbour_view(nearest)}

    @app.delete("/people/{person}/gestures/{gesture}", tags=["people"])
    async def drop(person: str, gesture: str) -> dict[str, Any]:
        """Delete a gesture of a person's own; commands shown with it are shown as the site has them again."""
        gloves.require_free(person=person)
        freed = await people.drop_gesture(person, gesture)
        return {**_view(person, people, gloves), "givenAsBefore": freed}


def _add_profiles(app: FastAPI, people: People, gloves: Gloves) -> None:
    offload = Offload()

    @app.get("/people/{person}/profile.yaml", tags=["people"], response_class=Response)
    async def profile(person: str) -> Response:
        """Return all that is kept of a person as a file, to be imported here or at another site."""
        known = people.named(person)
        kept = Profile(known, gloves.fits_of(known.name))
        learnt = [fit.learnt for fit in kept.fits.values()]
        if len(orjson.dumps(learnt)) + 200 * len(known.gestures) <= MAX_READ_IN_PLACE:
            text = profile_file.written(kept)
        else:
            text = await offload.run(profile_file.written, kept)
        name = f'attachment; filename="{known.name}.yaml"'
        return Response(text, media_type=YAML, headers={"Content-Disposition": name})

    @app.put("/people/{person}/profile.yaml", tags=["people"])
    @accepts(*YAML_TYPES)
    @max_body(2 * LONGEST_PROFILE)
    async def take_in(person: str, request: Request) -> dict[str, Any]:
        """Import a profile, in place of all that was this person's own; all of it or nothing.

        422 names the line, the rule and the way out. The name in the address counts.
        """
        require_person_name(person)
        gloves.require_free(person=person)
        body = bytearray()
        async for chunk in request.stream():
            body += chunk
            if len(body) > LONGEST_PROFILE:
                raise Problem(
                    413,
                    "Too long",
                    message(
                        "people.profile_too_long",
                        "a profile has {limit} bytes at most",
                        limit=LONGEST_PROFILE,
                    ),
                )
        with _said_plainly():
            text = body.decode("utf-8")
            if len(body) <= MAX_READ_IN_PLACE:
                given = profile_file.read(text, people.site, person=person)
            else:
                given = await offload.run(profile_file.read, text, people.site, person=person)
        await gloves.take_in(given.person, given.fits)
        return _view(person, people, gloves)


@contextmanager
def _said_plainly() -> Iterator[None]:
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


async def _own(given: Recording, glove: Glove | None) -> OwnGesture:
    if given.code is not None:
        return OwnGesture(Shape(given.code))
    if given.sequence is not None:
        return OwnGesture(Shape(sequence=given.sequence))
    if glove is None or given.left is not None or given.right is not None:
        return OwnGesture(Shape(left=given.left, right=given.right))
    frames = given.frames if given.frames is not None else await _recorded(glove, given.record_ms or 0)
    try:
        code, sample = read_sample(glove.name, frames, glove.senses.thresholds)
    except UnclearSample as error:
        raise Problem(422, "Unclear gesture", text_of(error)) from None
    return OwnGesture(Shape(code), sample)


async def _recorded(glove: Glove, for_ms: int) -> list[list[float]]:
    """Return the frames that come within the next `for_ms`."""
    frames: list[list[float]] = []
    before = counted = glove.frames

    def record(_: bool) -> None:
        nonlocal counted
        if glove.bend is not None and glove.frames > counted and len(frames) < MOST_FRAMES:
            counted = glove.frames
            frames.append(glove.sight.drift.corrected(glove.bend))

    glove.watchers.add(record)
    try:
        await asyncio.sleep(for_ms / 1000)
    finally:
        glove.watchers.discard(record)
    if glove.frames == before:
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


def _doubtful(worn: list[Glove]) -> Iterator[str]:
    for glove in worn:
        if glove.senses.calibration is not None:
            yield from (doubt.finger for doubt in lasting_doubts(glove.senses.calibration))


def _view(name: str, people: People, gloves: Gloves) -> dict[str, Any]:
    person = people.named(name)
    given = people.commands_of(name)
    return {
        "name": person.name,
        "title": person.title,
        "gloves": [
            {"glove": glove.name, "hand": glove.hand, "connected": glove.connected}
            for glove in gloves.worn_by(name)
        ],
        "fits": {glove: _fit_view(fit) for glove, fit in gloves.fits_of(name).items()},
        "commands": {str(command): gesture for command, gesture in sorted(given.gestures.items())},
        "ownCommands": {str(command): gesture for command, gesture in person.commands.items()},
        "ownGestures": {gesture: own.as_dict() for gesture, own in person.gestures.items()},
        "faults": people.faults_of(name),
    }


def _fit_view(fit: Fit) -> dict[str, Any]:
    thresholds = fit.thresholds.as_dict() if fit.thresholds else None
    return {"thresholds": thresholds, "recognizer": fit.recognizer, "changedAt": fit.changed_at or None}
