"""The estimated state of a humanoid, apart from walking."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import UsageError
from handover_humanoid.balance.estimation import StateEstimator
from handover_humanoid.behaviours.simulated_walk import SimulatedWalk
from handover_humanoid.behaviours.walking import WalkingController
from handover_humanoid.components.robot import RobotSensors
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import (
    BASE_POSITIONS,
    BASE_VELOCITIES,
    GRAVITY_MPS2,
    Array,
    Kinematics,
)
from handover_humanoid.patterns.footsteps import Wish
from handover_humanoid.robots import humanoid
from handover_humanoid.simulation.simulated_robot import TYPICAL_NOISE, SimulatedRobot

COMAN = humanoid("coman")
KINEMATICS = Kinematics(COMAN)
STANDING = KINEMATICS.standing("stand")
HIPS = [BASE_POSITIONS + COMAN.joint_names.index(name) for name in ("LHipYaw", "RHipYaw")]

DT_S = 0.01


@pytest.fixture(scope="module", params=["coman", "talos"])
def robot(request: pytest.FixtureRequest) -> Humanoid:
    """Return a humanoid, or skip with the reason why its model is not there."""
    try:
        return humanoid(request.param)
    except UsageError as error:
        pytest.skip(str(error))


class Standing:
    """A robot on both feet whose other joints are moved, and what its sensors show."""

    def __init__(self, robot: Humanoid) -> None:
        self._kinematics = Kinematics(robot)
        self.q = self._kinematics.standing("stand")
        self.estimator = StateEstimator(Kinematics(robot), self.q)
        self._sensors = RobotSensors(robot)
        for foot in self.estimator.feet.values():
            self._sensors.wrenches[foot.sensor_row, 2] = 150.0

    def move(self, joints: Array, velocities: Array) -> None:
        """Move joints for a period; the base and the feet stay."""
        kinematics, sensors = self._kinematics, self._sensors
        v = np.zeros(kinematics.n_velocities)
        v[BASE_VELOCITIES + joints] = velocities
        self.q[BASE_POSITIONS + joints] += DT_S * velocities
        kinematics.update(self.q, v)
        (inertial,) = kinematics.humanoid.sensors.inertial
        rotation = kinematics.pose(inertial).rotation
        sensors.positions[:], sensors.velocities[:] = self.q[BASE_POSITIONS:], v[BASE_VELOCITIES:]
        sensors.gyroscope[:] = rotation.T @ kinematics.velocity(inertial)[3:]
        sensors.accelerometer[:] = rotation.T @ np.array([0.0, 0.0, GRAVITY_MPS2])
        self.estimator.update(sensors, DT_S)


def test_the_velocity_of_the_centre_of_mass_is_its_change_while_the_arms_move(robot: Humanoid) -> None:
    standing = Standing(robot)
    joints = np.array(robot.indices("left_arm")[:2])
    places, velocities = [], []
    for number in range(60):
        standing.move(joints, np.array([-1.0, 0.8]) * np.sin(0.1 * number))
        places.append(standing.estimator.com)
        velocities.append(standing.estimator.com_velocity)
    change = (np.array(places[1:]) - np.array(places[:-1])) / DT_S
    assert np.abs(change).max() > 0.02
    assert np.array(velocities[1:]) == pytest.approx(change, abs=1e-3)


def test_an_inertial_sensor_on_a_moving_torso_does_not_tilt_the_base() -> None:
    try:
        talos = humanoid("talos")
    except UsageError as error:
        pytest.skip(str(error))
    standing = Standing(talos)
    torso = np.array([talos.index("torso_1_joint"), talos.index("torso_2_joint")])
    for number in range(200):
        standing.move(torso, np.array([0.3, 0.2]) * np.sin(0.05 * number))
        assert standing.estimator.v[3:BASE_VELOCITIES] == pytest.approx(np.zeros(3), abs=1e-9)
    assert abs(standing.q[BASE_POSITIONS + torso]).min() > 0.005
    assert standing.estimator.rotation == pytest.approx(np.eye(3), abs=1e-3)


def test_a_walking_robot_knows_the_velocity_of_its_centre_of_mass(robot: Humanoid) -> None:
    controller = WalkingController(robot)
    walk = SimulatedWalk(controller, SimulatedRobot(robot, controller.start, TYPICAL_NOISE, 1))
    controller.wish = Wish(np.array([0.08, 0.0]))
    truth, errors = Kinematics(robot), []
    for _ in range(400):
        v = walk.robot.true_velocity()
        truth.update(walk.robot.true_configuration())
        walk.cycle()
        errors.append(controller.estimator.com_velocity - truth.centre_of_mass_jacobian() @ v)
    error = np.array(errors)[100:]
    assert np.sqrt((error**2).mean(axis=0)).max() < 0.01
    assert np.abs(error).max() < 0.04  # a foot that lands does not read as a velocity of the body


@given(
    quarter=st.integers(-2, 2),
    yaw=st.floats(-0.2, 0.2),
    turned=st.tuples(st.floats(-0.15, 0.15), st.floats(-0.15, 0.15)),
)
def test_the_frame_between_the_soles_has_their_mean_yaw_whichever_way_the_robot_faces(
    quarter: int, yaw: float, turned: tuple[float, float]
) -> None:
    q = STANDING.copy()
    q[3:7] = pin.Quaternion(pin.exp3(np.array([0.0, 0.0, quarter * math.pi / 2 + yaw]))).coeffs()
    q[HIPS] += turned  # each foot faces another way, as in a turn
    KINEMATICS.update(q)
    links = {contact.link for contact in COMAN.contacts.values()}
    soles = [KINEMATICS.pose(link).rotation for link in links]
    ahead = sum((sole[:2, 0] for sole in soles), np.zeros(2))
    yaw_rad = StateEstimator(KINEMATICS, q).feet_frame()[2]
    assert math.remainder(yaw_rad - math.atan2(ahead[1], ahead[0]), 2 * math.pi) == pytest.approx(
        0.0, abs=1e-3
    )
