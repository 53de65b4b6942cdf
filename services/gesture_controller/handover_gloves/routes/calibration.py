"""REST routes of calibration: sessions, samples and the choice of a recognizer."""

from typing import Annotated, Any

from fastapi import FastAPI
from pydantic import Field, FiniteFloat

from handover.errors import Problem
from handover.formats.strict_json import RequestBody, StrictJson
from handover.http.api_description import TaggedRoutes
from handover.http.body_limit import max_body
from handover.security.guard import require, require_somewhere
from handover.security.permissions import Permission
from handover_gloves.calibration.calibration_session import CalibrationSessions
from handover_gloves.connection.glove_registry import GloveRegistry
from handover_gloves.gloves.known_gloves import KnownGloves
from handover_gloves.recognition.registry import recognizers
from handover_gloves.routes.gloves import GloveView, glove_view, of_glove

MAX_CALIBRATION_FRAMES = 4_000
"""Of one hand shape: 20 s at 200 Hz."""
MAX_VALUES_A_FRAME = 16
"""More than five, so that a wrong frame gets an error that names the rule."""
MAX_FRAMES_BYTES = 512 * 1024

Frames = Annotated[
    list[Annotated[list[FiniteFloat], Field(max_length=MAX_VALUES_A_FRAME, fail_fast=True)]],
    Field(max_length=MAX_CALIBRATION_FRAMES, fail_fast=True),
]

Name = Annotated[str, Field(min_length=1, max_length=200)]

Thresholds = Annotated[dict[str, dict[str, FiniteFloat]], StrictJson()]


class CalibrationFrames(RequestBody):
    """Frames of a fist and of an open hand, five raw values each, thumb first."""

    fist: Frames
    open: Frames


class NewSession(RequestBody):
    """What to calibrate: fist and open hand, or a sample of `gesture` (its name or code)."""

    gesture: Name | None = None
    apply: bool = True
    countdownMs: float = Field(3000, ge=0, le=30_000)  # noqa: N815 - as it stands in JSON


class NewSample(RequestBody):
    """Frames of a gesture (its name or code), five raw values each, thumb first."""

    gesture: Name
    frames: Frames


class Choice(RequestBody):
    """The name of a recognizer."""

    name: Name


def add_calibration(app: FastAPI, sessions: CalibrationSessions, gloves: KnownGloves) -> None:
    """Add the routes of calibration."""
    routes = TaggedRoutes(app, "calibration")

    @routes.get("/recognizers", dependencies=[require_somewhere(Permission.READ)])
    async def all_recognizers() -> list[str]:
        """List the names of the recognizers."""
        return recognizers()

    @routes.put("/gloves/{glove}/recognizer", dependencies=[require(Permission.CONFIGURE, of_glove)])
    async def choose_recognizer(glove: str, choice: Choice) -> dict[str, Any]:
        """Choose and store the recognizer of the glove for its wearer."""
        await sessions.choose_recognizer(gloves.named(glove), choice.name)
        return sessions.summary(gloves.named(glove))

    @routes.get("/gloves/{glove}/recognition", dependencies=[require(Permission.READ, of_glove)])
    async def recognition(glove: str) -> dict[str, Any]:
        """Return the result of the last frame, the score of each gesture, and the explanation."""
        worn = gloves.named(glove)
        seen, reader = worn.reader.state.recognition, worn.reader.config.recognizer
        if seen is None:
            raise Problem.translated(
                409,
                "Nothing seen",
                "calibration.nothing_seen",
                "{glove} has sent no frame yet; put it on and switch it on",
                glove=glove,
            )
        return {
            "recognizer": worn.reader.config.recognizer_name,
            "missing": worn.reader.config.missing,
            "states": seen.states,
            "gesture": seen.gesture,
            "certainty": round(seen.certainty, 4),
            "odds": dict(reader.odds(seen)),
            "why": reader.why(seen),
        }

    @routes.get("/gloves/{glove}/calibration", dependencies=[require(Permission.READ, of_glove)])
    async def summary(glove: str) -> dict[str, Any]:
        """Return the calibration of the glove for its wearer."""
        return sessions.summary(gloves.named(glove))

    @routes.post(
        "/gloves/{glove}/calibration/guide",
        status_code=201,
        dependencies=[require(Permission.CONFIGURE, of_glove)],
    )
    async def begin(glove: str, new: NewSession | None = None) -> dict[str, Any]:
        """Begin a calibration session; the live view shows it, and no gesture answers a Task meanwhile."""
        chosen = new or NewSession()
        return await sessions.begin(
            gloves.named(glove),
            gesture=chosen.gesture,
            apply=chosen.apply,
            countdown_s=chosen.countdownMs / 1000,
        )

    @routes.get("/gloves/{glove}/calibration/guide", dependencies=[require(Permission.READ, of_glove)])
    async def session(glove: str) -> dict[str, Any] | None:
        """Return the current or last calibration session; null if there was none."""
        return sessions.view(gloves.named(glove))

    @routes.delete(
        "/gloves/{glove}/calibration/guide",
        status_code=204,
        dependencies=[require(Permission.CONFIGURE, of_glove)],
    )
    async def stop(glove: str) -> None:
        """Cancel the calibration session; nothing is changed by it."""
        await sessions.stop(gloves.named(glove))

    @routes.post("/gloves/{glove}/calibration/accept", dependencies=[require(Permission.CONFIGURE, of_glove)])
    async def accept(glove: str) -> dict[str, Any]:
        """Apply the calibration that was offered."""
        await sessions.accept(gloves.named(glove))
        return sessions.summary(gloves.named(glove))

    @routes.post(
        "/gloves/{glove}/samples", status_code=201, dependencies=[require(Permission.CONFIGURE, of_glove)]
    )
    @max_body(MAX_FRAMES_BYTES)
    async def add_sample(glove: str, new: NewSample) -> dict[str, Any]:
        """Store frames as the sample of a gesture, in place of an older one."""
        await sessions.add_sample(gloves.named(glove), new.gesture, new.frames)
        return sessions.summary(gloves.named(glove))

    @routes.delete(
        "/gloves/{glove}/samples/{gesture}",
        status_code=204,
        dependencies=[require(Permission.CONFIGURE, of_glove)],
    )
    async def remove_sample(glove: str, gesture: str) -> None:
        """Delete the sample of a gesture."""
        await sessions.remove_sample(gloves.named(glove), gesture)


def add_fits(app: FastAPI, registry: GloveRegistry) -> None:
    """Add the routes of thresholds, and of a calibration from frames."""
    routes = TaggedRoutes(app, "calibration")
    gloves, fits = registry.known, registry.fits

    @routes.put("/gloves/{glove}/thresholds", dependencies=[require(Permission.CONFIGURE, of_glove)])
    async def set_thresholds(glove: str, thresholds: Thresholds) -> GloveView:
        """Set and store the thresholds of some or all fingers."""
        await fits.set_thresholds(gloves.named(glove), thresholds)
        return glove_view(gloves.named(glove))

    @routes.post("/gloves/{glove}/thresholds/restore", dependencies=[require(Permission.CONFIGURE, of_glove)])
    async def restore(glove: str) -> GloveView:
        """Exchange the thresholds with those before the last change."""
        await fits.restore(gloves.named(glove))
        return glove_view(gloves.named(glove))

    @routes.post("/gloves/{glove}/calibration", dependencies=[require(Permission.CONFIGURE, of_glove)])
    @max_body(2 * MAX_FRAMES_BYTES)
    async def calibrate(glove: str, frames: CalibrationFrames) -> dict[str, Any]:
        """Calculate and store thresholds from frames of a fist and of an open hand."""
        calibration = await fits.calibrate(gloves.named(glove), frames.fist, frames.open)
        return {"thresholds": calibration.thresholds.as_dict(), "levels": calibration.as_dict()}
