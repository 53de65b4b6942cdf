"""The settings of whole-body control, in addition to the common ones."""

import hashlib
import tempfile
from pathlib import Path
from typing import Final, Literal

from pydantic import Field

from handover.extensions import Service
from handover.service_addresses import WHOLE_BODY_CONTROL, BridgeAddress, HumanStateAddress, WholeBodyAddress
from handover.settings import MaybePath, Names, Settings

DEFAULT_MODEL: Final = "coman"
SHARED_MEMORY: Final = Path("/dev/shm")  # noqa: S108 - files in it never reach a disk


class WholeBodySettings(WholeBodyAddress, BridgeAddress, HumanStateAddress, Settings):
    """The humanoid that runs, where its ports are, and where the state of persons comes from."""

    humanoid_model: str = Field(
        "",
        max_length=64,
        description="the humanoid that runs, simulated: coman; with it `handover up` starts this service",
    )
    humanoid_name: str = Field(
        "coman-1",
        pattern=r"^[A-Za-z0-9_.-]{1,64}$",
        description="the name of the humanoid, the last part of the id of its Device",
    )
    humanoid_ports_dir: MaybePath = Field(
        None,
        description="the directory of the shared memory of the control cycle; by default one of this data "
        "directory in /dev/shm",
    )
    humanoid_fifo: bool = Field(
        True, description="ask the system for a real-time priority of the control cycle"
    )
    humanoid_intention: Literal["lead", "manipulability"] = Field(
        "lead",
        description="how assisted walking reads where a person leads the humanoid: lead, from the forces and "
        "places of the hands, or manipulability, by equation 3 of CoSiMA",
    )
    humanoid_ros_link: bool = Field(
        False,
        description="show the state of the humanoid on topics of the ROS graph, through the ROS bridge, and "
        "walk it by a topic of wishes: any node of the graph can then walk it",
    )
    humanoid_required_limits: Names = Field(
        (), description="sources of speed limits without which the humanoid does not move, with commas"
    )
    humanoid_recording_hz: float = Field(
        100.0, ge=1, le=250, description="how often a recording of the humanoid reads the control cycle"
    )
    humanoid_recording_minutes: float = Field(
        60.0, gt=0, le=1440, description="a recording of the humanoid ends after so long"
    )
    humanoid_recording_days: float = Field(
        30.0, gt=0, description="a recording of the humanoid is deleted so many days after its end"
    )
    humanoid_recordings_mb: int = Field(
        2048,
        ge=1,
        description="the disk space of all recordings of the humanoid; the oldest are deleted beyond it",
    )

    @property
    def model_name(self) -> str:
        """The name of the humanoid's model."""
        return self.humanoid_model or DEFAULT_MODEL

    @property
    def ports_folder(self) -> Path:
        """The directory of the ports: of this data directory and this humanoid only."""
        if self.humanoid_ports_dir is not None:
            return self.humanoid_ports_dir.absolute()
        base = SHARED_MEMORY if SHARED_MEMORY.is_dir() else Path(tempfile.gettempdir())
        place = f"{self.data_dir.absolute()}\n{self.humanoid_name}".encode()
        return base / f"handover-{hashlib.sha256(place).hexdigest()[:16]}"

    @property
    def recordings_folder(self) -> Path:
        """The directory of recordings."""
        return self.data_dir.absolute() / "humanoid-recordings"

    @property
    def rehearsals_folder(self) -> Path:
        """The directory of what hands have learned in simulation."""
        return self.data_dir.absolute() / "humanoid-rehearsals"

    @property
    def whole_body(self) -> str:
        """The URL of this service."""
        return self.whole_body_control

    @property
    def humanoid_bridge(self) -> str:
        """The URL of the WebSocket for humanoids of the ROS bridge."""
        return f"ws{self.ros_bridge.removeprefix('http')}/humanoid"

    @property
    def humanoid_link(self) -> str:
        """The URL of the WebSocket of the ROS bridge for the state of the humanoid and the wishes of
        nodes."""
        return f"{self.humanoid_bridge}/link"


SERVICE = Service(
    WHOLE_BODY_CONTROL,
    "handover_humanoid",
    WholeBodySettings,
    "whole_body_port",
    runs_if=lambda: bool(WholeBodySettings.load().humanoid_model),
)
