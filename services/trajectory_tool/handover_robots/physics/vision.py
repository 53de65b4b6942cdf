"""The vision of the simulated cell: its depth camera, and the search for parts and grasps in the images."""

import asyncio
import math
from collections.abc import Callable, Iterator, Mapping, Sequence

from handover.messages import Message
from handover_robots.model.faults import RobotFault
from handover_robots.model.poses import NO_TURN, Frame, Pose, Vector
from handover_robots.model.robot_model import RobotModel
from handover_robots.perception import hand_eye
from handover_robots.perception.depth_image import DepthImage
from handover_robots.perception.grasps import AT_TIP, MIN_BELOW_M, Fingers, GraspFinder
from handover_robots.perception.heaps import find_things
from handover_robots.perception.segmentation import Inside, SeenPart, find_parts
from handover_robots.physics.cameras import HAND_CAMERA, Cameras
from handover_robots.physics.shared_world import SharedWorld
from handover_robots.physics.world_model import DEFAULT_PART_SIZE_M, fingers_of
from handover_robots.scene.contents import Grip
from handover_robots.scene.scene import OpenBox, Scene
from handover_robots.scene.vision import SeenBall, SeenGrasp, Sighting

MAX_GRASPS = 16
MAX_REPEATS_M = 0.002
SAME_PART_M = 0.01
"""A part that two views show this near to each other is one: parts are thicker than that."""


class PhysicsVision:
    """Looks with the camera of each bin, which is where its calibration says."""

    def __init__(
        self,
        world: SharedWorld,
        robot: str,
        model: RobotModel,
        cameras_of: Callable[[Scene, Frame], Cameras],
    ) -> None:
        self.parts = world.parts
        self._world = world
        self._robot = robot
        self._model = model
        self._cameras_of = cameras_of
        self._fingers: Fingers | None = None
        self._handed: int | None = None
        self._images: dict[str, dict[int, DepthImage]] = {}
        """The image of each view of a bin, since view 0."""
        self.prepare_scene(world.scene)()

    def prepare_scene(self, scene: Scene) -> Callable[[], None]:
        """Return what continues in a scene. Raises `UsageError` for bins that no gripper can empty."""
        fingers = self._fingers
        is_alone = len(self._world.simulation.arms) == 1
        if fingers is None and scene.bins and (self._model.fingers or is_alone):
            fingers = fingers_of(self._model)
        frame = AT_TIP if fingers is None else fingers.frame

        def apply() -> None:
            self._scene, self._fingers = scene, fingers
            self.cameras = self._cameras_of(scene, frame)
            self._part_size_m = scene.gripper.part_size_m or DEFAULT_PART_SIZE_M
            self.forget_images()

        return apply

    async def look(self, bin_name: str, view: int = 0) -> Sequence[Sighting]:
        """Return the parts that are seen in a bin, the topmost first."""
        return await asyncio.to_thread(self._look, bin_name, view)

    def forget_images(self) -> None:
        """Forget the images of earlier views: something in the cell was moved."""
        self._images.clear()

    @property
    def fixed_cameras(self) -> Sequence[str]:
        """Return the cameras of the scene."""
        return [name for name in self.cameras if name != HAND_CAMERA]

    async def find_ball(self, place: Vector, radius_m: float, camera: str | None = None) -> SeenBall | None:
        """Return the ball that a camera sees near to a place; None without one."""
        return await asyncio.to_thread(self._find_ball, place, radius_m, camera or HAND_CAMERA)

    async def calibrate(self, seen: Sequence[SeenBall]) -> Mapping[str, float]:
        """Store where the camera in the hand is mounted. Raises `NotCalibrated`."""
        nominal = self.cameras.calibrated(HAND_CAMERA).frame
        calibration = await asyncio.to_thread(hand_eye.in_hand, seen, nominal)
        return await self._store(HAND_CAMERA, calibration)

    async def calibrate_fixed(
        self, camera: str, places: Sequence[Vector], seen: Sequence[Vector]
    ) -> Mapping[str, float]:
        """Store where a fixed camera is mounted. Raises `NotCalibrated` and `OSError`."""
        return await self._store(camera, hand_eye.fixed(places, seen))

    async def _store(self, camera: str, calibration: hand_eye.Calibration) -> Mapping[str, float]:
        nominal = self.cameras.calibrated(camera).frame
        await asyncio.to_thread(self.cameras.calibrate, camera, calibration.mount)
        self.forget_images()
        change = nominal.inverse() @ calibration.mount
        trace = sum(change.rotation[axis][axis] for axis in range(3))
        return {
            "residualMm": round(1000 * calibration.residual_m, 2),
            "movedMm": round(1000 * math.hypot(*change.position), 2),
            "turnedDeg": round(math.degrees(math.acos(min((trace - 1) / 2, 1.0))), 3),
        }

    def _find_ball(self, place: Vector, radius_m: float, camera: str) -> SeenBall | None:
        mount = self.cameras.calibrated(camera)
        tool, image = self.cameras[camera].image_with_tool(mount)
        expected = (mount.camera(tool).inverse() @ Frame(NO_TURN, place)).position
        ball = hand_eye.find_ball(image, expected, radius_m)
        return None if ball is None else SeenBall(tool, ball)

    async def fill(self, bin_name: str) -> None:
        """Have an empty bin filled."""
        await self._done(self.parts.fill(bin_name))

    async def stir(self, bin_name: str) -> None:
        """Have the parts in a bin moved."""
        await self._done(self.parts.stir(bin_name))

    async def clear(self, fixture: str) -> None:
        """Have the parts in a fixture taken away."""
        self.parts.clear(fixture)
        await self._done(iter(()))

    async def hold_out(self) -> Grip | None:
        """Have a person hold a part between the opened fingers, half a part deep; return how it is held."""
        if self._fingers is None:
            return None
        width, _, height = size = self._part_size_m
        if width > self._fingers.opening:
            return None
        held = self._fingers.frame @ Frame(NO_TURN, (0.0, 0.0, MIN_BELOW_M - height / 2))
        with self._world.simulation.lock:
            tool = self._world.simulation.arms[self._robot].tool
            self._handed = self.parts.hold_out(Pose.of(tool @ held))
        return None if self._handed is None else Grip(Pose.of(held), size)

    async def let_go(self) -> None:
        """Have the person let go of that part; then it stays in the gripper, or falls."""
        part, self._handed = self._handed, None
        if part is not None:
            await self._done(self.parts.let_go(part))

    async def _done(self, course: Iterator[float]) -> None:
        await self._world.fast_forward(self._robot, course)
        self.forget_images()
        await asyncio.to_thread(self._world.save)

    def _look(self, bin_name: str, view: int) -> list[Sighting]:
        bin_, fingers = self._scene.bins[bin_name], self._fingers
        if fingers is None:
            raise RobotFault.translated(
                "robot.no_gripper_for_bins",
                "{robot} has no gripper for bin picking; let another robot scan",
                robot=self._robot,
            )
        assert bin_.walls is not None  # noqa: S101 - checked when the robot is made
        camera = bin_.camera or HAND_CAMERA
        image = self.cameras[camera].image(self.cameras.calibrated(camera))
        images = self._images[bin_name] = {**(self._images.get(bin_name, {}) if view else {}), view: image}
        inside = inside_of(bin_.walls)
        seen = []
        for taken in images.values():
            further = [other for other in images.values() if other is not taken]
            finder = GraspFinder(taken, inside, fingers, further)
            if bin_.objects:
                parts = find_things(taken, inside, fingers)
            else:
                parts = find_parts(taken, inside, self._part_size_m)
            seen += [(part, finder) for part in parts]
        sightings, to_tip = [], fingers.frame.inverse()
        for part, finder in _each_once(seen):
            grasps = finder.grasps(part)
            if isinstance(grasps, Message):
                sightings.append(Sighting(Pose.of(part.pose), reason=grasps))
                continue
            chosen: list[SeenGrasp] = []
            for grasp in grasps:
                tip = grasp.tool @ to_tip
                tool = Pose.of(tip)
                if all(not _is_same(tool, other.tool) for other in chosen):
                    held = tip.inverse() @ grasp.part
                    chosen.append(SeenGrasp(tool, Grip(Pose.of(held), grasp.size)))
                if len(chosen) == MAX_GRASPS:
                    break
            sightings.append(Sighting(Pose.of(part.pose), tuple(chosen)))
        return sightings


def inside_of(walls: OpenBox) -> Inside:
    """Return the inside of a bin."""
    (width, depth, height), wall = walls.size, walls.wall_m
    bottom = walls.pose.frame() @ Frame(NO_TURN, (0.0, 0.0, wall))
    return Inside(bottom, width - 2 * wall, depth - 2 * wall, height - wall)


def _each_once(seen: Sequence[tuple[SeenPart, GraspFinder]]) -> list[tuple[SeenPart, GraspFinder]]:
    """Return each part as the view shows it that shows most of it, the highest first."""
    kept: list[tuple[SeenPart, GraspFinder]] = []
    for grasp, view in sorted(seen, key=lambda grasp: -grasp[0].cover):
        same = (other for other, by in kept if by is not view)
        if all(math.dist(grasp.pose.position, other.pose.position) > SAME_PART_M for other in same):
            kept.append((grasp, view))
    return sorted(kept, key=lambda seen_grasp: -seen_grasp[0].top_m)


def _is_same(first: Pose, second: Pose) -> bool:
    return first.distance_m(second) < MAX_REPEATS_M and first.orientation == second.orientation
