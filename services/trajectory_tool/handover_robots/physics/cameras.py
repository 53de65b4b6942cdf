"""The cameras of a simulated cell: where the scene says they are, where they are, and their calibration.

A camera is mounted a few millimetres and tenths of a degree off its place in the scene, as fitters leave it.
`calibrated` is what the tool assumes: the place in the scene, or the stored result of a calibration.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

from handover.files.durable_files import replace_durably
from handover.telemetry import get_logger
from handover_robots.model.poses import NO_TURN, Frame, Pose
from handover_robots.perception.depth_image import Intrinsics
from handover_robots.perception.grasps import AT_TIP
from handover_robots.physics.arm import SimulatedArm
from handover_robots.physics.depth_camera import CameraMount, DepthCamera, misaligned
from handover_robots.physics.simulation import Simulation
from handover_robots.scene.scene import Scene

log = get_logger(__name__)

HAND_CAMERA = "hand"
HAND_MOUNT = CameraMount(Frame(NO_TURN, (0.0, 0.07, -0.12)), in_hand=True)
"""Beside the palm of the gripper, in the frame of the fingers; it looks along them."""

HAND_VIEW_DEG = 50.0
WIDTH, HEIGHT = 320, 240
OFF_M = 0.002
OFF_DEG = 0.3


class Cameras(Mapping[str, DepthCamera]):
    """The cameras of an arm by name: beside its `fingers` in the frame of the tip, and of the scene."""

    def __init__(
        self,
        simulation: Simulation,
        arm: SimulatedArm,
        scene: Scene,
        *,
        seed: int,
        file: Path | None = None,
        fingers: Frame = AT_TIP,
    ) -> None:
        self._file = file
        hand = CameraMount(fingers @ HAND_MOUNT.frame, in_hand=True)
        nominal = {HAND_CAMERA: (hand, HAND_VIEW_DEG)}
        for name, camera in scene.cameras.items():
            nominal[name] = (CameraMount(camera.optical_frame, in_hand=False), camera.field_of_view_deg)
        self._cameras = {
            name: DepthCamera(
                simulation,
                arm,
                misaligned(mount, seed + number, OFF_M, OFF_DEG),
                Intrinsics.of_view(WIDTH, HEIGHT, view_deg),
                seed=seed + number,
            )
            for number, (name, (mount, view_deg)) in enumerate(nominal.items())
        }
        self._calibrated = {name: mount for name, (mount, _) in nominal.items()} | self._stored()

    def __getitem__(self, name: str) -> DepthCamera:
        return self._cameras[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._cameras)

    def __len__(self) -> int:
        return len(self._cameras)

    def calibrated(self, name: str) -> CameraMount:
        """Return where a camera is, as far as is known."""
        return self._calibrated[name]

    def calibrate(self, name: str, frame: Frame) -> None:
        """Store durably where a camera is. Raises `OSError`; the camera is then where it was before."""
        mount = CameraMount(frame, self._cameras[name].mount.in_hand)
        mounts = self._calibrated | {name: mount}
        if self._file is not None:
            written = {name: Pose.of(mount.frame).written() for name, mount in mounts.items()}
            replace_durably(self._file, json.dumps(written, indent=1).encode())
        self._calibrated = mounts

    def _stored(self) -> dict[str, CameraMount]:
        if self._file is None:
            return {}
        try:
            written = json.loads(self._file.read_text(encoding="utf-8"))
            return {
                name: CameraMount(
                    Pose(tuple(pose["position"]), tuple(pose["orientation"])).frame(),
                    self._cameras[name].mount.in_hand,
                )
                for name, pose in written.items()
                if name in self._cameras
            }
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            log.warning("calibration of the cameras not read", file=str(self._file), error=str(error))
            return {}
