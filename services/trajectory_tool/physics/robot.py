"""The driver `physics`: a robot in simulated physics, with a gripper that holds by contact.

Setpoints drive a simulated servo 500 times a second of simulated time. The state of the simulation, with all
parts, is stored after each act of the gripper and of people, and restored at the next start.
"""

import asyncio
import time
from typing import Self

from handover.errors import UsageError
from handover.messages import message
from services.trajectory_tool.cyclic_robot import CyclicRobot
from services.trajectory_tool.drivers import RobotContext
from services.trajectory_tool.limits.limiter import JointLimiter, Limiter
from services.trajectory_tool.physics.cameras import Cameras
from services.trajectory_tool.physics.pacing import PacedSimulation
from services.trajectory_tool.physics.parts import Parts
from services.trajectory_tool.physics.saved_state import SavedState
from services.trajectory_tool.physics.simulation import Simulation
from services.trajectory_tool.physics.vision import PhysicsVision
from services.trajectory_tool.physics.world_model import STEP_S, build
from services.trajectory_tool.robot import JointState, RobotFault
from services.trajectory_tool.robot_model import RobotModel
from services.trajectory_tool.scene import Scene
from services.trajectory_tool.trajectory import Limits, Setpoint
from services.trajectory_tool.vision import Vision

GRIPPER_TIMEOUT_S = 3.0
CHECK_GRIP_S = 0.02
IDLE_EVERY_S = 0.03
RELEASE_S = 0.3
"""After the gripper has opened: a part that falls out of it lies still."""


class PhysicsRobot(CyclicRobot):
    """A robot in a simulation; `saved` keeps its state, None keeps nothing."""

    def __init__(
        self,
        paced: PacedSimulation,
        model: RobotModel,
        limits: Limits,
        *,
        gripper_s: float = 0.4,
        gripper_closed: bool = False,
        saved: SavedState | None = None,
        vision: Vision | None = None,
        limiter: Limiter | None = None,
    ) -> None:
        super().__init__(
            paced.simulation.positions,
            limits,
            limiter=limiter or JointLimiter(limits, [(each.lower, each.upper) for each in model.joints]),
            control_hz=1 / STEP_S,
            clock=paced.clock,
        )
        self.simulation = paced.simulation
        self.vision = vision
        self._paced = paced
        self._saved = saved
        self._gripper_closed = gripper_closed
        self._idle: asyncio.Task[None] | None = None
        finger = model.fingers[0] if model.fingers else None
        self._opened, self._closed = (finger.opened, finger.closed) if finger else (0.0, 0.0)
        self._finger_mps = max(abs(self._opened - self._closed) / max(gripper_s, 0.1), 0.001)

    @classmethod
    def from_context(cls, context: RobotContext) -> Self:
        """Return the robot of a cell. Raises `UsageError` for a scene that cannot be simulated."""
        settings, scene, model = context.settings, context.scene, context.model
        _require_walls(scene)
        opened = model.fingers[0].opened if model.fingers else 0.0
        simulation = Simulation(build(model, scene, Parts.needed(scene)), context.joints, opened)
        parts = Parts(simulation, scene, settings.scan_seed)
        folder = settings.data_dir / "trajectory_tool"
        saved = SavedState(
            folder / f"{context.robot_id}-physics.npz", f"{scene.digest}-{model.revision}", simulation
        )
        if not saved.load():
            for name in scene.bins:
                parts.fill(name)
        paced = PacedSimulation(simulation, settings.simulation_pace or None)

        def on_changed() -> None:
            paced.resync()
            saved.save()

        cameras = Cameras(simulation, scene, settings.scan_seed, folder / f"{context.robot_id}-cameras.json")
        return cls(
            paced,
            model,
            context.limits,
            gripper_s=context.gripper_s,
            gripper_closed=context.gripper_closed,
            saved=saved,
            vision=PhysicsVision(scene, model, parts, cameras, on_changed) if scene.bins else None,
            limiter=context.limiter,
        )

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        self._paced.resync()
        if self._paced.is_paced:
            self._idle = asyncio.create_task(self._run_between_motions())
        return self

    async def __aexit__(self, *_: object) -> None:
        await super().__aexit__(*_)
        if self._idle is not None:
            self._idle.cancel()
            await asyncio.wait([self._idle])
        await asyncio.to_thread(self._save)

    def command(self, setpoint: Setpoint) -> None:
        """Give the servo a setpoint. Raises `RobotFault` once the arm was blocked."""
        blocked = self.simulation.blocked
        if blocked is not None:
            self.simulation.unblock()
            self.setpoint = Setpoint.at_rest(self.simulation.positions)
            raise RobotFault(
                message(
                    "robot.arm_blocked",
                    "{joint} was {angle} rad away from its command: the arm meets something or carries too "
                    "much; clear its way, then move it away",
                    joint=blocked.joint,
                    angle=f"{abs(blocked.error):.2f}",
                )
            )
        self.simulation.command(setpoint)

    def measured(self) -> JointState:
        """Return the joints with the torques of the drives."""
        simulation = self.simulation
        with simulation.lock:
            return JointState(time.time(), simulation.positions, simulation.velocities, simulation.torques)

    async def close_gripper(self) -> bool:
        """Close the gripper until it holds something or is closed."""
        await self.in_control(lambda: self._move_fingers(self._closed))
        self._gripper_closed = True
        await asyncio.to_thread(self._save)
        return self.is_holding

    async def open_gripper(self) -> None:
        """Open the gripper, and wait until what it held lies still."""
        was_holding = self.is_holding
        await self.in_control(lambda: self._move_fingers(self._opened))
        if was_holding:
            await self.in_control(lambda: self.clock.wait_s(RELEASE_S))
        self._gripper_closed = False
        await asyncio.to_thread(self._save)

    @property
    def gripper_closed(self) -> bool:
        """Return whether the gripper is closed."""
        return self._gripper_closed

    @property
    def is_holding(self) -> bool:
        """Return whether all fingers touch the same part."""
        return self.simulation.gripped_part() is not None

    async def _run_between_motions(self) -> None:
        """Simulate while nothing is commanded; in the control thread, so that motions are never disturbed."""
        while not self.switched_off.is_set():
            await self.in_control(self._paced.catch_up)
            await asyncio.sleep(IDLE_EVERY_S)

    def _move_fingers(self, target: float) -> None:
        self.simulation.move_fingers(target, self._finger_mps)
        ends_s = self.clock.now_s() + GRIPPER_TIMEOUT_S
        while not self.simulation.are_fingers_at_rest and self.clock.now_s() < ends_s:
            self.clock.wait_s(CHECK_GRIP_S)

    def _save(self) -> None:
        if self._saved is not None:
            self._saved.save()


def _require_walls(scene: Scene) -> None:
    for name, bin_ in scene.bins.items():
        if bin_.walls is None:
            raise UsageError(
                f'the bin "{name}" of the scene {scene.name} has no walls, so parts would fall out of it; '
                "give it walls, or set HANDOVER_SCENE_FILE to a scene for physics, such as "
                "robots/ur10/bin_picking_physics.yaml"
            )
        if bin_.camera is not None and bin_.camera not in scene.cameras:
            raise UsageError(
                f'the bin "{name}" of the scene {scene.name} names the camera "{bin_.camera}", which the '
                f"scene does not have; it has {', '.join(scene.cameras) or 'none'}"
            )
