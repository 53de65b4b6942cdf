"""The settings of the driver `ur`, from the cell file or from environment variables `HANDOVER_UR_…`."""

import json
import os
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from dotenv import dotenv_values
from pydantic import BeforeValidator, Field, FiniteFloat

from handover.formats.validation import ClosedModel
from handover.settings import ENV_FILE, PREFIX

Port = Annotated[int, Field(ge=1, le=65535)]
Fraction = Annotated[FiniteFloat, Field(ge=0, le=1)]


def _parsed(written: object) -> object:
    try:
        return json.loads(written) if isinstance(written, str) else written
    except ValueError:
        return written


Point = Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat], BeforeValidator(_parsed)]
"""Coordinates in m; in the environment as JSON."""


class UrOptions(ClosedModel):
    """One controller, its gripper and its watchdog."""

    host: str = Field("127.0.0.1", min_length=1, description="the address of the controller")
    rtde_port: Port = Field(30004, description="the port of RTDE")
    dashboard_port: Port = Field(29999, description="the port of the dashboard server")
    script_port: Port = Field(30002, description="the port of the script interface")
    controller_model: str | None = Field(
        None,
        min_length=1,
        description="the model that the controller must name, such as UR5 or any; that of the arm if absent",
    )
    payload_kg: FiniteFloat | None = Field(
        None, ge=0, le=50, description="the mass at the flange; that of the installation if absent"
    )
    payload_centre_m: Point = Field(
        (0.0, 0.0, 0.0), description="the centre of gravity of that mass, in the frame of the flange"
    )
    watchdog_s: FiniteFloat = Field(
        0.1, ge=0.02, le=30, description="the arm stops after so long without setpoints or heartbeats"
    )
    silence_s: FiniteFloat = Field(
        0.5, ge=0.02, le=30, description="a controller that reports nothing for so long is not connected"
    )
    stop_rad_s2: FiniteFloat = Field(
        8.0,
        gt=0,
        le=40,
        description="the deceleration of the joints when the program on the controller stops",
    )
    lookahead_s: FiniteFloat = Field(0.03, ge=0.03, le=0.2, description="lookahead_time of servoj")
    gain: FiniteFloat = Field(1000.0, ge=100, le=2000, description="gain of servoj")
    gripper: Literal["none", "tool_io", "robotiq"] = Field("none", description="the kind of gripper")
    tool_output: int = Field(0, ge=0, le=1, description="tool_io: the tool output that closes the gripper")
    tool_input: int | None = Field(
        None, ge=0, le=1, description="tool_io: the tool input that is high while an object is gripped"
    )
    robotiq_port: Port = Field(63352, description="robotiq: the port of the URCap")
    robotiq_force: Fraction = Field(0.3, description="robotiq: the force, as a fraction of its range")
    robotiq_speed: Fraction = Field(1.0, description="robotiq: the speed, as a fraction of its range")


def with_environment(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the options of the cell file; the environment has those that are not in it."""
    environment = {**dotenv_values(ENV_FILE), **os.environ}
    names = {name: f"{PREFIX}UR_{name.upper()}" for name in UrOptions.model_fields}
    by_environment = {
        name: environment[variable] for name, variable in names.items() if environment.get(variable)
    }
    return {**by_environment, **options}
