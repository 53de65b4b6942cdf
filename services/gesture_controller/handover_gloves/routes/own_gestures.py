"""REST of the own gestures of people, also recorded ones."""

import asyncio
from collections.abc import Iterator
from typing import Annotated, Self

from fastapi import FastAPI, Response
from pydantic import Field, FiniteFloat, model_validator

from handover.errors import Problem
from handover.formats.strict_json import RequestBody
from handover.http.api_description import TaggedRoutes
from handover.http.body_limit import max_body
from handover.messages import text_of
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_gloves.calibration.sensor_diagnostics import find_lasting_faults
from handover_gloves.gloves.glove import Glove
from handover_gloves.people.people import neighbour_view
from handover_gloves.people.person import OwnGesture
from handover_gloves.people.sample import UnclearSample, read_sample
from handover_gloves.people.views import DefinedGesture, PersonWithFreedCommands
from handover_gloves.recognition.gestures import Shape
from handover_gloves.routes.people_views import (
    GestureName,
    Name,
    PeopleParts,
    of_person,
    own_gesture_view,
    person_view,
)

MAX_RECORDED_FRAMES = 2_000
MAX_RECORDING_BYTES = 256 * 1024


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


def add_own_gestures(app: FastAPI, parts: PeopleParts) -> None:
    """Add the routes of own gestures."""
    routes = TaggedRoutes(app, "people")

    @routes.put(
        "/people/{person}/gestures/{gesture}",
        responses={201: {"model": DefinedGesture}},
        dependencies=[require(Permission.CONFIGURE, of_person)],
    )
    @max_body(MAX_RECORDING_BYTES)
    async def define(person: str, gesture: str, recording: Recording, response: Response) -> DefinedGesture:
        """Define an own gesture of a person: 201, or 200 if it replaces one of that name.

        409 names the gesture that it is too near to, and the distance. 422 names the finger that moved, or
        that is neither bent nor straight.
        """
        parts.people.named(person)
        parts.require_no_study(person)
        glove = None if recording.glove is None else parts.gloves.named(recording.glove)
        own = await _own(recording, glove)
        thresholds = glove.reader.config.thresholds if glove and own.sample else None
        unreliable = list(_unreliable_fingers([glove] if glove else parts.gloves.worn_by(person)))
        is_new, nearest = await parts.people.define(person, gesture, own, thresholds, unreliable)
        response.status_code = 201 if is_new else 200
        return {
            "person": person,
            "name": gesture,
            **own_gesture_view(own),
            "nearest": neighbour_view(nearest),
        }

    @routes.delete(
        "/people/{person}/gestures/{gesture}", dependencies=[require(Permission.CONFIGURE, of_person)]
    )
    async def drop_gesture(person: str, gesture: str) -> PersonWithFreedCommands:
        """Delete an own gesture of a person; its commands get the gesture of the site again."""
        parts.require_no_study(person)
        freed = await parts.people.drop_gesture(person, gesture)
        return {**person_view(person, parts), "givenAsBefore": freed}


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
        raise Problem.translated(
            409,
            "Glove silent",
            "people.glove_silent",
            "{glove} has sent nothing for {seconds} s; put it on and switch it on first",
            glove=glove.name,
            seconds=f"{for_ms / 1000:g}",
        )
    return frames


def _unreliable_fingers(worn: list[Glove]) -> Iterator[str]:
    for glove in worn:
        if glove.reader.config.calibration is not None:
            yield from (fault.finger for fault in find_lasting_faults(glove.reader.config.calibration))
