"""Each shipped mapping can work, and does what it says with the messages it is for."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handover.errors import HandoverError
from ros_fiware_bridge.mapping import load
from ros_fiware_bridge.mapping.document import SHIPPED
from ros_fiware_bridge.rules import plan
from ros_fiware_bridge.rules.inward import Scope
from ros_fiware_bridge.rules.latest import scope_of
from ros_fiware_bridge.rules.outward import Harvest
from ros_fiware_bridge.types.type_store import TypeStore

TYPES = TypeStore()


def planned(name: str) -> plan.Plan:
    return plan.make(load(Path(name)), TYPES, "demo")


def harvest(mapping: str, rule: str, message: dict[str, Any]) -> Harvest:
    (found,) = (one.outward for one in planned(mapping).outward if one.name == rule)
    assert found is not None
    return found.harvest({**TYPES.default(found.type_name), **message}, 1_770_000_000.0)


def message(mapping: str, rule: str, scope: Scope) -> dict[str, Any]:
    (found,) = (one.inward for one in planned(mapping).inward if one.name == rule)
    made = found.message(scope)
    TYPES.check(found.type_name, made)
    return made


@pytest.mark.parametrize("name", sorted(file.stem for file in SHIPPED.glob("*.yaml")))
def test_a_shipped_mapping_can_work(name: str) -> None:
    assert list(planned(name).names())


def test_there_are_those_that_the_documentation_names() -> None:
    names = {file.stem for file in SHIPPED.glob("*.yaml")}
    assert names >= {"arm", "m2o2p", "joint-states", "joint-trajectory", "battery", "odom", "diagnostics"} | {
        "nav2",
        "moveit",
    }


def test_m2o2ps_fingers_and_commands_reach_the_glove() -> None:
    states = harvest("m2o2p", "finger-states-right", {"data": np.array([0, 2, 2, 2, 2], np.int32)})
    assert states.updates[0].entity_id == "urn:ngsi-ld:Device:demo:glove-1"
    assert states.updates[0].values == {"fingerStates": [0, 2, 2, 2, 2]}
    raw = harvest("m2o2p", "finger-sensor-values-left", {"data": np.array([1012.06, 3.0], np.float32)})
    assert raw.updates[0].entity_id == "urn:ngsi-ld:Device:demo:glove-2"
    assert raw.updates[0].values == {"fingerSensorValues": [1012.1, 3.0]}
    assert harvest("m2o2p", "command-id-from-ros", {"data": "3"}).updates[0].values == {"commandId": 3}


def test_m2o2p_completes_a_task() -> None:
    text = '{"value": "completed", "id": "urn:ngsi-ld:Task:demo:t1"}'
    update = harvest("m2o2p", "task-completion", {"data": text}).updates[0]
    assert (update.entity_id, update.entity_type) == ("urn:ngsi-ld:Task:demo:t1", "Task")
    assert update.attributes["status"]["value"] == "completed"
    assert update.attributes["status"]["observedAt"]
    assert harvest("m2o2p", "task-completion", {"data": text.replace("completed", "x")}).updates == []


def test_commands_and_tasks_reach_m2o2ps_listeners() -> None:
    glove = {"id": "urn:ngsi-ld:Device:demo:glove-1", "commandId": {"type": "Property", "value": 3}}
    assert message("m2o2p", "command-id", scope_of(glove, 0.0)) == {"data": "3"}
    task = {
        "id": "urn:ngsi-ld:Task:demo:t1",
        "status": {"type": "Property", "value": "inProgress", "observedAt": "2026-01-01T00:00:00Z"},
        "workParameters": {"type": "Property", "value": {"description": "Confirm", "commandId": 3}},
    }
    assert message("m2o2p", "task-info", scope_of(task, 0.0)) == {
        "data": '{"taskName":"Confirm","gesture":null,"timeStamp":"2026-01-01T00:00:00Z"}'
    }


def test_a_robot_behind_follow_joint_trajectory_is_moved_by_a_task() -> None:
    (asked,) = planned("joint-trajectory").asks
    goal = asked.request.message(Scope({"joints": [0.0] * 6, "operation": "moveTo"}))
    TYPES.check("control_msgs/action/FollowJointTrajectory_Goal", goal)
    assert goal["trajectory"]["points"][0]["time_from_start"] == {"sec": 5}
    assert goal["trajectory"]["joint_names"][2] == "elbow_joint"
    device = {"id": "urn:ngsi-ld:Device:demo:arm-1", "targetJoints": {"value": [0.1] * 6}}
    trajectory = message("joint-trajectory", "joint-trajectory", scope_of(device, 0.0))
    assert trajectory["points"][0]["positions"] == [0.1] * 6


def test_joints_a_battery_and_a_way_are_kept_on_devices() -> None:
    joints = {"name": ["a", "b"], "position": np.array([0.123456, 1.0]), "velocity": np.zeros(2)}
    update = harvest("joint-states", "joint-states", joints).updates[0]
    assert update.values["jointPositions"] == [0.1235, 1.0]
    battery = harvest("battery", "battery", {"percentage": 0.5, "power_supply_status": 1}).updates[0]
    assert (battery.values["batteryLevel"], battery.values["charging"]) == (0.5, True)
    way = harvest("odom", "odom", {})
    assert way.faults == []
    assert way.updates[0].values["relativePosition"] == [0.0, 0.0, 0.0]
    assert way.updates[0].values["orientation"] == [0.0, 0.0, 0.0, 1.0]


def test_a_warning_is_an_alert_and_the_device_knows() -> None:
    status = TYPES.default("diagnostic_msgs/msg/DiagnosticStatus")
    said = {
        "status": [{**status, "level": 2, "hardware_id": "arm-1", "name": "motor", "message": "hot"}, status]
    }
    (alert,) = harvest("diagnostics", "diagnostics-alerts", said).alerts
    assert (alert.standing, alert.severity, alert.description) == (True, "high", "motor: hot")
    (device,) = harvest("diagnostics", "diagnostics-devices", said).updates
    assert device.entity_id == "urn:ngsi-ld:Device:demo:arm-1"
    assert device.values["deviceState"] == "error"


def goal(mapping: str, rule: str, parameters: dict[str, Any]) -> dict[str, Any]:
    (found,) = (one for one in planned(mapping).asks if one.name == rule)
    made = found.request.message(Scope(parameters))
    TYPES.check(f"{found.rule.type}_Goal", made)
    return TYPES.decode(f"{found.rule.type}_Goal", TYPES.encode(f"{found.rule.type}_Goal", made))


def test_nav2_is_sent_to_a_pose_on_the_map() -> None:
    pose = goal("nav2", "go-to", {"x": 2, "y": 1.5})["pose"]
    assert pose["header"]["frame_id"] == "map"
    assert (pose["pose"]["position"]["x"], pose["pose"]["position"]["y"]) == (2.0, 1.5)
    assert pose["pose"]["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    with pytest.raises(HandoverError):
        goal("nav2", "go-to", {"x": 2})


def test_moveit_executes_the_trajectory_of_a_task() -> None:
    points = [{"positions": [0.1, 0.2], "time_from_start": {"sec": 1}}]
    made = goal("moveit", "execute-trajectory", {"jointNames": ["a", "b"], "points": points})
    trajectory = made["trajectory"]["joint_trajectory"]
    assert list(trajectory["joint_names"]) == ["a", "b"]
    assert trajectory["points"][0]["positions"].tolist() == [0.1, 0.2]
