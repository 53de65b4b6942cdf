"""The gesture controller: REST and WebSocket for screens and programs, TCP for gloves."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Annotated, Any, Literal, cast

from fastapi import FastAPI, Response, WebSocket
from fastapi.responses import StreamingResponse
from pydantic import Field, FiniteFloat
from starlette.requests import HTTPConnection

from handover.broker import BrokerClient
from handover.errors import Problem
from handover.formats.strict_json import RequestBody, StrictJson
from handover.http.api_description import sends
from handover.http.body_limit import max_body
from handover.http.websocket_closing import close_websocket
from handover.runtime.ports import require_free
from handover.security.act_recording import lowers
from handover.security.audit_trail import AuditTrail
from handover.security.caller import Caller
from handover.security.guard import Guard, ResourceOf, guard_of, require, require_somewhere
from handover.security.permissions import Permission
from handover.security.pin_check import MAX_PIN_CHARACTERS, require_pin
from handover.security.protection import require_protection
from handover.serving.service import create_app
from handover.serving.storage import storage_check
from handover.telemetry import get_logger
from handover_datamodels.states import Outcome
from handover_gloves.accuracy_tests.accuracy_test_runner import AccuracyTestRunner
from handover_gloves.accuracy_tests.routes import add_accuracy_tests
from handover_gloves.accuracy_tests.store import AccuracyTestStore
from handover_gloves.calibration.calibration_session import CalibrationSessions
from handover_gloves.calibration.routes import MAX_FRAMES_BYTES, Frames, add_calibration, of_glove
from handover_gloves.configuration import gestures_file
from handover_gloves.connection.glove_registry import GloveRegistry
from handover_gloves.connection.glove_server import GloveServer
from handover_gloves.connection.live import send_views, stream_frames
from handover_gloves.controller import GestureController
from handover_gloves.gloves.glove import Glove
from handover_gloves.gloves.glove_view import view_of
from handover_gloves.gloves.known_gloves import KnownGloves
from handover_gloves.people.routes import add_people
from handover_gloves.people.station_joins import StationJoins
from handover_gloves.people.study_condition_routes import add_study_conditions
from handover_gloves.pictures.routes import add_pictures, picture_urls
from handover_gloves.prompting.prompt import CannotComplete
from handover_gloves.recognition.gesture_views import CompositeSiteGesture, PlainSiteGesture
from handover_gloves.recognition.gestures import listed
from handover_gloves.settings import ControllerSettings

log = get_logger(__name__)

GloveView = dict[str, Any]


MAX_NOTE = 500
NO_CONTROL_CHARACTERS = r"^[^\x00-\x08\x0b-\x1f\x7f]*$"
"""Matches text without control characters other than tabs and line feeds."""


Thresholds = Annotated[dict[str, dict[str, FiniteFloat]], StrictJson()]


class Declaration(RequestBody):
    """A glove that is declared before its first hello."""

    hand: Literal["left", "right"] | None = None
    person: Annotated[str, Field(min_length=1)] | None = None


class CalibrationFrames(RequestBody):
    """Frames of a fist and of an open hand, five raw values each, thumb first."""

    fist: Frames
    open: Frames


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


def make_app(settings: ControllerSettings) -> FastAPI:
    """Return the application; raise `UsageError` if it cannot work with these settings."""
    require_protection(settings, settings.glove_host, "HANDOVER_GLOVE_HOST")
    require_free(settings.glove_host, settings.glove_port, "HANDOVER_GLOVE_PORT", say=log.warning)
    guard = Guard(settings, "gesture-controller")
    broker = BrokerClient(settings, credentials=guard.access)
    site = gestures_file.load(settings.gestures_file)
    for restriction in site.restricted_answers():
        log.warning("some Tasks do not offer an answer by gesture", reason=restriction)
    joins = StationJoins(guard)
    controller = GestureController(settings, site, broker, joins)
    if not settings.is_local and settings.token is None:
        log.warning(
            "gloves need their own tokens",
            host=settings.glove_host,
            remedy="handover glove token NAME, or set HANDOVER_GLOVE_TOKEN for all",
        )
    registry, gestures = controller.registry, controller.configuration.gestures
    accuracy_tests = AccuracyTestRunner(AccuracyTestStore(controller.database), registry.known, gestures)
    calibrations = CalibrationSessions(registry.known, registry.fits, controller.calibrations)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with broker, controller, accuracy_tests, GloveServer(settings, registry):
            yield

    app = create_app(
        "Gesture controller",
        description=__doc__ or "",
        lifespan=lifespan,
        checks={
            "broker": broker.probe,
            "tasks": controller.probe,
            "storage": storage_check(settings.data_dir),
        },
        guard=guard,
        audit=AuditTrail(settings, "gesture-controller", controller.database),
    )
    controller.mount(app)
    _add_gestures(app, controller)
    add_pictures(app, gestures)
    _add_gloves(app, registry)
    add_people(app, registry.wearers, registry.known, registry.records)
    add_calibration(app, calibrations, registry.known)
    _add_fits(app, registry)
    _add_actions(app, registry.known, guard)
    _add_streams(app, registry.known)
    add_accuracy_tests(app, accuracy_tests, registry.known)
    add_study_conditions(app, registry.wearers)
    return app


def _add_gestures(app: FastAPI, controller: GestureController) -> None:
    @app.get("/gestures", tags=["gestures"], dependencies=[require_somewhere(Permission.READ)])
    async def gestures() -> list[PlainSiteGesture | CompositeSiteGesture]:
        """List the gestures of the site: name, code (thumb first, 0 straight, 2 bent), command and pictures.

        A composite gesture has no code but `left` and `right`, or `sequence`; each part has its code.
        """
        found = listed(controller.configuration.gestures, controller.configuration.commands)
        return [
            cast("PlainSiteGesture | CompositeSiteGesture", {**one, "pictures": picture_urls(one["name"])})
            for one in found
        ]

    @app.get("/specifications", tags=["operations"], dependencies=[require(Permission.READ)])
    async def specifications() -> dict[str, str]:
        """Return the URL and the state of the database for TaskDefinitions that the broker does not have."""
        database = controller.specifications
        return {
            "database": database.shown,
            "state": database.state.name,
            "detail": database.state.detail,
        }


def _add_gloves(app: FastAPI, registry: GloveRegistry) -> None:
    known = registry.known

    @app.get("/gloves", tags=["gloves"], dependencies=[require(Permission.READ)])
    async def list_gloves() -> list[GloveView]:
        """Return the state of every glove."""
        return [_view(glove) for glove in known]

    @app.get("/gloves/{glove}", tags=["gloves"], dependencies=[require(Permission.READ, of_glove)])
    async def get_glove(glove: str) -> GloveView:
        """Return the state of a glove."""
        return _view(known.named(glove))

    @app.put(
        "/gloves/{glove}",
        tags=["gloves"],
        responses={201: {"model": GloveView}},
        dependencies=[require(Permission.CONFIGURE, of_glove)],
    )
    async def declare(glove: str, declaration: Declaration, response: Response) -> GloveView:
        """Declare a glove before its first hello: 201, or 200 if it was known."""
        declared, is_new = await registry.declare(glove, declaration.hand, declaration.person)
        response.status_code = 201 if is_new else 200
        return _view(declared)

    @app.put("/gloves/{glove}/token", tags=["gloves"], dependencies=[require(Permission.CONFIGURE, of_glove)])
    async def set_token(glove: str) -> dict[str, str]:
        """Make a new token for a glove in place of an older one, and show it once.

        From now on the glove connects only with it, and counts as declared. Its present connection ends.
        """
        return {"glove": glove, "token": await registry.set_token(glove)}

    @app.delete(
        "/gloves/{glove}/token",
        status_code=204,
        tags=["gloves"],
        dependencies=[require(Permission.CONFIGURE, of_glove)],
    )
    async def remove_token(glove: str) -> None:
        """Remove the token of a glove; its connection ends, and the rules without a token apply."""
        await registry.remove_token(known.named(glove))


def _add_fits(app: FastAPI, registry: GloveRegistry) -> None:
    known, fits = registry.known, registry.fits

    @app.put(
        "/gloves/{glove}/thresholds",
        tags=["calibration"],
        dependencies=[require(Permission.CONFIGURE, of_glove)],
    )
    async def set_thresholds(glove: str, thresholds: Thresholds) -> GloveView:
        """Set and store the thresholds of some or all fingers."""
        await fits.set_thresholds(known.named(glove), thresholds)
        return _view(known.named(glove))

    @app.post(
        "/gloves/{glove}/thresholds/restore",
        tags=["calibration"],
        dependencies=[require(Permission.CONFIGURE, of_glove)],
    )
    async def restore(glove: str) -> GloveView:
        """Exchange the thresholds with those before the last change."""
        await fits.restore(known.named(glove))
        return _view(known.named(glove))

    @app.post(
        "/gloves/{glove}/calibration",
        tags=["calibration"],
        dependencies=[require(Permission.CONFIGURE, of_glove)],
    )
    @max_body(2 * MAX_FRAMES_BYTES)
    async def calibrate(glove: str, frames: CalibrationFrames) -> dict[str, Any]:
        """Calculate and store thresholds from frames of a fist and of an open hand."""
        calibration = await fits.calibrate(known.named(glove), frames.fist, frames.open)
        return {"thresholds": calibration.thresholds.as_dict(), "levels": calibration.as_dict()}


def _add_actions(app: FastAPI, known: KnownGloves, guard: Guard) -> None:
    of_wearer = _of_glove_or_wearer(known)

    @app.put(
        "/gloves/{glove}/modes", tags=["actions"], dependencies=[require(Permission.CONFIGURE, of_glove)]
    )
    async def switch(glove: str, modes: Modes) -> GloveView:
        """Switch testing (nothing completes a Task) and filtering (only the prompted gesture counts)."""
        known.named(glove).switch(testing=modes.testing, filtering=modes.filtering)
        return _view(known.named(glove))

    @app.post(
        "/gloves/{glove}/pause", tags=["actions"], dependencies=[require(Permission.PERFORM_TASKS, of_wearer)]
    )
    @lowers()
    async def pause(glove: str) -> GloveView:
        """Let nothing count, and pause the Task, until resumed."""
        known.named(glove).pause()
        return _view(known.named(glove))

    @app.post(
        "/gloves/{glove}/resume",
        tags=["actions"],
        dependencies=[require(Permission.PERFORM_TASKS, of_wearer)],
    )
    async def resume(glove: str) -> GloveView:
        """End a pause; one that was requested on the Task itself stays."""
        known.named(glove).resume()
        return _view(known.named(glove))

    @app.post("/gloves/{glove}/complete", tags=["actions"])
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
            known.named(glove).responder.complete_on_screen(
                caller.acting_name(completion.by),
                _now_s(),
                completion.task,
                completion.outcome,
                note,
                performed_by=caller.person,
            )
        except CannotComplete as error:
            raise Problem(409, "Cannot complete", str(error)) from None
        return _view(known.named(glove))

    @app.post("/gloves/{glove}/pin", tags=["actions"])
    async def give_pin(
        caller: Annotated[Caller, require(Permission.PERFORM_TASKS, of_wearer)], glove: str, given: GivenPin
    ) -> GloveView:
        """Give the own PIN for a Task that demands it; then a gesture or the screen answers the Task."""
        responder = known.named(glove).responder
        try:
            task = responder.completable(given.task).spec.task_id
            responder.give_pin(await require_pin(guard, caller, given.pin, task), task)
        except CannotComplete as error:
            raise Problem(409, "Cannot complete", str(error)) from None
        return _view(known.named(glove))


def _add_streams(app: FastAPI, known: KnownGloves) -> None:
    @app.get(
        "/gloves/{glove}/frames",
        tags=["streams"],
        response_class=StreamingResponse,
        responses=sends("application/x-ndjson"),
        dependencies=[require(Permission.READ, of_glove)],
    )
    async def frames(glove: str) -> StreamingResponse:
        """Stream the hello of the glove and then its raw frames, one JSON object a line."""
        return StreamingResponse(stream_frames(known.named(glove)), media_type="application/x-ndjson")

    @app.websocket("/gloves/{glove}/live", dependencies=[require(Permission.READ, of_glove)])
    async def live(screen: WebSocket, glove: str) -> None:
        try:
            followed = known.named(glove)
        except Problem as problem:
            await screen.accept()
            await close_websocket(screen, 4404, problem.detail)
            return
        await send_views(followed, screen)


def _of_glove_or_wearer(known: KnownGloves) -> ResourceOf:
    def resources(connection: HTTPConnection) -> tuple[str, ...]:
        name, settings = str(connection.path_params["glove"]), guard_of(connection).settings
        glove = known.get(name)
        worn = () if glove is None or glove.person is None else (settings.entity_id("Person", glove.person),)
        return (settings.entity_id("Device", name), *worn)

    resources.__doc__ = "Device `{glove}`, or the Person who wears it"
    return resources


def _view(glove: Glove) -> GloveView:
    return view_of(glove, _now_s())


def _now_s() -> float:
    return asyncio.get_running_loop().time()
