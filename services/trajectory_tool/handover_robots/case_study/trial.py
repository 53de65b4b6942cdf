"""A trial: an object is brought from the tray into the box, and what happened is measured.

The robot is one of the tool, in simulated physics. A control session moves it, with the lease, the dead-man
control, equation 1, arbitration and the limiter, by messages in the form of the stream; only the WebSocket is
left out. Simulation, control loop and operator run in lockstep on the simulated clock, in the thread of the
control cycles: a trial takes as long as it computes, and its seed determines it.

The autonomous motion knows the object from a `scan` of the tool: the pose that its camera pipeline estimates,
with a camera that is mounted a little off its nominal place. A trial succeeds when the object lies in the box
at the end.
"""

import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson
import yaml

from handover.control.lease import Leases
from handover.performer import TaskFailed
from handover_datamodels.streams import HumanInput
from handover_robots.case_study.operators import EVERY_S, Operator, Person, Supervisor, view_of
from handover_robots.case_study.seen import SeenObject
from handover_robots.cell.cell import RobotCell
from handover_robots.cell.cell_file import CellPlan, RobotEntry
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.control.recording import Recording
from handover_robots.control.session import ControlSession
from handover_robots.driver_base.context import Clock
from handover_robots.driver_base.control_thread import Cycles
from handover_robots.physics.robot import PhysicsRobot
from handover_robots.physics.robot_bodies import STEP_S
from handover_robots.physics.world_model import fingers_of
from handover_robots.settings import TrajectorySettings
from handover_robots.tasks import operations, parameters
from handover_robots.tasks.work import Work

ROBOT: Final = "panda-1"
TIME_LIMIT_S: Final = 120.0
SETTLE_S: Final = 1.0
MAX_MIX: Final = 0.9
"""The slider of a person in shared control; arbitration stays below it."""


class Mode(StrEnum):
    """A column: m = 1, m by arbitration, m = 0."""

    AUTONOMOUS = "autonomous"
    SHARED = "shared"
    TELEOPERATION = "teleoperation"


@dataclass(slots=True)
class Outcome:
    """What a trial measured; `time_s` is simulated.

    `estimate_error_mm` is that of the camera pipeline; None for cloth, of which it estimates a piece.
    """

    thing: str
    mode: Mode
    seed: int
    is_success: bool
    time_s: float
    attempts: int
    ended: str
    scan: str
    estimate_error_mm: float | None
    mean_mix: float
    cpu_s: float = 0.0


class _Unhindered:
    """Nobody pauses the scan."""

    def may_go(self) -> bool:
        return True

    async def rest(self) -> None:
        return


class Trial:
    """One object, one mode, one seed; the control loop is recorded below `recordings`."""

    def __init__(self, thing: str, mode: Mode, seed: int, recordings: Path | None = None) -> None:
        self._thing, self._mode, self._seed = thing, mode, seed
        self._recordings = recordings
        self._folder = Path(str(files("handover_robots.case_study")))
        self._next_s = 0.0
        self._gripper: str | None = None
        self._sequence = 0
        self._mixes: list[float] = []
        self._ends_s = math.inf
        self._failure: Exception | None = None

    async def run(self) -> Outcome:
        """Perform the trial."""
        with tempfile.TemporaryDirectory() as folder:
            settings = TrajectorySettings(
                data_dir=Path(folder),
                simulation_pace=0,
                scan_seed=self._seed,
                robot_model="panda",
                robot="physics",
            )
            entry = RobotEntry(model="panda", driver="physics", speed=settings.robot_speed)
            plan = CellPlan({ROBOT: entry}, self._scene(), self._folder)
            async with RobotCell(settings, plan=plan) as cell:
                return await self._perform(cell.only)

    def _scene(self) -> dict[str, Any]:
        scene: dict[str, Any] = yaml.safe_load((self._folder / "scene.yaml").read_text(encoding="utf-8"))
        scene["bins"]["tray"]["objects"] = [self._thing]
        return scene

    async def _perform(self, unit: RobotUnit) -> Outcome:
        robot = unit.robot
        assert isinstance(robot, PhysicsRobot)  # noqa: S101 - the plan says so
        clock = robot.clock
        seen = SeenObject(robot.simulation, robot.name, self._thing, fingers_of(unit.model))
        began_s = clock.now_s()
        self._ends_s = began_s + TIME_LIMIT_S
        scan, error_mm = "", None
        if self._mode is not Mode.TELEOPERATION:
            scan, error_mm = await self._scan(unit, seen)
        operator = self._operator(unit, seen)
        leases = Leases()
        if leases.acquire(unit.name, "case-study", "person", "person") is None:
            raise RuntimeError("the robot of a trial is controlled by nobody else")
        if scan != "nothing found" or self._mode is not Mode.AUTONOMOUS:
            with self._recorded(unit) as recording:
                async with ControlSession(unit, (), recording=recording, now=clock.now_s) as session:
                    await self._operate(session, robot, operator)
        time_s = clock.now_s() - began_s
        await robot.in_cycles(_settled(clock))
        walls = unit.scene.bins["box"].walls
        assert walls is not None  # noqa: S101 - the scene has them
        return Outcome(
            self._thing,
            self._mode,
            self._seed,
            is_success=seen.is_in(walls),
            time_s=time_s,
            attempts=operator.attempts,
            ended=operator.outcome or ("time limit" if time_s >= TIME_LIMIT_S else scan),
            scan=scan,
            estimate_error_mm=error_mm,
            mean_mix=sum(self._mixes) / max(len(self._mixes), 1),
        )

    @contextmanager
    def _recorded(self, unit: RobotUnit) -> Iterator[Recording | None]:
        if self._recordings is None:
            yield None
            return
        name = f"{self._thing}-{self._mode}-{self._seed}"
        recording = Recording.begin(self._recordings, name, "simulated", unit.model.joint_names)
        try:
            yield recording
        finally:
            recording.close()

    def _operator(self, unit: RobotUnit, seen: SeenObject) -> Operator:
        if self._mode is Mode.AUTONOMOUS:
            return Supervisor()
        random = np.random.default_rng([self._seed, 17])
        above = unit.scene.fixtures["into-the-box"].nests[0].position
        offered = next((lying.pose for lying in unit.contents.lying if lying.place == "tray"), None)
        return Person(seen, above, MAX_MIX if self._mode is Mode.SHARED else 0.0, random, offered)

    async def _scan(self, unit: RobotUnit, seen: SeenObject) -> tuple[str, float | None]:
        """Scan the tray as a Task does; return why there is no grasp, and the error of the estimate in mm."""
        operation = operations.operation_named("scan")
        read = parameters.read(operation.parameters, "scan", {"bin": "tray"})
        try:
            result = await operation.perform(Work("case-study", "scan", unit, _Unhindered(), 1.0), read)
        except TaskFailed as failure:
            return str(failure), None
        if not result["found"]:
            return str(result["reason"]), None
        lying = unit.contents.find(result["part"])
        middle, true = (lying.middle if lying else (math.nan,) * 3), seen.middle()
        return "", None if seen.is_cloth else 1000 * math.dist(middle[:2], true[:2])

    async def _operate(self, session: ControlSession, robot: PhysicsRobot, operator: Operator) -> None:
        clock, paced = robot.clock, robot.world.paced
        self._next_s = clock.now_s()

        def on_step() -> None:
            if self._failure is None and clock.now_s() >= self._next_s - STEP_S / 2:
                self._next_s += EVERY_S
                try:
                    self._send(session, operator, clock.now_s())
                except Exception as failure:  # noqa: BLE001 - raised below, not in the stepping thread
                    self._failure = failure

        def a_moment() -> Cycles[None]:
            yield clock.now_s() + EVERY_S

        paced.on_step = on_step
        try:
            while self._failure is None and operator.outcome is None and clock.now_s() < self._ends_s:
                if self._gripper is not None:
                    act, self._gripper = self._gripper, None
                    await session.act(act, "case-study")
                    operator.acted(view_of(session.view()), clock.now_s())
                elif not await session.advance():
                    await robot.in_cycles(a_moment())
        finally:
            paced.on_step = lambda: None
        if self._failure is not None:
            raise self._failure

    def _send(self, session: ControlSession, operator: Operator, now_s: float) -> None:
        """Send the next message of the operator; called in the thread of the control cycles."""
        shown = session.view()
        if session.acting:
            message: dict[str, Any] = {"held": True}
        elif operator.outcome is not None or now_s >= self._ends_s:
            message = {"held": False}
        else:
            message = operator.next(view_of(shown), now_s)
        self._sequence += 1
        human_input = HumanInput.model_validate_json(orjson.dumps({"seq": self._sequence, **message}))
        session.receive(human_input)
        if human_input.gripper is not None and not session.acting:
            self._gripper = human_input.gripper
            session.acting = True  # the motion comes to rest, then the gripper acts
        if shown["moves"]:
            self._mixes.append(session.shared.mix)


def _settled(clock: Clock) -> Cycles[None]:
    yield clock.now_s() + SETTLE_S
