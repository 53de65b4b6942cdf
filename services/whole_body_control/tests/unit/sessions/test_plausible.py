"""Poses and forces of people that cannot be, and what then counts."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_humanoid.running.inputs import (
    HandPose,
    HandPoses,
    PersonInputs,
    PoseMessage,
    PullMessage,
)
from handover_humanoid.sessions.plausible import (
    MAX_AWAY_M,
    MAX_FORCE_N,
    MAX_HAND_MPS,
    RELEASE_S,
    SETTLE_S,
    Plausibility,
)

NAMES = ("left.held", "right.held", "left.force_x_n", "right.x_m")
ROBOT = (0.0, 0.0)
NOW_S = 100.0
WITHIN = st.floats(-2.0, 2.0)


@pytest.fixture(autouse=True)
def _clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no time pass, however slow the machine is."""
    monkeypatch.setattr("handover_humanoid.running.inputs.time.monotonic", lambda: NOW_S)


def pose(hand: tuple[float, float, float], **more: object) -> PoseMessage:
    """Return the pose of a person whose left hand is closed."""
    hands = HandPoses(left=HandPose(position=hand, grip=1.0))
    return PoseMessage.model_validate({"kind": "pose", "t": 1.0, "hands": hands.model_dump(), **more})


def held(inputs: PersonInputs) -> tuple[float, float]:
    """Return what the control cycle is sent: how the left and the right hand of the robot are held."""
    values = inputs.port_values(NAMES)
    assert values is not None
    return values[0], values[1]


@given(st.lists(st.tuples(WITHIN, WITHIN, WITHIN), min_size=2, max_size=30), st.floats(0.005, 0.05))
def test_only_what_a_hand_cannot_do_is_a_jump(
    places: list[tuple[float, float, float]], period_s: float
) -> None:
    seen = Plausibility()
    is_jump = False
    for index, place in enumerate(places):
        now_s = index * period_s
        seen.see(now_s, {"left": place}, ROBOT)
        way_m = math.dist(places[max(index - 1, 0)], place)
        is_jump = way_m > 0.3 and way_m > MAX_HAND_MPS * period_s
        if is_jump:
            assert seen.problem(now_s) == "jump"
    last_s = (len(places) - 1) * period_s
    if is_jump:
        assert seen.problem(last_s + 0.9 * SETTLE_S) == "jump"
    assert seen.problem(last_s + 1.1 * SETTLE_S) is None


def test_a_person_who_recentres_does_not_jump() -> None:
    seen = Plausibility()
    seen.see(0.0, {"head": (0.8, 0.0, 1.1)}, ROBOT)
    seen.see(0.01, {"head": (1.8, 0.0, 1.1)}, ROBOT, is_moved=True)
    assert seen.problem(0.01) is None


@pytest.mark.parametrize("place", [(MAX_AWAY_M + 0.1, 0.0, 1.0), (0.0, 0.0, -MAX_AWAY_M - 1)])
def test_a_hand_out_of_the_room_counts_for_nothing(place: tuple[float, float, float]) -> None:
    inputs = PersonInputs()
    inputs.receive(pose((0.5, -0.1, 0.6)))
    assert held(inputs) == (0.0, 1.0)  # the left hand of a person holds the right hand of the robot
    inputs.receive(pose(place))
    assert inputs.problem(NOW_S) == "far"
    assert held(inputs) == (0.0, 0.0)
    assert inputs.hands(NOW_S) == {}
    shown = inputs.shown(NOW_S)
    assert shown is not None
    assert (shown["problem"], shown["hands"]["left"]["position"]) == ("far", place)


def test_a_hand_that_teleports_lets_go() -> None:
    inputs = PersonInputs()
    inputs.receive(pose((0.5, -0.1, 0.6)))
    inputs.receive(pose((1.9, -0.1, 0.6)))
    assert inputs.problem(NOW_S) == "jump"
    assert held(inputs) == (0.0, 0.0)


def test_the_force_of_a_person_who_falls_lets_go_of_the_robot() -> None:
    inputs = PersonInputs()
    inputs.receive(PullMessage(kind="pull", left=(0.9 * MAX_FORCE_N, 0.0, 0.0)))
    assert held(inputs) == (2.0, 0.0)
    inputs.receive(PullMessage(kind="pull", left=(0.0, 0.0, -4 * MAX_FORCE_N)))
    assert inputs.problem(NOW_S) == "force"
    assert held(inputs) == (0.0, 0.0)
    inputs.receive(PullMessage(kind="pull", left=(10.0, 0.0, 0.0)))
    assert held(inputs) == (0.0, 0.0)
    assert inputs.problem(NOW_S + 1.1 * RELEASE_S) is None


def test_a_measured_force_beyond_the_limit_lets_go_as_well() -> None:
    inputs = PersonInputs()
    inputs.receive(pose((0.5, -0.1, 0.6)))
    inputs.values = {"right_hand.force.x": -2 * MAX_FORCE_N, "left_hand.force.x": math.nan}
    inputs.feel()
    assert held(inputs) == (0.0, 0.0)


def test_a_person_is_shown_while_poses_arrive_and_named_by_nothing() -> None:
    inputs = PersonInputs()
    assert inputs.shown(NOW_S) is None
    inputs.receive(pose((0.5, 0.1, 0.6), tracking="lost", inBounds=False))
    shown = inputs.shown(NOW_S)
    assert shown is not None
    assert set(shown) == {"t", "headset", "hands", "tracking", "inBounds", "problem"}
    assert (shown["tracking"], shown["inBounds"], shown["headset"]) == ("lost", False, None)
