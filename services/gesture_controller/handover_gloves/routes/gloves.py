"""REST and streams of gloves: their state, their tokens, and what their wearers do."""

import asyncio
from typing import Annotated, Any, Literal

from fastapi import FastAPI, Response, WebSocket
from fastapi.responses import StreamingResponse
from pydantic import Field
from starlette.requests import HTTPConnection

from handover.errors import Problem
from handover.formats.strict_json import RequestBody
from handover.http.api_description import TaggedRoutes, sends
from handover.http.websocket_closing import close_websocket
from handover.security.act_recording import lowers
from handover.security.caller import Caller
from handover.security.guard import Guard, ResourceOf, guard_of, in_path, require
from handover.security.permissions import Permission
from handover.security.proofs.pin_check import MAX_PIN_CHARACTERS, require_pin
from handover_datamodels.states import Outcome
from handover_gloves.connection.glove_registry import GloveRegistry
from handover_gloves.connection.live import send_views, stream_frames
from handover_gloves.gloves.glove import Glove
from handover_gloves.gloves.glove_view import view_of
from handover_gloves.gloves.known_gloves import KnownGloves
from handover_gloves.prompting.prompt import CannotComplete

GloveView = dict[str, Any]
MAX_NOTE = 500
NO_CONTROL_CHARACTERS = r"^[^\x00-\x08\x0b-\x1f\x7f]*$"
"""Matches text without control characters other than tabs and line feeds."""
of_glove = in_path("Device", "glove")


class Declaration(RequestBody):
    """A glove that is declared before its first hello."""

    hand: Literal["left", "right"] | None = None
    person: Annotated[str, Field(min_length=1)] | None = None


class Modes(RequestBody):
    """The modes to change; a mode that is left out stays unchanged."""

    testing: bool | None = None
    filtering: bool | None = None


class Completion(RequestBody):
    """An answer on the screen; `task` is the Task that the person saw, the current one if left out."""

    by: Annotated[str, Field(min_length=1, max_length=100)]
    task: Annotated[str, Field(max_length=500)] | None = None
    outcome: Outcome = Outcome.OK
    note: Annotated[str, Field(max_length=MAX_NOTE, pattern=NO_CONTROL_CHARACTERS)] | None = None


class GivenPin(RequestBody):
    """The PIN of the person who answers a Task; `task` is the Task that the person saw."""

    pin: Annotated[str, Field(min_length=1, max_length=MAX_PIN_CHARACTERS)]
    task: Annotated[str, Field(max_length=500)] | None = None


def add_gloves(app: FastAPI, registry: GloveRegistry) -> None:
    """Add the routes of gloves and their tokens."""
    routes = TaggedRoutes(app, "gloves")
    gloves = registry.known

    @routes.get("/gloves", dependencies=[require(Permission.READ)])
    async def list_gloves() -> list[GloveView]:
        """Return the state of every glove."""
        return [glove_view(glove) for glove in gloves]

    @routes.get("/gloves/{glove}", dependencies=[require(Permission.READ, of_glove)])
    async def get_glove(glove: str) -> GloveView:
        """Return the state of a glove."""
        return glove_view(gloves.named(glove))

    @routes.put(
        "/gloves/{glove}",
        responses={201: {"model": GloveView}},
        dependencies=[require(Permission.CONFIGURE, of_glove)],
    )
    async def declare(glove: str, declaration: Declaration, response: Response) -> GloveView:
        """Declare a glove before its first hello: 201, or 200 if it was known."""
        declared, is_new = await registry.declare(glove, declaration.hand, declaration.person)
        response.status_code = 201 if is_new else 200
        return glove_view(declared)

    @routes.put("/gloves/{glove}/token", dependencies=[require(Permission.CONFIGURE, of_glove)])
    async def set_token(glove: str) -> dict[str, str]:
        """Make a new token for a glove in place of an older one, and show it once.

        From now on the glove connects only with it, and counts as declared. Its present connection ends.
        """
        return {"glove": glove, "token": await registry.set_token(glove)}

    @routes.delete(
        "/gloves/{glove}/token", status_code=204, dependencies=[require(Permission.CONFIGURE, of_glove)]
    )
    async def remove_token(glove: str) -> None:
        """Remove the token of a glove; its connection ends, and the rules without a token apply."""
        await registry.remove_token(gloves.named(glove))


def add_actions(app: FastAPI, gloves: KnownGloves, guard: Guard) -> None:
    """Add what wearers do: modes, pauses, answers on the screen."""
    routes = TaggedRoutes(app, "actions")
    of_wearer = _of_glove_or_wearer(gloves)

    @routes.put("/gloves/{glove}/modes", dependencies=[require(Permission.CONFIGURE, of_glove)])
    async def switch(glove: str, modes: Modes) -> GloveView:
        """Switch testing (nothing completes a Task) and filtering (only the prompted gesture counts)."""
        gloves.named(glove).switch(testing=modes.testing, filtering=modes.filtering)
        return glove_view(gloves.named(glove))

    @routes.post("/gloves/{glove}/pause", dependencies=[require(Permission.PERFORM_TASKS, of_wearer)])
    @lowers()
    async def pause(glove: str) -> GloveView:
        """Let nothing count, and pause the Task, until resumed."""
        gloves.named(glove).pause()
        return glove_view(gloves.named(glove))

    @routes.post("/gloves/{glove}/resume", dependencies=[require(Permission.PERFORM_TASKS, of_wearer)])
    async def resume(glove: str) -> GloveView:
        """End a pause; one that was requested on the Task itself stays."""
        gloves.named(glove).resume()
        return glove_view(gloves.named(glove))

    @routes.post("/gloves/{glove}/complete")
    async def complete(
        caller: Annotated[Caller, require(Permission.PERFORM_TASKS, of_wearer)],
        glove: str,
        completion: Completion,
    ) -> GloveView:
        """Answer the Task on the screen: `ok`, `notGood` or `problem`, with an optional note.

        With another outcome than `ok` the Task ends `failed`, unless its definition handles outcomes.
        """
        note = (completion.note or "").strip() or None
        try:
            gloves.named(glove).responder.complete_on_screen(
                caller.acting_name(completion.by),
                _now_s(),
                completion.task,
                completion.outcome,
                note,
                performed_by=caller.person,
            )
        except CannotComplete as error:
            raise Problem(409, "Cannot complete", str(error)) from None
        return glove_view(gloves.named(glove))

    @routes.post("/gloves/{glove}/pin")
    async def give_pin(
        caller: Annotated[Caller, require(Permission.PERFORM_TASKS, of_wearer)], glove: str, proof: GivenPin
    ) -> GloveView:
        """Give the own PIN for a Task that demands it; then a gesture or the screen answers the Task."""
        responder = gloves.named(glove).responder
        try:
            task = responder.completable(proof.task).spec.task_id
            responder.give_pin(await require_pin(guard, caller, proof.pin, task), task)
        except CannotComplete as error:
            raise Problem(409, "Cannot complete", str(error)) from None
        return glove_view(gloves.named(glove))


def add_streams(app: FastAPI, gloves: KnownGloves) -> None:
    """Add the streams of raw frames and of the state of a glove."""

    @app.get(
        "/gloves/{glove}/frames",
        tags=["streams"],
        response_class=StreamingResponse,
        responses=sends("application/x-ndjson"),
        dependencies=[require(Permission.READ, of_glove)],
    )
    async def frames(glove: str) -> StreamingResponse:
        """Stream the hello of the glove and then its raw frames, one JSON object a line."""
        return StreamingResponse(stream_frames(gloves.named(glove)), media_type="application/x-ndjson")

    @app.websocket("/gloves/{glove}/live", dependencies=[require(Permission.READ, of_glove)])
    async def live(screen: WebSocket, glove: str) -> None:
        try:
            followed = gloves.named(glove)
        except Problem as problem:
            await screen.accept()
            await close_websocket(screen, 4404, problem.detail)
            return
        await send_views(followed, screen)


def _of_glove_or_wearer(gloves: KnownGloves) -> ResourceOf:
    def resources(connection: HTTPConnection) -> tuple[str, ...]:
        name, settings = str(connection.path_params["glove"]), guard_of(connection).settings
        glove = gloves.get(name)
        worn = () if glove is None or glove.person is None else (settings.entity_id("Person", glove.person),)
        return (settings.entity_id("Device", name), *worn)

    resources.__doc__ = "Device `{glove}`, or the Person who wears it"
    return resources


def glove_view(glove: Glove) -> GloveView:
    """Return the view of a glove at this moment."""
    return view_of(glove, _now_s())


def _now_s() -> float:
    return asyncio.get_running_loop().time()
