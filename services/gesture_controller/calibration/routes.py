"""Calibration over REST: be guided, show samples, choose what reads the hand."""

from typing import Annotated, Any

from fastapi import FastAPI
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from handover.body_limit import max_body
from handover.errors import Problem
from handover.messages import message
from services.gesture_controller.calibration.guidance import Guidance
from services.gesture_controller.gloves import Gloves
from services.gesture_controller.recognition.registry import recognizers

MAX_CALIBRATION_FRAMES = 4_000
"""Of one hand shape: 20 s at 200 Hz."""
MAX_VALUES_A_FRAME = 16
"""More than the five that count: what is wrong with a frame is said when it is read."""
MAX_FRAMES_BYTES = 512 * 1024

Frames = Annotated[
    list[Annotated[list[FiniteFloat], Field(max_length=MAX_VALUES_A_FRAME, fail_fast=True)]],
    Field(max_length=MAX_CALIBRATION_FRAMES, fail_fast=True),
]

Name = Annotated[str, Field(min_length=1, max_length=200)]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class NewGuide(_Body):
    """What to be guided through: fist and open hand, or a sample of `gesture` (its name or code)."""

    gesture: Name | None = None
    apply: bool = True
    countdownMs: float = Field(3000, ge=0, le=30_000)  # noqa: N815 - as it stands in JSON


class NewSample(_Body):
    """Frames of a gesture (its name or code), five raw values each, thumb first."""

    gesture: Name
    frames: Frames


class Choice(_Body):
    """The recognizer to be used, by name."""

    name: Name


def add_calibration(app: FastAPI, guidance: Guidance, gloves: Gloves) -> None:
    """Add the routes of calibration."""

    @app.get("/recognizers", tags=["calibration"])
    async def all_recognizers() -> list[str]:
        """List the recognizers that there are."""
        return recognizers()

    @app.put("/gloves/{glove}/recognizer", tags=["calibration"])
    async def choose(glove: str, choice: Choice) -> dict[str, Any]:
        """Choose what reads the hand of who wears the glove; it survives a restart."""
        await guidance.choose(gloves.named(glove), choice.name)
        return guidance.summary(gloves.named(glove))

    @app.get("/gloves/{glove}/recognition", tags=["calibration"])
    async def recognition(glove: str) -> dict[str, Any]:
        """Return what the last frame was taken for, how probable each gesture is, and why."""
        known = gloves.named(glove)
        seen, reader = known.sight.recognition, known.senses.reader
        if seen is None:
            raise Problem(
                409,
                "Nothing seen",
                message(
                    "calibration.nothing_seen",
                    "{glove} has sent no frame yet; put it on and switch it on",
                    glove=glove,
                ),
            )
        return {
            "recognizer": known.senses.recognizer,
            "missing": known.senses.missing,
            "states": seen.states,
            "gesture": seen.gesture,
            "certainty": round(seen.certainty, 4),
            "odds": dict(reader.odds(seen)),
            "why": reader.why(seen),
        }

    @app.get("/gloves/{glove}/calibration", tags=["calibration"])
    async def summary(glove: str) -> dict[str, Any]:
        """Return how the glove is calibrated for who wears it."""
        return guidance.summary(gloves.named(glove))

    @app.post("/gloves/{glove}/calibration/guide", status_code=201, tags=["calibration"])
    async def begin(glove: str, new: NewGuide | None = None) -> dict[str, Any]:
        """Begin to guide the hand, as the live view shows; no gesture answers a Task meanwhile."""
        chosen = new or NewGuide()
        return await guidance.begin(
            gloves.named(glove),
            gesture=chosen.gesture,
            apply=chosen.apply,
            countdown_s=chosen.countdownMs / 1000,
        )

    @app.get("/gloves/{glove}/calibration/guide", tags=["calibration"])
    async def guide(glove: str) -> dict[str, Any] | None:
        """Return how far the guide is, or how the last one ended; null if there was none."""
        return guidance.view(gloves.named(glove))

    @app.delete("/gloves/{glove}/calibration/guide", status_code=204, tags=["calibration"])
    async def stop(glove: str) -> None:
        """Give the calibration up; nothing is changed by it."""
        await guidance.stop(gloves.named(glove))

    @app.post("/gloves/{glove}/calibration/accept", tags=["calibration"])
    async def accept(glove: str) -> dict[str, Any]:
        """Apply the calibration that was only offered."""
        await guidance.accept(gloves.named(glove))
        return guidance.summary(gloves.named(glove))

    @app.post("/gloves/{glove}/samples", status_code=201, tags=["calibration"])
    @max_body(MAX_FRAMES_BYTES)
    async def sample(glove: str, new: NewSample) -> dict[str, Any]:
        """Take frames for a sample of a gesture, in place of an older one."""
        await guidance.sample(gloves.named(glove), new.gesture, new.frames)
        return guidance.summary(gloves.named(glove))

    @app.delete("/gloves/{glove}/samples/{gesture}", status_code=204, tags=["calibration"])
    async def forget(glove: str, gesture: str) -> None:
        """Forget the sample of a gesture."""
        await guidance.forget_sample(gloves.named(glove), gesture)
