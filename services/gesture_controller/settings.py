"""The settings of the gesture controller, beside those that every component shares."""

import ipaddress
from pathlib import Path
from typing import Self

from pydantic import Field, SecretStr, model_validator

from handover.settings import Settings
from services.gesture_controller.hold import HoldTiming


class ControllerSettings(Settings):
    """Where gloves and screens find the controller, and when a gesture counts."""

    controller_port: int = Field(
        54210, ge=1, le=65535, description="REST and WebSocket port of the controller"
    )
    controller_url: str | None = Field(
        None, description="where the broker reaches the controller; http://host:port of it if absent"
    )
    glove_host: str = Field("127.0.0.1", description="the address on which gloves are awaited")
    glove_port: int = Field(54000, ge=1, le=65535, description="the TCP port on which gloves are awaited")
    glove_token: SecretStr | None = Field(
        None,
        description="the token of this site, for gloves without one of their own; if absent, those need none "
        "where only this machine reaches glove_host, and are refused elsewhere",
    )
    hello_timeout_s: float = Field(5.0, gt=0, description="how long a connection may take to say hello")
    max_gloves: int = Field(
        256, ge=1, description="gloves served at most, those of the gestures file included"
    )
    max_undeclared_gloves: int = Field(
        64,
        ge=0,
        description="gloves admitted at most that are neither declared nor have a token of their own",
    )
    glove_forget_s: float = Field(
        3600.0,
        gt=0,
        description="a glove that nobody declared is forgotten when it has been away for so long",
    )
    gestures_file: Path | None = Field(
        None, description="YAML file of gestures, commands, persons and gloves; built-in ones if absent"
    )
    announce_ms: int = Field(500, gt=0, description="a gesture held so long is announced")
    confirm_ms: int = Field(1500, gt=0, description="a gesture held so long counts")
    hold_gap_ms: int = Field(250, gt=0, description="frames further apart than this break a hold")
    hands_apart_ms: int = Field(
        2000, gt=0, description="in a gesture of both hands, one hand may begin so much later than the other"
    )
    sequence_within_ms: int = Field(
        3000, gt=0, description="of two gestures in turn, the second must begin so soon after the first"
    )
    filtering: bool = Field(True, description="only the gesture that the current Task asks for counts")
    recognizer: str = Field(
        "thresholds", description="what reads hands where no profile says: thresholds, personal, or another"
    )
    specification_url: str | None = Field(
        None,
        description="SQLAlchemy URL of the database of TaskDefinitions that neither Task nor broker has; "
        "specifications.db in the data directory if absent",
    )
    specification_patience_s: float = Field(
        10.0, ge=0, description="how long a Task that says nothing itself waits for that database"
    )
    silence_s: float = Field(2.0, gt=0, description="a glove without a frame for so long is taken for lost")

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
        """Return when a hold is announced, counts and breaks."""
        return HoldTiming(
            self.announce_ms,
            self.confirm_ms,
            self.hold_gap_ms,
            apart_ms=self.hands_apart_ms,
            within_ms=self.sequence_within_ms,
        )

    @property
    def notify_url(self) -> str:
        """Return where the broker sends notifications of Tasks."""
        return f"{self.url_of(self.controller_port, self.controller_url)}/notifications"

    @property
    def specifications(self) -> str:
        """Return the SQLAlchemy URL of the specification database."""
        return self.specification_url or self.database("specifications")

    @property
    def token(self) -> str | None:
        """Return the token that gloves must show; None if none is asked for."""
        return (self.glove_token.get_secret_value() if self.glove_token else "") or None

    @property
    def is_local(self) -> bool:
        """Say whether only this machine reaches the address on which gloves connect."""
        return _is_loopback(self.glove_host)


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
