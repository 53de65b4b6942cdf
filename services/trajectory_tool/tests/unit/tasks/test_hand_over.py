"""Operations beyond pick and place: hand-over, named positions, waypoints, tilt, approach and retreat."""

import asyncio
import math
from typing import Any

import httpx
import numpy as np
import pytest

from handover.performer import TaskFailed
from handover.security.access_tokens import SigningKey, key_set
from handover.security.caller import Caller, CallerKind
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.permissions import Grant, Role
from handover_robots.app import make_app
from handover_robots.model.poses import turn
from handover_robots.planning import is_available
from handover_robots.tasks import parameters
from handover_robots.tasks.operations import OPERATIONS
from handover_robots.tasks.work import Work
from tests.kit.waiting import until

needs_planning = pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")

AT = {"pose": {"position": [-0.6, 0.0, 0.4]}}


class Cancelled(Exception):
    """The Task is cancelled."""


class CancelsWhileWaiting:
    def __init__(self, worker: Any) -> None:
        self._worker = worker

    def may_go(self) -> bool:
        return not self._worker.work.awaits_confirmation

    async def rest(self) -> None:
        raise Cancelled


async def test_a_part_is_given_after_the_person_confirms(worker: Any) -> None:
    await worker.do("pick", bin="bin-1")
    giving = asyncio.create_task(worker.do("handOver", direction="give", **AT))
    await until(lambda: worker.work.operation == "handOver" and worker.work.awaits_confirmation)
    assert worker.unit.held == "part-1"
    assert worker.unit.robot.gripper_closed
    assert worker.work.confirm()
    assert await giving == {"part": "part-1", "direction": "give", "handedOver": True}
    assert worker.unit.held is None
    assert not worker.unit.robot.gripper_closed
    assert worker.unit.contents.find("part-1") is None
    assert not worker.work.confirm()


async def test_a_part_is_taken_from_a_person_and_placed(worker: Any) -> None:
    taking = asyncio.create_task(worker.do("handOver", direction="take", part="housing", **AT))
    await until(lambda: worker.work is not None and worker.work.awaits_confirmation)
    worker.work.confirm()
    assert (await taking)["part"] == "housing"
    assert worker.unit.held == "housing"
    assert (await worker.do("place", location="fixture-1"))["part"] == "housing"


async def test_an_operator_of_the_task_may_confirm_and_moves_no_robot(settings: Any, worker: Any) -> None:
    key, anna = SigningKey.generate(), "urn:ngsi-ld:Person:demo:anna"
    settings.security_folder.mkdir()
    (settings.security_folder / PUBLIC_KEYS_FILE).write_bytes(key_set(key))
    app = make_app(settings)
    app.state.guard._followed.apply({"position": 0, "revoked": []})

    async def asked(path: str, *grants: Grant) -> int:
        caller = Caller(CallerKind.USER, "anna", "Anna", grants)
        headers = {"Authorization": f"Bearer {key.issue(caller, valid_s=600)}"}
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost") as http:
            return (await http.post(f"/robots/ur10-1{path}", headers=headers)).status_code

    controller = app.state.controllers.of("ur10-1")
    operator = Grant(Role.OPERATOR, anna)
    assert await asked("/confirm", operator) == 403, "the robot has no Task with Anna"
    steering = CancelsWhileWaiting(worker)
    controller.work = work = Work("task", "handOver", worker.unit, steering, 1.0, involves=(anna,))
    work.awaits_confirmation = True
    assert await asked("/confirm", Grant(Role.OPERATOR, "urn:ngsi-ld:Person:demo:ben")) == 403
    assert await asked("/confirm", Grant(Role.VIEWER)) == 403
    assert await asked("/confirm", operator) == 200
    assert await asked("/gripper/free", operator) == 403
    assert await asked("/gripper/free", Grant(Role.OPERATOR)) == 403


async def test_nobody_confirms_and_the_gripper_stays_as_it_is(worker: Any) -> None:
    await worker.do("pick", bin="bin-1")
    with pytest.raises(TaskFailed, match=r"nobody confirmed the hand-over within 0\.1 s"):
        await worker.do("handOver", direction="give", timeoutS=0.1, **AT)
    assert worker.unit.held == "part-1"
    assert worker.unit.robot.gripper_closed


async def test_a_cancelled_hand_over_moves_nothing_and_keeps_the_part(worker: Any) -> None:
    await worker.do("pick", bin="bin-1")
    with pytest.raises(Cancelled):
        await worker.do("handOver", direction="give", steering=CancelsWhileWaiting(worker), **AT)
    joints = worker.unit.joints
    assert worker.unit.held == "part-1"
    assert worker.unit.joints == joints


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        ({"direction": "give", **AT}, "the gripper is empty; pick a part"),
        ({"direction": "take", "confirmation": "contact", **AT}, "no force sensor"),
        ({"direction": "throw", **AT}, "'give' or 'take'"),
        ({"direction": "take"}, 'needs either "joints"'),
        ({"direction": "take", "named": "lunch"}, r'UR10 has no position "lunch"; it has home'),
    ],
)
async def test_a_hand_over_that_cannot_be_done_is_refused_before_a_motion(
    worker: Any, asked: dict[str, Any], why: str
) -> None:
    joints = worker.unit.joints
    with pytest.raises(TaskFailed, match=why):
        await worker.do("handOver", **asked)
    assert worker.unit.joints == joints


async def test_a_robot_moves_to_a_named_position(worker: Any) -> None:
    await worker.do("moveTo", joints=[0.3, -1.2, 1.4, -1.5, -1.5, 0.2])
    await worker.do("moveTo", named="home")
    assert worker.unit.joints == pytest.approx(worker.unit.home)


WAYPOINTS = [[0.4, -1.4, 1.5, -1.5, -1.5, 0.0], [0.8, -1.2, 1.2, -1.4, -1.5, 0.3]]
END = [1.2, -1.5, 1.4, -1.5, -1.3, 0.0]


@needs_planning
async def test_waypoints_are_passed_without_a_stop(worker: Any, time: Any) -> None:
    path: list[Any] = []
    time.on_wait = lambda _: path.append(worker.unit.robot.state())
    through = [{"joints": joints} for joints in WAYPOINTS]
    await worker.do("moveTo", joints=END, through=through)
    assert worker.unit.joints == pytest.approx(END)
    positions = np.array([state.positions for state in path])
    for waypoint in WAYPOINTS:
        assert float(np.abs(positions - waypoint).max(axis=1).min()) < 0.1
    speeds = np.abs([state.velocities for state in path]).max(axis=1)
    edge = len(speeds) // 5
    assert speeds[edge:-edge].min() > 0.05


@needs_planning
async def test_after_a_pause_only_the_rest_of_the_waypoints_is_passed(worker: Any, time: Any) -> None:
    path: list[Any] = []

    class PausesAfterTheFirst:
        rested = False

        def may_go(self) -> bool:
            return self.rested or worker.unit.joints[0] < 0.6

        async def rest(self) -> None:
            self.rested = True
            path.clear()

    time.on_wait = lambda _: path.append(worker.unit.joints)
    through = [{"joints": joints} for joints in WAYPOINTS]
    await worker.do("moveTo", joints=END, through=through, steering=PausesAfterTheFirst())
    pans = [joints[0] for joints in path]
    assert min(pans) > 0.55
    assert pans == sorted(pans)
    assert worker.unit.joints == pytest.approx(END)


@needs_planning
async def test_a_tilt_is_kept_on_the_whole_way(worker: Any, time: Any) -> None:
    await worker.do("moveTo", pose={"position": [-0.6, -0.4, 0.4]})
    path: list[Any] = []
    time.on_wait = lambda _: path.append(worker.unit.joints)
    await worker.do("moveTo", pose={"position": [-0.6, 0.4, 0.5]}, tilt={"maxAngleDeg": 15})
    assert path
    for joints in path[::5]:
        down = turn(worker.unit.model.tool_pose(joints).frame().rotation, (0.0, 0.0, 1.0))
        assert math.degrees(math.acos(min(-down[2], 1.0))) < 16


async def test_the_tool_approaches_and_leaves_as_far_as_the_task_says(worker: Any, time: Any) -> None:
    heights: list[float] = []
    time.on_wait = lambda _: heights.append(worker.unit.tool_pose.position[2])
    await worker.do("pick", bin="bin-1", approachM=0.3, retreatM=0.05)
    part_m = worker.unit.last_act.pose.position[2]
    assert worker.unit.tool_pose.position[2] == pytest.approx(part_m + 0.05, abs=1e-3)
    assert max(heights) >= part_m + 0.29


async def test_the_tool_approaches_along_its_own_axis(worker: Any) -> None:
    half = math.sqrt(0.5)
    level = {"position": [-0.7, 0.1, 0.5], "orientation": [0.0, -half, 0.0, half]}
    await worker.do("pick", bin="bin-1")
    await worker.do("place", pose=level, approachAlong="tool", retreatM=0.1)
    away = np.array(worker.unit.tool_pose.position) - (-0.7, 0.1, 0.5)
    assert np.linalg.norm(away) == pytest.approx(0.1, abs=1e-3)
    assert abs(away[2]) < 0.01


def test_every_operation_has_a_schema_of_its_parameters() -> None:
    for name, operation in OPERATIONS.items():
        schema = operation.parameters.model_json_schema(by_alias=True)
        assert "speed" in schema["properties"], name
        assert operation.perform.__doc__
    assert issubclass(OPERATIONS["handOver"].parameters, parameters.HandOver)
