"""What a machine is: a controller, the simulated machine that it moves, and what its simulated person does.

A case is a folder of `machines`: `controller.py` is pure (frozen state, the time and what was measured as
arguments), `simulation.py` has the machine and the behaviour of the person, `case.py` a `Machine` that joins
them and a `CASE` that names it. A package registers its own by an entry point in `handover.cases`.

The service calls `step` 20 times a second with what it received from human state. The heart of the simulated
person is that of the simulated sensor: what the person does reaches it by `acts`, and what the controller
gets went through driver, processing, fusion and limits.
"""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Engine

from handover.control.speed_limits import Allowed
from handover.errors import Problem
from handover.extensions import ExtensionPoint
from handover_cases.model.body import Body
from handover_cases.model.command import Command
from handover_cases.model.sensor import Sensor
from handover_cases.settings import AssistiveSettings
from handover_cases.trial import Trial

MAX_STEP_S: Final = 0.2
"""A longer pause between two cycles counts as this much for simulated machines."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What is known at the time of a cycle. `allowed` is the limit of the body, aged by this process."""

    now_s: float
    dt_s: float
    body: Body
    allowed: Allowed


@dataclass(frozen=True, slots=True)
class MachineContext:
    """What the service gives a machine once, before its first cycle: settings, and the database for a log."""

    settings: AssistiveSettings
    engine: Engine


@dataclass(frozen=True, slots=True)
class MachineState:
    """What people and the broker see. `state` is a word of the machine, `reason` why it is in it.

    `values` are numbers by name, each with its UN/CEFACT code ("" for none); `chart` those of the chart.
    """

    state: str
    reason: str
    values: Mapping[str, tuple[float, str]]
    chart: Mapping[str, float]
    is_moving: bool


class Machine(ABC):
    """One machine of a case; its methods run on the event loop and never block."""

    def prepare(self, context: MachineContext) -> None:  # noqa: B027 - for machines that need it
        """Take what the service has. Raises `UsageError` for settings that cannot be."""

    def configure(self, options: Mapping[str, Any]) -> None:
        """Take what the person chooses before a start. Raises `Problem` for what cannot be chosen."""
        if options:
            raise Problem.translated(
                422,
                "No options",
                "case.no_options",
                "this machine has no options; start it without {names}",
                names=", ".join(options),
            )

    async def saved(self) -> None:  # noqa: B027 - for machines that keep a log
        """Return when everything until now is in the database."""

    @abstractmethod
    def start(self) -> None:
        """Let the machine move; a person asks for it."""

    @abstractmethod
    def stop(self) -> None:
        """Bring the machine to a stop within its comfortable deceleration."""

    @abstractmethod
    def step(self, seen: Seen) -> None:
        """Compute one cycle of controller, machine and behaviour."""

    @abstractmethod
    def acts(self) -> Mapping[str, Any]:
        """Return what the simulated person does: effort, posture, lean, isBreathing, movement, contact."""

    def commands(self) -> Sequence[Command]:
        """Return what the controller commands in this cycle, for a real machine on ROS; nothing at rest."""
        return ()

    @abstractmethod
    def state(self) -> MachineState:
        """Return what people see."""

    @abstractmethod
    async def perform_trial(self, trial: Trial) -> None:
        """Perform the trial of the paper: the person acts, and `trial` compares what the machine did."""

    async def work(self) -> None:
        """Do what needs I/O beside the cycles, until cancelled."""
        await asyncio.Event().wait()

    def describe(self) -> Mapping[str, Any]:
        """Return what does not change with each cycle, such as the words of a trainer, for the page."""
        return {}


@dataclass(frozen=True, slots=True)
class Case:
    """A case: its machine, and the person that `handover case` adds to human state.

    `sensors` are simulated; `person_settings` has the curve of the speed
    limit (`freeBpm`, `strainedBpm`, `leastFraction`), rest and maximum. `services` are those that the case
    needs beside broker, human state, this service and the page.
    """

    name: str
    summary: str
    robot: str
    category: str
    make: type[Machine]
    sensors: tuple[Sensor, ...]
    person_settings: Mapping[str, Any]
    services: tuple[str, ...] = ()
    is_own_machine: bool = True
    """False: another service moves the robot, and writes its entities."""

    @property
    def person(self) -> str:
        """Return the name of the simulated person in human state."""
        return f"case-{self.name}"


_MACHINES: Final = "handover_cases.machines"
CASES: Final = ExtensionPoint(
    "case",
    "handover.cases",
    {
        "treadmill": f"{_MACHINES}.treadmill.case:CASE",
        "wheelchair": f"{_MACHINES}.wheelchair.case:CASE",
        "bed": f"{_MACHINES}.bed.case:CASE",
        "bin-picking": f"{_MACHINES}.bin_picking.case:CASE",
    },
)
