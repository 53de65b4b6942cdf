"""What a mapping would do is told in sentences."""

from pathlib import Path

from ros_fiware_bridge import explaining
from ros_fiware_bridge.mapping import load
from ros_fiware_bridge.rules import plan
from ros_fiware_bridge.types.type_store import TypeStore

TYPES = TypeStore()


def told(name: str) -> list[str]:
    return list(explaining.lines(plan.make(load(Path(name)), TYPES, "demo")))


def test_a_rule_is_told_with_its_type_its_entity_and_its_pace() -> None:
    assert told("joint-states")[0] == (
        "joint-states: /joint_states (sensor_msgs/msg/JointState; best_effort, volatile, keep_last 5) -> "
        "urn:ngsi-ld:Device:demo:arm-1, every 100 ms at most, on change, every 30 s at least"
    )
    assert "    jointPositions (Property) = position [C81]" in told("joint-states")


def test_what_goes_both_ways_is_pointed_out() -> None:
    assert told("m2o2p")[-1].startswith("both ways: commandId, status")
    assert "    data = {commandId}" in told("m2o2p")


def test_tasks_are_told() -> None:
    assert told("joint-trajectory")[-1] == (
        "move-to: a Task moveTo of urn:ngsi-ld:Device:demo:arm-1 sends a goal to "
        "/joint_trajectory_controller/follow_joint_trajectory (control_msgs/action/FollowJointTrajectory)"
    )
