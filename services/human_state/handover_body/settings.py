"""The settings of human state, in addition to the common ones."""

import base64
import binascii
from pathlib import Path

from pydantic import Field, SecretStr, field_validator

from handover.extensions import Service
from handover.service_addresses import HUMAN_STATE, HumanStateAddress, TrajectoryAddress
from handover.settings import Names, Settings


class HumanStateSettings(HumanStateAddress, TrajectoryAddress, Settings):
    """Addresses, rates and retention of human state."""

    health_history_days: float = Field(
        30.0, gt=0, description="the history of the state of persons is deleted after so many days"
    )
    health_recording_key: SecretStr | None = Field(
        None,
        description="the key that encrypts recordings: 32 bytes in base64 (`openssl rand -base64 32`); "
        "without it nothing is recorded. Recordings cannot be read with another key",
    )
    health_recording_days: float = Field(
        30.0, gt=0, description="a recording is deleted so many days after its end"
    )
    health_niceness: int = Field(
        -10,
        ge=-20,
        le=19,
        description="the niceness of human state, so that busy processes do not delay the limits of robots; "
        "below 0 it needs the right to (`LimitNICE` of systemd, `CAP_SYS_NICE`), else it stays as it is",
    )
    health_on_other_broker: bool = Field(
        False,
        description="whether body signals of persons who consent are written to a broker that is not ours, "
        "where everybody who reads the broker reads them",
    )
    health_strain_window_s: float = Field(
        300.0,
        ge=10,
        le=3600,
        description="the time constant of the mean exertion that proposes a break, in s",
    )
    health_lsl_people: Names = Field(
        (),
        description="names of persons whose live signals are sent as streams of LSL while they consent, "
        "separated by commas; the local network sees them, unencrypted, so it needs accounts; none if absent",
    )
    health_lsl_signals: Names = Field(
        (),
        description="kinds of signals and names of values that LSL gets, for example "
        "ecg,heartRate; all if absent",
    )
    health_break_message: str = Field(
        "breakProposed",
        max_length=64,
        description="the BPMN message sent to the orchestrator when the strain of a person lasts; its key is "
        "the pseudonym; empty: none",
    )

    health_activity_model: Path | None = Field(
        None,
        description="skops file with a model of the activities of daily living; one that was trained on "
        "simulated people if absent",
    )

    @field_validator("health_recording_key")
    @classmethod
    def _has_32_bytes(cls, key: SecretStr | None) -> SecretStr | None:
        if key is None or not key.get_secret_value():
            return None
        try:
            length = len(base64.b64decode(key.get_secret_value(), validate=True))
        except (binascii.Error, ValueError):
            length = 0
        if length != 32:
            raise ValueError("must be 32 bytes in base64; make a key with `openssl rand -base64 32`")
        return key

    @property
    def recording_key(self) -> bytes | None:
        """The 32 bytes that encrypt recordings; None without a key."""
        key = self.health_recording_key
        return None if key is None else base64.b64decode(key.get_secret_value())


SERVICE = Service(HUMAN_STATE, "handover_body", HumanStateSettings, "human_state_port")
