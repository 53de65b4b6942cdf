"""The vision of the simulated cell: its depth camera, and the search for parts and grasps in the images."""

import asyncio
import math
from collections.abc import Callable, Mapping, Sequence

from handover.messages import Message
from services.trajectory_tool.contents import Grip
from services.trajectory_tool.perception import hand_eye
from services.trajectory_tool.perception.grasps import GraspFinder
from services.trajectory_tool.perception.segmentation import Inside, find_parts
from services.trajectory_tool.physics.cameras import HAND_CAMERA, Cameras
from services.trajectory_tool.physics.parts import Parts
from services.trajectory_tool.physics.world_model import DEFAULT_PART_SIZE_M, fingers_of
from services.trajectory_tool.poses import NO_TURN, Frame, Pose, Vector
from services.trajectory_tool.robot_model import RobotModel
from services.trajectory_tool.scene import OpenBox, Scene
from services.trajectory_tool.vision import SeenBall, SeenGrasp, Sighting

MAX_GRASPS = 16
MAX_REPEATS_M = 0.002


class PhysicsVision:
    """Looks with the camera of each bin, which is where its calibration says."""

    def __init__(
        self,
        scene: Scene,
        model: RobotModel,
        parts: Parts,
        cameras: Cameras,
        on_changed: Callable[[], None],
    ) -> None:
        self.cameras = cameras
        self.parts = parts
        self._scene = scene
        self._fingers = fingers_of(model)
        self._part_size_m = scene.gripper.part_size_m or DEFAULT_PART_SIZE_M
        self._on_changed = on_changed

    async def look(self, bin_name: str) -> Sequence[Sighting]:
        """Return the parts that are seen in a bin, the topmost first."""
        return await asyncio.to_thread(self._look, bin_name)

    async def find_ball(self, place: Vector, radius_m: float) -> SeenBall | None:
        """Return the ball that the camera in the hand sees near to a place; None without one."""
        return await asyncio.to_thread(self._find_ball, place, radius_m)

    async def calibrate(self, seen: Sequence[SeenBall]) -> Mapping[str, float]:
        """Store where the camera in the hand is mounted. Raises `NotCalibrated`."""
        nominal = self.cameras.calibrated(HAND_CAMERA).frame
        found = await asyncio.to_thread(hand_eye.in_hand, seen, nominal)
        await asyncio.to_thread(self.cameras.calibrate, HAND_CAMERA, found.mount)
        change = nominal.inverse() @ found.mount
        trace = sum(change.rotation[axis][axis] for axis in range(3))
        return {
            "residualMm": round(1000 * found.residual_m, 2),
            "movedMm": round(1000 * math.hypot(*change.position), 2),
            "turnedDeg": round(math.degrees(math.acos(min((trace - 1) / 2, 1.0))), 3),
        }

    def _find_ball(self, place: Vector, radius_m: float) -> SeenBall | None:
        mount = self.cameras.calibrated(HAND_CAMERA)
        tool, image = self.cameras[HAND_CAMERA].image_with_tool(mount)
        expected = (mount.camera(tool).inverse() @ Frame(NO_TURN, place)).position
        ball = hand_eye.find_ball(image, expected, radius_m)
        return None if ball is None else SeenBall(tool, ball)

    async def fill(self, bin_name: str) -> None:
        """Have an empty bin filled."""
        await self._done(lambda: self.parts.fill(bin_name))

    async def stir(self, bin_name: str) -> None:
        """Have the parts in a bin moved."""
        await self._done(lambda: self.parts.stir(bin_name))

    async def clear(self, fixture: str) -> None:
        """Have the parts in a fixture taken away."""
        await self._done(lambda: self.parts.clear(fixture))

    async def _done(self, act: Callable[[], None]) -> None:
        await asyncio.to_thread(act)
        await asyncio.to_thread(self._on_changed)

    def _look(self, bin_name: str) -> list[Sighting]:
        bin_ = self._scene.bins[bin_name]
        assert bin_.walls is not None  # noqa: S101 - checked when the robot is made
        camera = bin_.camera or HAND_CAMERA
        image = self.cameras[camera].image(self.cameras.calibrated(camera))
        inside = inside_of(bin_.walls)
        finder = GraspFinder(image, inside, self._fingers)
        found = []
        for part in find_parts(image, inside, self._part_size_m):
            grasps = finder.grasps(part)
            if isinstance(grasps, Message):
                found.append(Sighting(Pose.of(part.pose), reason=grasps))
                continue
            chosen: list[SeenGrasp] = []
            for grasp in grasps:
                tool = Pose.of(grasp.tool)
                if all(not _is_same(tool, other.tool) for other in chosen):
                    chosen.append(SeenGrasp(tool, Grip(Pose.of(grasp.grip), grasp.size)))
                if len(chosen) == MAX_GRASPS:
                    break
            found.append(Sighting(Pose.of(part.pose), tuple(chosen)))
        return found


def inside_of(walls: OpenBox) -> Inside:
    """Return the inside of a bin."""
    (width, depth, height), wall = walls.size, walls.wall_m
    bottom = walls.pose.frame() @ Frame(NO_TURN, (0.0, 0.0, wall))
    return Inside(bottom, width - 2 * wall, depth - 2 * wall, height - wall)


def _is_same(one: Pose, other: Pose) -> bool:
    return one.distance_m(other) < MAX_REPEATS_M and one.orientation == other.orientation
