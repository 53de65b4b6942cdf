"""Types that the installed ROS was not built with, on Fast DDS: made from definitions, against built ones."""

import sys
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest

from handover_ros.graph.joining import Adapter, JoinSettings, installed, join
from handover_ros.graph.port import GoalEnded, GoalStatus, RosGraph, ServedGoal
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.integration.graph.conftest import repeated, running_peer, true
from tests.kit.skipping import NO_ROS
from tests.kit.waiting import scaled

pytestmark = [
    pytest.mark.skipif(Adapter.RCLPY not in installed(), reason=NO_ROS),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

SETTINGS = {"interfaces": ("127.0.0.1",)}
POSE = {
    "header": {"frame_id": "map"},
    "pose": {"position": {"x": 2.0, "y": 1.5}, "orientation": {"z": 1.0, "w": 0.0}},
}
ACTIONS: dict[str, dict[str, Any]] = {
    "control_msgs/action/FollowJointTrajectory": {
        "goal": {"trajectory": {"joint_names": ["a", "b"], "points": [{"positions": [0.5, 1.0]}]}},
        "feedback": {"joint_names": ["a", "b"]},
        "result": {"error_code": -4, "error_string": "path tolerance of a"},
    },
    "control_msgs/action/GripperCommand": {
        "goal": {"command": {"position": 0.02, "max_effort": 40.0}},
        "feedback": {"position": 0.05},
        "result": {"position": 0.021, "stalled": True},
    },
    "nav2_msgs/action/NavigateToPose": {
        "goal": {"pose": POSE, "behavior_tree": "tree.xml"},
        "feedback": {"distance_remaining": 0.5, "number_of_recoveries": 2},
        "result": {"error_code": 103},
    },
    "moveit_msgs/action/ExecuteTrajectory": {
        "goal": {"trajectory": {"joint_trajectory": {"joint_names": ["a"]}}},
        "feedback": {"state": "MONITOR"},
        "result": {"error_code": {"val": -4}},
    },
}


@pytest.fixture
def without_built_types(monkeypatch: pytest.MonkeyPatch) -> None:
    """The Python modules of two packages cannot be imported, as in an installation without them."""
    for module in ("test_msgs", "rcl_interfaces"):
        for name in (module, f"{module}.action", f"{module}.srv"):
            monkeypatch.setitem(sys.modules, name, None)


@pytest.fixture
async def server(domain_id: int) -> AsyncIterator[RosGraph]:
    opened = await join(
        TypeStore(), JoinSettings(node="robot", domain_id=domain_id, **SETTINGS), Adapter.RCLPY
    )
    yield opened
    await opened.close()


@pytest.fixture(scope="module")
def built(domain_id: int) -> Iterator[None]:
    with running_peer(Adapter.RCLPY, domain_id):
        yield


@pytest.mark.usefixtures("built")
async def test_a_type_from_its_definition_reaches_a_node_that_has_it_built(
    store: TypeStore, domain_id: int, request: pytest.FixtureRequest
) -> None:
    settings = JoinSettings(node="tested", domain_id=domain_id, **SETTINGS)
    graph = await join(store, settings, Adapter.RCLPY)
    request.getfixturevalue("without_built_types")
    try:
        assert await repeated(graph, "ab", 2, scaled(60)) == ["ab", "ab"]
        action = await graph.action_client("/fibonacci", "test_msgs/action/Fibonacci")
        feedback: list[Any] = []
        goal = await action.send_goal({"order": 6}, on_feedback=feedback.append, timeout_s=scaled(60))
        ended = await goal.result(scaled(60))
        assert (ended.status, ended.result["sequence"].tolist()) == (GoalStatus.SUCCEEDED, [0, 1, 1, 2, 3, 5])
        await true(lambda: feedback)
        assert feedback[0]["sequence"].tolist()[:3] == [0, 1, 1]
        aborted = await (await action.send_goal({"order": 40}, timeout_s=scaled(60))).result(scaled(60))
        assert (aborted.status, aborted.result["sequence"].tolist()) == (GoalStatus.ABORTED, [0, 1, 1, 2, 3])
    finally:
        await graph.close()


@pytest.mark.parametrize("type_name", ACTIONS)
async def test_a_shipped_action_works_on_fast_dds(
    server: RosGraph, store: TypeStore, domain_id: int, type_name: str
) -> None:
    sent = ACTIONS[type_name]
    received: list[Any] = []

    async def act(goal: ServedGoal) -> dict[str, Any]:
        received.append(goal.request)
        goal.feedback(sent["feedback"])
        if len(received) == 2:
            raise GoalEnded(GoalStatus.ABORTED, sent["result"])
        return dict(sent["result"])

    served = await server.serve_action("/act", type_name, act)
    settings = JoinSettings(node="bridge", domain_id=domain_id, **SETTINGS)
    bridge = await join(store, settings)  # as the bridge does: rclpy is found by the middleware of the server
    try:
        client = await bridge.action_client("/act", type_name)
        for status in (GoalStatus.SUCCEEDED, GoalStatus.ABORTED):
            feedback: list[Any] = []
            goal = await client.send_goal(sent["goal"], on_feedback=feedback.append, timeout_s=scaled(60))
            ended = await goal.result(scaled(60))
            assert ended.status is status
            assert store.encode(f"{type_name}_Result", ended.result) == store.encode(
                f"{type_name}_Result", sent["result"]
            )
            await true(lambda: feedback)  # noqa: B023 - of this turn
            assert store.encode(f"{type_name}_Feedback", feedback[0]) == store.encode(
                f"{type_name}_Feedback", sent["feedback"]
            )
        assert store.encode(f"{type_name}_Goal", received[0]) == store.encode(
            f"{type_name}_Goal", sent["goal"]
        )
        assert bridge.obstacles("/act/_action/send_goal", f"{type_name}_SendGoal") == []
    finally:
        await bridge.close()
        await served.close()


async def test_a_node_describes_a_type_from_its_definition(server: RosGraph) -> None:
    """`get_type_description` of rclpy reads the tables that we made: they are what the hash is of."""

    message = "control_msgs/msg/JointJog"
    publisher = await server.publisher("/jog", message)
    store = TypeStore()
    described = await server.call(
        "/robot/get_type_description",
        "type_description_interfaces/srv/GetTypeDescription",
        {"type_name": message, "type_hash": store.hash(message), "include_type_sources": False},
        scaled(60),
    )
    assert described["successful"], described["failure_reason"]
    expected = store.description(message)
    whole = described["type_description"]
    assert [one["name"] for one in whole["type_description"]["fields"]] == [
        one["name"] for one in expected["type_description"]["fields"]
    ]
    assert [one["type_name"] for one in whole["referenced_type_descriptions"]] == [
        one["type_name"] for one in expected["referenced_type_descriptions"]
    ]
    await publisher.close()
