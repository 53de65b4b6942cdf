"""Kinematics of a humanoid: Jacobians agree with finite differences, poses stand on the ground."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import UsageError
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.robots import humanoid

COMAN = humanoid("coman")
DT_S = 1e-6


@pytest.fixture(scope="module")
def kinematics() -> Kinematics:
    return Kinematics(COMAN)


def random_state(seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    joints = [rng.uniform(joint.lower, joint.upper) for joint in COMAN.joints]
    turn = rng.normal(size=4)
    q = np.concatenate([rng.normal(size=3), turn / np.linalg.norm(turn), joints])
    return q, rng.normal(size=6 + len(joints))


@given(seed=st.integers(0, 2**32 - 1))
def test_jacobians_are_the_derivatives_of_positions(kinematics: Kinematics, seed: int) -> None:
    q, v = random_state(seed)
    kinematics.update(q, v)
    links = (*COMAN.end_effectors.values(), "gaze")
    before = {link: kinematics.pose(link).translation.copy() for link in links}
    com, com_velocity = kinematics.centre_of_mass(), kinematics.centre_of_mass_jacobian() @ v
    expected = {link: kinematics.jacobian(link) @ v for link in links}
    measured = {link: kinematics.velocity(link) for link in links}
    kinematics.update(kinematics.integrate(q, v, DT_S))
    for link in links:
        moved = (kinematics.pose(link).translation - before[link]) / DT_S
        assert moved == pytest.approx(expected[link][:3], abs=1e-3)
        assert measured[link] == pytest.approx(expected[link], abs=1e-9)
    assert (kinematics.centre_of_mass() - com) / DT_S == pytest.approx(com_velocity, abs=1e-3)


@given(seed=st.integers(0, 2**32 - 1))
def test_linear_momentum_is_mass_times_velocity(kinematics: Kinematics, seed: int) -> None:
    q, v = random_state(seed)
    kinematics.update(q, v)
    momentum = kinematics.momentum_matrix() @ v
    assert momentum[:3] == pytest.approx(COMAN.mass_kg * kinematics.centre_of_mass_jacobian() @ v, abs=1e-6)


@pytest.mark.parametrize("pose", COMAN.poses)
def test_a_pose_stands_with_its_centre_of_mass_above_the_soles(kinematics: Kinematics, pose: str) -> None:
    kinematics.update(kinematics.standing(pose))
    corners = np.array(
        [
            kinematics.pose(contact.link).act(np.array(corner))
            for contact in COMAN.contacts.values()
            for corner in contact.corners
        ]
    )
    assert corners[:, 2] == pytest.approx(0.0, abs=1e-9)
    com = kinematics.centre_of_mass()
    assert (corners.min(axis=0)[:2] + 0.02 < com[:2]).all()
    assert (com[:2] < corners.max(axis=0)[:2] - 0.02).all()


def test_unknown_links_are_answered(kinematics: Kinematics) -> None:
    with pytest.raises(UsageError, match="third_hand"):
        kinematics.jacobian("third_hand")
