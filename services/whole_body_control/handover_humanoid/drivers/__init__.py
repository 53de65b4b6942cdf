"""Drivers of humanoids by name: what a process of a robot runs, ours and those of other packages.

A package registers a factory, which makes a `Robot` (`components.robot`) from a `DriverContext`:

    [project.entry-points."handover.humanoid_drivers"]
    my-controller = "my_controller:make_robot"
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ValidationError

from handover.errors import UsageError
from handover.extensions import ExtensionPoint
from handover.formats.validation import fault_text
from handover_humanoid.components.robot import Robot
from handover_humanoid.model.humanoid import Humanoid

DRIVERS: Final = ExtensionPoint(
    "humanoid driver",
    "handover.humanoid_drivers",
    {
        "simulated": "handover_humanoid.drivers.simulated:make_robot",
        "ros2": "handover_humanoid.drivers.ros2:make_robot",
    },
)

Form = TypeVar("Form", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class DriverContext:
    """What a robot is made from: its model, and the options of the deployment."""

    humanoid: Humanoid
    options: Mapping[str, Any]

    def read_options(self, form: type[Form]) -> Form:
        """Return the checked options. Raises `UsageError`."""
        try:
            return form.model_validate(dict(self.options))
        except ValidationError as error:
            faults = fault_text(error, "options")
            raise UsageError(f"the options of the driver of {self.humanoid.name}: {faults}") from None


def make_robot(name: str, context: DriverContext) -> Robot:
    """Return the robot of a driver. Raises `UsageError` for one that is unknown or cannot be made."""
    made: Robot = DRIVERS.load(name)(context)
    return made
