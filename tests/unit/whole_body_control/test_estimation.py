"""The estimated state of a humanoid, apart from walking."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.whole_body_control.balance.estimation import StateEstimator
from services.whole_body_control.model.kinematics import BASE_POSITIONS, Kinematics
from services.whole_body_control.robots import humanoid

COMAN = humanoid("coman")
KINEMATICS = Kinematics(COMAN)
STANDING = KINEMATICS.standing("stand")
HIPS = [BASE_POSITIONS + COMAN.joint_names.index(name) for name in ("LHipYaw", "RHipYaw")]


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
    found = StateEstimator(KINEMATICS, q).feet_frame()[2]
    assert math.remainder(found - math.atan2(ahead[1], ahead[0]), 2 * math.pi) == pytest.approx(0.0, abs=1e-3)
