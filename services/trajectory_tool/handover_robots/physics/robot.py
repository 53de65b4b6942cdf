"""The driver `physics`: a robot in simulated physics, with a gripper that holds by contact.

Setpoints drive a simulated servo 500 times a second of simulated time. All robots of a cell with this driver
share one world, whose thread runs their cycles. The state of the world, with all parts, is stored after each
act of a gripper and of people, and restored at the next start. The joints are kept in the position file of
each robot, in each cycle of a motion, as by the kinematic robot.
"""

import asyncio
import math
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from typing import Self, TypeVar

from handover.runtime.control_cycle import runs_in_cycle
from handover_robots.driver_base.context import Clock, RobotContext
from handover_robots.driver_base.control_thread import Cycles
from handover_robots.driver_base.cyclic_robot import CyclicRobot
from handover_robots.driver_base.position_file import PositionFile
from handover_robots.driver_base.robot import TruePart
from handover_robots.limits.limiter import JointLimiter, Limiter
from handover_robots.model.faults import RobotFault
from handover_robots.model.joints import JointState
from handover_robots.model.poses import Frame
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.trajectory import Limits, Setpoint
from handover_robots.physics.cameras import Cameras
from handover_robots.physics.robot_bodies import STEP_S
from handover_robots.physics.shared_world import SharedWorld
from handover_robots.physics.vision import PhysicsVision
from handover_robots.scene.scene import Scene

T = TypeVar("T")

GRIPPER_TIMEOUT_S = 3.0
CHECK_GRIP_S = 0.02
RELEASE_S = 0.3
"""After the gripper has opened: a part that falls out of it lies still."""


class PhysicsRobot(CyclicRobot):
    """The robot `name` of a world."""

    def __init__(
        self,
        world: SharedWorld,
        name: str,
        model: RobotModel,
        limits: Limits,
        *,
        gripper_s: float = 0.4,
        gripper_closed: bool = False,
        positions: PositionFile | None = None,
        vision: PhysicsVision | None = None,
        limiter: Limiter | None = None,
    ) -> None:
        self.simulation = simulation = world.simulation
        self.arm = simulation.arms[name]
        super().__init__(
            self.arm.positions,
            limits,
            limiter=limiter or JointLimiter(limits, [(joint.lower, joint.upper) for joint in model.joints]),
            control_hz=1 / STEP_S,
            clock=Clock(lambda: simulation.time_s),
        )
        self.name = name
        self.world = world
        self.vision: PhysicsVision | None = vision
        self._positions = positions
        self._gripper_closed = gripper_closed
        self._is_on = False
        finger = model.fingers[0] if model.fingers else None
        self._opened, self._closed = (finger.opened, finger.closed) if finger else (0.0, 0.0)
        self._finger_mps = max(abs(self._opened - self._closed) / max(gripper_s, 0.1), 0.001)

    @classmethod
    def from_context(cls, context: RobotContext) -> Self:
        """Return the robot of a cell. Raises `UsageError` for a scene that cannot be simulated."""
        settings, name = context.settings, context.robot_id
        world = SharedWorld.of(context)
        simulation = world.simulation
        if context.positions is not None:
            simulation.place_arm(name, context.positions.open())
        calibrations = settings.data_dir / "trajectory_tool" / f"{name}-cameras.json"

        def cameras_of(scene: Scene, fingers: Frame) -> Cameras:
            arm, seed = simulation.arms[name], settings.scan_seed
            return Cameras(simulation, arm, scene, seed=seed, file=calibrations, fingers=fingers)

        return cls(
            world,
            name,
            context.model,
            context.limits,
            gripper_s=context.gripper_s,
            gripper_closed=context.gripper_closed,
            positions=context.positions,
            vision=PhysicsVision(world, name, context.model, cameras_of),
            limiter=context.limiter,
        )

    async def __aenter__(self) -> Self:
        if not self._is_on:
            self._is_on = True
            self.world.paced.start()
        return await super().__aenter__()

    async def __aexit__(self, *_: object) -> None:
        await super().__aexit__(*_)
        await asyncio.to_thread(self.world.paced.drain, self.name)
        if self._is_on:
            self._is_on = False
            self.world.paced.stop()
        await asyncio.to_thread(self.world.save)

    def submit(self, cycles: Cycles[T]) -> "Future[T]":
        """Run `cycles` in the thread of the world, after what the robot does there."""
        return self.world.paced.submit(self.name, cycles)

    @runs_in_cycle
    def command(self, setpoint: Setpoint) -> None:
        """Give the servo a setpoint. Raises `RobotFault` once the arm was blocked."""
        blocked = self.arm.blocked
        if blocked is not None:
            self.arm.unblock()
            self.setpoint = Setpoint.at_rest(self.arm.positions)
            raise RobotFault.translated(
                "robot.arm_blocked",
                "{joint} was {angle} rad away from its command: the arm meets something or carries too "
                "much; clear its way, then move it away",
                joint=blocked.joint,
                angle=f"{abs(blocked.error):.2f}",
            )
        self.arm.command(setpoint)
        if self._positions is not None:
            self._positions.write(self.arm.positions)

    def measured(self) -> JointState:
        """Return the joints with the torques of the drives."""
        arm = self.arm
        with self.simulation.lock:
            return JointState(time.time(), arm.positions, arm.velocities, arm.torques)

    def wrist_force_n(self) -> float:
        """Return the force at the wrist, with the weight of the tool and the part."""
        return math.hypot(*self.arm.wrench.force)

    async def close_gripper(self) -> bool:
        """Close the gripper until it holds something or is closed."""
        await self.in_cycles(self._move_fingers(self._closed))
        self._gripper_closed = True
        await asyncio.to_thread(self.world.save)
        return self.is_holding

    async def open_gripper(self) -> None:
        """Open the gripper, and wait until what it held lies still."""
        was_holding = self.is_holding
        await self.in_cycles(self._move_fingers(self._opened, RELEASE_S if was_holding else 0.0))
        self._gripper_closed = False
        await asyncio.to_thread(self.world.save)

    @property
    def gripper_closed(self) -> bool:
        """Return whether the gripper is closed."""
        return self._gripper_closed

    @property
    def is_holding(self) -> bool:
        """Return whether all fingers touch the same part."""
        return self.simulation.gripped_part(self.name) is not None

    def true_parts(self) -> list[TruePart]:
        """Return the parts in the cell, but for those in grippers. One robot of a world reports them."""
        simulation = self.simulation
        if self.name != next(iter(simulation.arms)):
            return []
        with simulation.lock:
            held = simulation.gripped_parts()
            return [
                TruePart(pose, size)
                for part in range(len(simulation.world.parts))
                if part not in held and not simulation.is_parked(part)
                for pose, size in simulation.part_boxes(part)
            ]

    def prepare_scene(self, scene: Scene) -> Callable[[], Awaitable[None]] | None:
        """Return what continues the simulation in a changed scene; see `SharedWorld.prepare_scene`."""
        change = self.world.prepare_scene(scene)
        look = None if self.vision is None else self.vision.prepare_scene(scene)

        async def apply() -> None:
            await change()
            if look is not None:
                look()

        return apply

    @runs_in_cycle
    def _move_fingers(self, target: float, then_wait_s: float = 0.0) -> Cycles[None]:
        if self.vision is not None:
            self.vision.forget_images()
        self.arm.move_fingers(target, self._finger_mps)
        ends_s = self.clock.now_s() + GRIPPER_TIMEOUT_S
        while not self.arm.are_fingers_at_rest and self.clock.now_s() < ends_s:
            yield self.clock.now_s() + CHECK_GRIP_S
        if then_wait_s > 0:
            yield self.clock.now_s() + then_wait_s
