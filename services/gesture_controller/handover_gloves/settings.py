"""The settings of the gesture controller, in addition to the common ones."""

from pathlib import Path
from typing import ClassVar, Self

from pydantic import Field, model_validator

from handover.extensions import Service
from handover.network.outbound_policy import is_loopback
from handover.security.glove_token import site_glove_token
from handover.service_addresses import GESTURE_CONTROLLER, ControllerAddress, GloveServerAddress
from handover.settings import Settings
from handover_gloves.recognition.hold import HoldTiming


class ControllerSettings(ControllerAddress, GloveServerAddress, Settings):
    """Addresses, limits and timing of the gesture controller."""

    removed: ClassVar = {
        "hello_timeout_s": "a glove has 5 s to send its hello",
        "hold_gap_ms": "a gap of more than 250 ms between frames breaks a hold",
    }

    max_gloves: int = Field(
        256, ge=1, description="the largest number of gloves, including those of the gestures file"
    )
    max_undeclared_gloves: int = Field(
        64,
        ge=0,
        description="the largest number of gloves that are neither declared nor have their own token",
    )
    glove_forget_s: float = Field(
        3600.0,
        gt=0,
        description="an undeclared glove is forgotten after it has been away for this time",
    )
    gestures_file: Path | None = Field(
        None, description="YAML file of gestures, commands, persons and gloves; built-in ones if absent"
    )
    announce_ms: int = Field(500, gt=0, description="a gesture held for this time is announced")
    confirm_ms: int = Field(1500, gt=0, description="a gesture held for this time counts")
    hands_apart_ms: int = Field(
        2000, gt=0, description="in a two-hand gesture, one hand may begin this much later than the other"
    )
    sequence_within_ms: int = Field(
        3000, gt=0, description="in a sequence, the second gesture must begin within this time"
    )
    filtering: bool = Field(True, description="only the gesture that the current Task asks for counts")
    recognizer: str = Field(
        "thresholds", description="the default recognizer: thresholds, personal, or one of another package"
    )
    specification_timeout_s: float = Field(
        10.0, ge=0, description="how long a Task without gesture and command waits for that database"
    )
    silence_s: float = Field(2.0, gt=0, description="a glove without a frame for this time counts as silent")

    @model_validator(mode="after")
    def _announced_before_it_counts(self) -> Self:
        if self.announce_ms >= self.confirm_ms:
            raise ValueError(
                f"announce_ms ({self.announce_ms}) must be less than confirm_ms ({self.confirm_ms}): "
                "a gesture is announced before it counts"
            )
        return self

    @property
    def timing(self) -> HoldTiming:
        """The timing of holds."""
        return HoldTiming(
            self.announce_ms,
            self.confirm_ms,
            apart_ms=self.hands_apart_ms,
            within_ms=self.sequence_within_ms,
        )

    @property
    def notify_url(self) -> str:
        """The URL for notifications of Tasks."""
        return f"{self.gesture_controller}/notifications"

    @property
    def token(self) -> str | None:
        """The token of the site; None if there is none."""
        return site_glove_token(self.glove_token, self.security_folder)

    @property
    def is_local(self) -> bool:
        """True if the glove server listens on loopback only."""
        return is_loopback(self.glove_host)


SERVICE = Service(
    GESTURE_CONTROLLER,
    "handover_gloves",
    ControllerSettings,
    "controller_port",
    also_listens=(("glove_host", "glove_port"),),
)
