"""A robot of a cell: its gripper, driver and planner, with the scene and the parts around it."""

import asyncio
from contextlib import AsyncExitStack
from typing import Self

from handover.broker import BrokerClient
from handover.runtime.background_tasks import BackgroundTasks
from handover.telemetry import get_logger
from handover_robots.cell.cell_file import RobotEntry
from handover_robots.cell.kinematics import Kinematics
from handover_robots.cell.manual_mode import ManualMode
from handover_robots.cell.memory import Act, BegunAct, RobotMemory
from handover_robots.cell.motion import MotionPlanning
from handover_robots.cell.shared_cell import SharedCell
from handover_robots.driver_base.context import Clock, RobotContext, RobotFactory
from handover_robots.driver_base.cyclic_robot import CyclicRobot
from handover_robots.driver_base.position_file import PositionFile
from handover_robots.driver_base.robot import Robot
from handover_robots.drivers import DRIVERS
from handover_robots.limits.contact_force import ContactForce
from handover_robots.limits.contact_table import ContactSpeed, read_contact_speed
from handover_robots.limits.guards import CollisionGuard, Guard, ToolSpeedGuard, TorqueGuard
from handover_robots.limits.limiter import JointLimiter, Limiter
from handover_robots.limits.neighbours import NeighbourGuard
from handover_robots.limits.robot_limits import RobotLimits
from handover_robots.model.joints import Joints
from handover_robots.model.poses import Pose
from handover_robots.model.robot_model import RobotModel
from handover_robots.people.entities import SOURCE as PEOPLE_IN_BROKER
from handover_robots.people.scanner_fields import read_fields
from handover_robots.planning import is_available
from handover_robots.scene.contents import Contents, Grip, Lying
from handover_robots.scene.scene import Scene

log = get_logger(__name__)


class RobotUnit:
    """A robot with its gripper in a cell, of which it sees the scene and the parts.

    An asynchronous context manager while the robot is switched on. Raises `UsageError` when the robot cannot
    be used as its `entry` in the cell file demands.
    """

    def __init__(
        self,
        cell: SharedCell,
        name: str,
        entry: RobotEntry,
        model: RobotModel,
        *,
        memory: RobotMemory | None = None,
        clock: Clock | None = None,
        broker: BrokerClient | None = None,
    ) -> None:
        self.name = name
        self.entry = entry
        self.model = model
        self.kinematics = Kinematics(model)
        """Used by the control of a person."""
        self.limits = entry.limits_of(name, model)
        self._cell = cell
        self.camera = cell.camera
        self.file = cell.file
        self.neighbour_wait_s = cell.settings.neighbour_wait_s
        self.held: str | None = memory.held if memory else None
        self.grip_of_part: Grip | None = memory.grip if memory else None
        self.last_act: Act | None = memory.last_act if memory else None
        self.seen: str | None = memory.seen if memory else None
        self.begun: BegunAct | None = memory.begun if memory else None
        """The act of the gripper without a known outcome: while it is active, and after an interruption."""
        self.missed: list[Pose] = []
        """Poses at which the gripper has closed on nothing, since a part was gripped."""
        self.to_stir: set[str] = set()
        """Bins in which no part could be gripped."""
        self.in_hand = asyncio.Lock()
        """Locked while a Task or a person uses the robot or its gripper."""
        self.planning = MotionPlanning(
            model,
            self.limits,
            cell.scene,
            name=name,
            space=cell.space,
            joints=lambda: self.joints,
            held=lambda: self.held,
            grip=lambda: self.grip_of_part,
        )
        settings = cell.settings
        sensors = set(settings.people_sensors)
        if settings.people_entities:
            sensors.add(PEOPLE_IN_BROKER)
        if entry.safety_scanner is not None:
            sensors.add(entry.safety_scanner.name)
        self.speed = RobotLimits(
            name,
            model,
            lambda: self.joints,
            cell.limit_store,
            limit_sources=settings.limit_sources,
            people_sensors=sensors,
            hold_s=settings.separation_hold_s,
            zones=cell.scene.all_zones(),
            end_effector=entry.end_effector,
            contact_speed=_contact_speed(entry, cell, name),
            contact=ContactForce(entry.contact_force_n, self._wrist_force_n),
        )
        self._monitoring = AsyncExitStack()
        self.robot: Robot = self._robot(memory, clock, broker)

    async def __aenter__(self) -> Self:
        await self.robot.__aenter__()
        tasks = await self._monitoring.enter_async_context(BackgroundTasks(f"limits of {self.name}"))
        tasks.start(self.speed.run)
        if self.entry.safety_scanner is not None:
            scanner, inputs = self.entry.safety_scanner, self.robot.digital_inputs
            tasks.start(read_fields, scanner, inputs, self.speed.receive_people)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._monitoring.aclose()
        await self.robot.__aexit__(*_)
        try:
            await self.remember()
        except OSError:
            log.exception("state of the cell not stored", file=str(self.file.path))

    def _joints_at_rest(self) -> Joints | None:
        robot = self.robot
        if isinstance(robot, CyclicRobot):
            return None if robot.is_moving else robot.state().positions
        state = robot.state()
        return None if any(state.velocities) else state.positions

    def _wrist_force_n(self) -> float | None:
        return self.robot.wrist_force_n()

    @property
    def manual(self) -> ManualMode:
        """Return the manual mode of the cell."""
        return self._cell.manual

    @property
    def home(self) -> Joints:
        """Return the home position."""
        return self._cell.home_of(self.model)

    @property
    def scene(self) -> Scene:
        """Return the scene."""
        return self._cell.scene

    @property
    def contents(self) -> Contents:
        """Return the parts that lie in the cell."""
        return self._cell.contents

    @contents.setter
    def contents(self, contents: Contents) -> None:
        self._cell.contents = contents

    @property
    def joints(self) -> Joints:
        """Return the present joint positions."""
        return self.robot.state().positions

    @property
    def tool_pose(self) -> Pose:
        """Return the present pose of the gripper's tips."""
        return self.model.tool_pose(self.joints)

    def memory(self) -> RobotMemory:
        """Return the state of the robot that survives a power cut."""
        joints = self.positions.base = self.joints
        return RobotMemory(
            joint_names=self.model.joint_names,
            joints=joints,
            gripper_closed=self.robot.gripper_closed,
            held=self.held,
            last_act=self.last_act,
            seen=self.seen,
            begun=self.begun,
            grip=self.grip_of_part,
        )

    async def remember(self) -> None:
        """Store the state of the cell durably. Raises `OSError`."""
        await self._cell.remember()

    async def grip(self, task: str, *, may_be_unknown: bool = False) -> str | None:
        """Close the gripper for `task`; return the gripped part, None (and open again) without one.

        Something between the fingers that no camera has seen counts only where it `may_be_unknown`, as for a
        person who sees what is gripped; it gets a name.
        """
        await self._begin(BegunAct(task, "grip"))
        pose = self.tool_pose
        is_gripped = await self.robot.close_gripper()
        part = self._between_fingers(pose) if is_gripped else None
        if part is None and is_gripped and may_be_unknown:
            self.contents, part = self.contents.named()
        if part is None:
            self.missed.append(pose)
            await self.robot.open_gripper()
        else:
            self.missed.clear()
            lay = self.contents.find(part)
            self.grip_of_part = lay.grip if lay else None
            self.contents, self.held = self.contents.gripped(part), part
            self.last_act = Act(task, "gripped", part, pose)
        self.begun = None
        await self.remember()
        return part

    async def release(self, task: str, place: str | None) -> None:
        """Open the gripper for `task`; the part stays at its pose, in the fixture `place` if given."""
        await self._begin(BegunAct(task, "release"))
        pose, part = self.tool_pose, self.held
        await self.robot.open_gripper()
        self.begun = None
        if part is not None:
            self.contents, self.held = self.contents.released(part, place, pose, self.grip_of_part), None
            self.grip_of_part = None
            self.last_act = Act(task, "released", part, pose, place)
        await self.remember()

    async def lose(self) -> str | None:
        """Note that the held part has slipped out of the gripper, and open it; return that part."""
        part, self.held, self.grip_of_part = self.held, None, None
        await self.robot.open_gripper()
        await self.remember()
        return part

    async def give(self, task: str) -> None:
        """Open the gripper for `task`; a person takes the part out of the cell."""
        await self._begin(BegunAct(task, "release"))
        pose, part = self.tool_pose, self.held
        await self.robot.open_gripper()
        self.begun = None
        if part is not None:
            self.held, self.grip_of_part = None, None
            self.last_act = Act(task, "released", part, pose)
        await self.remember()

    async def take(self, task: str, part: str) -> bool:
        """Close the gripper for `task` on `part`, which a person holds there; return whether it is gripped.

        It opens again when nothing is between the fingers.
        """
        await self._begin(BegunAct(task, "grip"))
        pose = self.tool_pose
        self.contents = self.contents.released(part, None, pose)  # a simulated gripper closes on it
        vision = self.robot.vision
        try:
            grip = None if vision is None else await vision.hold_out()
            is_gripped = await self.robot.close_gripper()
            if vision is not None and grip is not None:
                await vision.let_go()
                is_gripped = is_gripped and self.robot.is_holding is not False
        finally:
            self.contents = self.contents.gripped(part)
        if is_gripped:
            self.grip_of_part = grip
            self.held, self.last_act = part, Act(task, "gripped", part, pose)
        else:
            await self.robot.open_gripper()
        self.begun = None
        await self.remember()
        return is_gripped

    async def free(self) -> str | None:
        """Open the gripper so that a person can remove the part; return that part.

        The person also sees what the gripper held, so an unknown outcome is settled.
        """
        async with self.in_hand:
            self.robot.authority()
            part = self.held
            await self.robot.open_gripper()
            self.held = None
            self.grip_of_part = None
            self.begun = None
            await self.remember()
        return part

    async def _begin(self, act: BegunAct) -> None:
        """Record that an act begins. Raises `OSError` if that is impossible; it must not begin then.

        Raises `RobotFault` without the lease of the robot.
        """
        self.robot.authority()
        self.begun = act
        try:
            await self.remember()
        except OSError:
            self.begun = None
            raise

    def done_for(self, task: str) -> Act | None:
        """Return the gripper's last act if it was for `task`."""
        return self.last_act if self.last_act is not None and self.last_act.task == task else None

    def parts_in(self, place: str) -> list[Lying]:
        """Return the parts in a bin or fixture, the topmost first."""
        return self.contents.in_place(place)

    def look_into(self, bin_name: str) -> Lying | None:
        """Return the part that the camera detects in a bin; None without one."""
        part = self.camera.look([lying.part for lying in self.parts_in(bin_name)])
        self.seen = part or self.seen
        return self.contents.find(part) if part else None

    async def found_empty(self, bin_name: str) -> None:
        """Handle an empty bin; a bin that people fill is full afterwards."""
        if not self.scene.bins[bin_name].refilled:
            return
        if self.robot.vision is not None:
            await self.robot.vision.fill(bin_name)
        else:
            self.contents = self.contents.filled(self.scene, bin_name)

    async def nest_in(self, fixture: str) -> Pose | None:
        """Return a free nest of a fixture; a full fixture is emptied first if the next station does so."""
        nest = self.contents.free_nest(self.scene, fixture)
        if nest is None and self.scene.fixtures[fixture].emptied:
            if self.robot.vision is not None:
                await self.robot.vision.clear(fixture)
            self.contents = self.contents.emptied(fixture)
            nest = self.contents.free_nest(self.scene, fixture)
        return nest

    def _robot(self, memory: RobotMemory | None, clock: Clock | None, broker: BrokerClient | None) -> Robot:
        joints = self._cell.stored_joints(self.name)
        self.positions = PositionFile(self._cell.folder / f"{self.name}.joints", joints)
        context = RobotContext(
            settings=self._cell.settings,
            robot_id=self.name,
            options=self.entry.settings,
            model=self.model,
            scene=self.scene,
            limits=self.limits,
            joints=joints,
            gripper_closed=memory.gripper_closed if memory else False,
            gripper_s=self.scene.gripper.acts_in_s,
            is_between_fingers=lambda joints: self._between_fingers(self.model.tool_pose(joints)) is not None,
            broker=broker,
            clock=clock,
            limiter=self._limiter(),
            positions=self.positions,
            peers=self._cell.peers_of(self.entry.driver),
            shared=self._cell.shared.setdefault(self.entry.driver, {}),
        )
        factory: RobotFactory = DRIVERS.load(self.entry.driver)
        return factory(context)

    def _limiter(self) -> Limiter:
        """Return the limiter: joint limits, collisions, also with itself, and torques of planned motions."""
        ranges = [(joint.lower, joint.upper) for joint in self.model.joints]
        guards: list[Guard] = [
            ToolSpeedGuard(self.model, self.speed.tool_limit_mps, lambda: self.speed.zones)
        ]
        if is_available():
            guards.append(CollisionGuard(self.model, self.planning.world))
        if self.planning.avoids_obstacles and is_available():
            guards.append(TorqueGuard(self.model, self.planning.world))
        if self._cell.has_several_robots:
            robots = self._cell.moving
            robots.add(self.name, self.model, self._joints_at_rest, lambda: self.planning.world().attached)
            guards.append(NeighbourGuard(self.name, robots))
        return JointLimiter(self.limits, ranges, guards)

    def _between_fingers(self, tool: Pose) -> str | None:
        return self.contents.between_fingers(tool, self.scene.gripper.opening_m)


def _contact_speed(entry: RobotEntry, cell: SharedCell, name: str) -> ContactSpeed | None:
    return None if entry.contact is None else read_contact_speed(entry.contact, cell.plan_folder, name)
