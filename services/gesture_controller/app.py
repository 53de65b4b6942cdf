"""The gesture controller's face: REST and WebSocket for screens, TCP for gloves."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Annotated, Any, Literal

from fastapi import FastAPI, Response, WebSocket
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from datamodels.states import Outcome
from handover.body_limit import max_body
from handover.broker import BrokerClient
from handover.errors import Problem
from handover.ports import require_free
from handover.service import create_app
from handover.storage import storage_check
from handover.telemetry import get_logger
from services.gesture_controller import configuration
from services.gesture_controller.calibration.guidance import Guidance
from services.gesture_controller.calibration.routes import (
    MAX_FRAMES_BYTES,
    Frames,
    add_calibration,
)
from services.gesture_controller.controller import Controller
from services.gesture_controller.errand import CannotComplete
from services.gesture_controller.gestures import listed
from services.gesture_controller.glove import Glove
from services.gesture_controller.glove_server import GloveServer
from services.gesture_controller.gloves import StudyCondition
from services.gesture_controller.live import follow, frames_of
from services.gesture_controller.people.routes import add_people
from services.gesture_controller.pictures.routes import add_pictures, picture_urls
from services.gesture_controller.settings import ControllerSettings
from services.gesture_controller.study.conduct import Conduct
from services.gesture_controller.study.protocol import Condition, Session
from services.gesture_controller.study.routes import add_study
from services.gesture_controller.study.store import StudyStore
from services.gesture_controller.testing.examiner import Examiner
from services.gesture_controller.testing.routes import add_tests
from services.gesture_controller.testing.store import TestStore
from services.gesture_controller.view import view_of

log = get_logger(__name__)

GloveView = dict[str, Any]


MAX_NOTE = 500
NO_CONTROL_CHARACTERS = r"^[^\x00-\x08\x0b-\x1f\x7f]*$"
"""Text without control characters other than tabs and line feeds."""


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Declaration(_Body):
    """A glove to be known before it has said hello."""

    hand: Literal["left", "right"] | None = None
    person: Annotated[str, Field(min_length=1)] | None = None


class CalibrationFrames(_Body):
    """Frames of a fist and of an open hand, five raw values each, thumb first."""

    fist: Frames
    open: Frames


class Modes(_Body):
    """What is left out stays as it is."""

    testing: bool | None = None
    filtering: bool | None = None


class Completion(_Body):
    """Who answers the Task on the screen, and which one they saw; without `task` the present one."""

    by: Annotated[str, Field(min_length=1, max_length=100)]
    task: Annotated[str, Field(max_length=500)] | None = None
    outcome: Outcome = Outcome.OK
    note: Annotated[str, Field(max_length=MAX_NOTE, pattern=NO_CONTROL_CHARACTERS)] | None = None


def make_app(settings: ControllerSettings) -> FastAPI:
    """Return the application; raises `UsageError` when it could not work as it is set."""
    require_free(settings.glove_host, settings.glove_port, "HANDOVER_GLOVE_PORT", say=log.warning)
    broker = BrokerClient(settings)
    site = configuration.load(settings.gestures_file)
    for restriction in site.restricted_answers():
        log.warning("answer is not always offered by gesture", reason=restriction)
    controller = Controller(settings, site, broker)
    if not settings.is_local and settings.token is None:
        log.warning(
            "gloves need a token of their own",
            host=settings.glove_host,
            remedy="handover glove token NAME, or set HANDOVER_GLOVE_TOKEN for all",
        )
    conduct = Conduct(
        StudyStore(controller.database), _condition_setter(controller), controller.gloves.end_condition
    )
    examiner = Examiner(TestStore(controller.database), controller.gloves, controller.configuration.gestures)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with broker, controller, examiner, conduct, GloveServer(settings, controller.gloves):
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
    )
    controller.mount(app)
    _add_gestures(app, controller)
    add_pictures(app, controller.configuration.gestures)
    _add_gloves(app, controller)
    add_people(app, controller.people, controller.gloves)
    add_calibration(app, Guidance(controller.gloves, controller.logbook), controller.gloves)
    _add_acts(app, controller)
    _add_streams(app, controller)
    add_tests(app, examiner, controller.gloves)
    add_study(app, conduct)
    return app


def _condition_setter(controller: Controller) -> Callable[[Session, bool], Awaitable[None]]:
    """Return what has a participant asked for the gestures of their condition."""

    async def apply(session: Session, is_restart: bool) -> None:
        own = None if session.condition is None else session.condition is Condition.PERSONAL
        person = session.person if session.person in controller.people.names() else None
        condition = StudyCondition(session.pseudonym, session.glove, person, own)
        await controller.gloves.apply_condition(session.id, condition, is_restart=is_restart)

    return apply


def _add_gestures(app: FastAPI, controller: Controller) -> None:
    @app.get("/gestures", tags=["gestures"])
    async def gestures() -> list[dict[str, Any]]:
        """List the gestures of the site: name, code (thumb first, 0 straight, 2 bent), command and pictures.

        Those that are composed have no code but `left` and `right`, or `sequence`, each part with its code.
        """
        return [
            {**one, "pictures": picture_urls(one["name"])}
            for one in listed(controller.configuration.gestures, controller.configuration.commands)
        ]

    @app.get("/specifications", tags=["operations"])
    async def specifications() -> dict[str, str]:
        """Say where TaskDefinitions are looked up that the broker has not, and whether that answers."""
        database = controller.specifications
        return {
            "database": database.shown,
            "state": database.state.name,
            "detail": database.state.detail,
        }


def _add_gloves(app: FastAPI, controller: Controller) -> None:
    gloves = controller.gloves

    @app.get("/gloves", tags=["gloves"])
    async def all_gloves() -> list[GloveView]:
        """Return the state of every glove."""
        return [_view(glove) for glove in gloves]

    @app.get("/gloves/{glove}", tags=["gloves"])
    async def one_glove(glove: str) -> GloveView:
        """Return the state of a glove."""
        return _view(gloves.named(glove))

    @app.put("/gloves/{glove}", tags=["gloves"])
    async def declare(glove: str, declaration: Declaration, response: Response) -> GloveView:
        """Make a glove known before it has said hello: 201, or 200 if it was known."""
        known, is_new = await gloves.declare(glove, declaration.hand, declaration.person)
        response.status_code = 201 if is_new else 200
        return _view(known)

    @app.put("/gloves/{glove}/token", tags=["gloves"])
    async def set_token(glove: str) -> dict[str, str]:
        """Make a token for a glove, in place of an older one, and show it this once.

        From now on the glove connects with it only, and counts as declared. A connection that it has ends.
        """
        return {"glove": glove, "token": await gloves.set_token(glove)}

    @app.delete("/gloves/{glove}/token", status_code=204, tags=["gloves"])
    async def remove_token(glove: str) -> None:
        """Remove the token of a glove, which connects as others without one do; its connection ends."""
        await gloves.remove_token(gloves.named(glove))

    @app.put("/gloves/{glove}/thresholds", tags=["calibration"])
    async def set_thresholds(glove: str, thresholds: dict[str, dict[str, FiniteFloat]]) -> GloveView:
        """Set thresholds of some or all fingers; they survive a restart."""
        await gloves.set_thresholds(gloves.named(glove), thresholds)
        return _view(gloves.named(glove))

    @app.post("/gloves/{glove}/thresholds/restore", tags=["calibration"])
    async def restore(glove: str) -> GloveView:
        """Exchange the thresholds with those before the last change."""
        await gloves.restore(gloves.named(glove))
        return _view(gloves.named(glove))

    @app.post("/gloves/{glove}/calibration", tags=["calibration"])
    @max_body(2 * MAX_FRAMES_BYTES)
    async def calibrate(glove: str, frames: CalibrationFrames) -> dict[str, Any]:
        """Make thresholds from frames of a fist and of an open hand; they survive a restart."""
        calibration = await gloves.calibrate(gloves.named(glove), frames.fist, frames.open)
        return {"thresholds": calibration.thresholds.as_dict(), "levels": calibration.as_dict()}


def _add_acts(app: FastAPI, controller: Controller) -> None:
    gloves = controller.gloves

    @app.put("/gloves/{glove}/modes", tags=["acts"])
    async def switch(glove: str, modes: Modes) -> GloveView:
        """Switch testing (nothing completes a Task) and filtering (only the asked gesture counts)."""
        gloves.named(glove).switch(testing=modes.testing, filtering=modes.filtering)
        return _view(gloves.named(glove))

    @app.post("/gloves/{glove}/pause", tags=["acts"])
    async def pause(glove: str) -> GloveView:
        """Let nothing count, and hold the Task, until resumed."""
        gloves.named(glove).pause()
        return _view(gloves.named(glove))

    @app.post("/gloves/{glove}/resume", tags=["acts"])
    async def resume(glove: str) -> GloveView:
        """Take a pause back; one that was requested on the Task itself stays."""
        gloves.named(glove).resume()
        return _view(gloves.named(glove))

    @app.post("/gloves/{glove}/complete", tags=["acts"])
    async def complete(glove: str, completion: Completion) -> GloveView:
        """Answer the Task on the screen: `ok`, or that something is `notGood` or a `problem`, with a note.

        With another outcome than `ok` the Task ends `failed`, unless its definition handles outcomes.
        """
        note = (completion.note or "").strip() or None
        try:
            gloves.named(glove).complete_on_screen(
                completion.by, _now_s(), completion.task, completion.outcome, note
            )
        except CannotComplete as error:
            raise Problem(409, "Cannot complete", str(error)) from None
        return _view(gloves.named(glove))


def _add_streams(app: FastAPI, controller: Controller) -> None:
    gloves = controller.gloves

    @app.get("/gloves/{glove}/frames", tags=["streams"])
    async def frames(glove: str) -> StreamingResponse:
        """Stream the glove's hello and then its raw frames, one JSON object a line, until the reader goes."""
        return StreamingResponse(frames_of(gloves.named(glove)), media_type="application/x-ndjson")

    @app.websocket("/gloves/{glove}/live")
    async def live(screen: WebSocket, glove: str) -> None:
        try:
            followed = gloves.named(glove)
        except Problem as problem:
            await screen.accept()
            await screen.close(4404, problem.detail[:120])
            return
        await follow(followed, screen)


def _view(glove: Glove) -> GloveView:
    return view_of(glove, _now_s())


def _now_s() -> float:
    return asyncio.get_running_loop().time()
