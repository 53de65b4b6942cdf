"""A deployment: which components run, and which of them in the control cycle.

folder: /dev/shm/coman          # of the ports
components:
  robot: {kind: mujoco, humanoid: coman, realtime: true}      # the one that is exchanged
  walking: {kind: walking, engine: stack, solver: fastest, mode: impedance, intention: lead, realtime: true}
  recorder: {kind: recorder, realtime: false}

A robot in a process of its own is {kind: driver, driver: ros2, options: {…}, realtime: true}.
The engine may be `projections`, the solver `daqp`, the mode of the joints `position` or `torque`, where the
robot has it, the intention `manipulability`. A component that performs I/O cannot be real-time, and one that
controls the joints must be.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, ValidationError

from handover.errors import UsageError
from handover.formats.validation import ClosedModel
from handover_humanoid.engines.choice import DEFAULT_ENGINE, EngineName
from handover_humanoid.model.humanoid import JointMode
from handover_humanoid.patterns.intention import DEFAULT_INTENTION, IntentionName

MAX_FILE_BYTES = 100_000

REAL_TIME_KINDS = frozenset({"driver", "mujoco", "walking"})
"""The kinds that belong into the control cycle, since they are made for it; all others must stay out."""

ROBOT_KINDS = frozenset({"driver", "mujoco"})
"""The kinds that are robots: simulated within the cycle, or behind the ports of a process of its own."""


class Component(ClosedModel):
    """One component; `realtime` says where it runs."""

    kind: Annotated[str, Field(min_length=1)]
    realtime: bool
    humanoid: str = "coman"
    solver: Literal["fastest", "daqp"] = "fastest"
    engine: EngineName = DEFAULT_ENGINE
    mode: JointMode = JointMode.IMPEDANCE
    intention: IntentionName = DEFAULT_INTENTION
    driver: str = "simulated"
    """Of a robot of the kind `driver`, with its options."""
    options: Mapping[str, Any] = Field(default_factory=dict)


class Deployment(ClosedModel):
    """A checked deployment."""

    folder: Path
    components: Annotated[Mapping[str, Component], Field(min_length=1)]
    paced: bool = True
    fifo: bool = True

    @property
    def robot(self) -> Component:
        """Return the robot."""
        return next(component for component in self.components.values() if component.kind in ROBOT_KINDS)

    @property
    def controller(self) -> Component:
        """Return the component that controls the joints."""
        return next(component for component in self.components.values() if component.kind == "walking")


def read_deployment(file: Path) -> Deployment:
    """Return the deployment of a YAML file. Raises `UsageError` with a line for each fault."""
    try:
        if file.stat().st_size > MAX_FILE_BYTES:
            raise UsageError(f"{file} is larger than {MAX_FILE_BYTES} bytes; it is no deployment")
        deployment = Deployment.model_validate(yaml.safe_load(file.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, ValidationError, yaml.YAMLError) as error:
        raise UsageError(f"{file}: {error}") from None
    faults = _faults(deployment)
    if faults:
        raise UsageError("\n".join(f"{file}: {fault}" for fault in faults))
    return deployment


def _faults(deployment: Deployment) -> list[str]:
    faults = []
    for name, component in deployment.components.items():
        if component.realtime and component.kind not in REAL_TIME_KINDS:
            faults.append(
                f'"{name}" ({component.kind}) is not made for the control cycle; set realtime: false'
            )
        if not component.realtime and component.kind in REAL_TIME_KINDS:
            faults.append(f'"{name}" ({component.kind}) moves the joints; set realtime: true')
    kinds = [component.kind for component in deployment.components.values()]
    robots = [kind for kind in kinds if kind in ROBOT_KINDS]
    if len(robots) != 1:
        there = ", ".join(sorted(ROBOT_KINDS))
        faults.append(f"there are {len(robots)} robots; a deployment has exactly one, of the kinds: {there}")
    if kinds.count("walking") != 1:
        faults.append(f'there are {kinds.count("walking")} components of the kind "walking"; one is needed')
    return faults
