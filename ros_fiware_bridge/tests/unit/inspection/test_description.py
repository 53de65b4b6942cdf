"""Descriptions of mappings."""

from pathlib import Path

from handover_ros.inspection import description
from handover_ros.mapping import load
from handover_ros.rules import plan
from handover_ros.types.type_store import TypeStore

TYPES = TypeStore()


def described(name: str) -> list[str]:
    return list(description.lines(plan.make(load(Path(name)), TYPES, "demo")))


def test_a_rule_is_described_with_its_type_entity_and_rate() -> None:
    assert described("joint-states")[0] == (
        "joint-states: /joint_states (sensor_msgs/msg/JointState; best_effort, volatile, keep_last 5) -> "
        "urn:ngsi-ld:Device:demo:arm-1, every 100 ms at most, on change, every 30 s at least"
    )
    assert "    jointPositions (Property) = position [C81]" in described("joint-states")


def test_attributes_that_are_mapped_in_both_directions_are_listed() -> None:
    assert described("m2o2p")[-1].startswith("both ways: commandId, status")
    assert "    data = {commandId}" in described("m2o2p")


def test_rules_for_tasks_are_described() -> None:
    assert (
        "move-to: a Task moveTo of urn:ngsi-ld:Device:demo:arm-1 sends a goal to "
        "/joint_trajectory_controller/follow_joint_trajectory (control_msgs/action/FollowJointTrajectory)"
    ) in described("joint-trajectory")
