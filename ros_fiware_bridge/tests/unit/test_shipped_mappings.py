"""The shipped mappings compile, and convert the messages that they are for."""

import math
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis.strategies import floats

from handover.errors import HandoverError
from handover_datamodels import HumanState
from handover_ros.mapping import load
from handover_ros.mapping.document import SHIPPED, parse
from handover_ros.mapping.values import Attribute
from handover_ros.rules import plan
from handover_ros.rules.change_tracker import scope_of
from handover_ros.rules.entity_extractor import Extraction
from handover_ros.rules.message_builder import Scope
from handover_ros.types.type_store import TypeStore

TYPES = TypeStore()


def planned(name: str) -> plan.Plan:
    return plan.make(load(Path(name)), TYPES, "demo")


def extracted(mapping: str, rule: str, message: dict[str, Any]) -> Extraction:
    (found,) = (one.extractor for one in planned(mapping).ros_to_ngsild if one.name == rule)
    assert found is not None
    return found.extract({**TYPES.default(found.type_name), **message}, 1_770_000_000.0)


def message(mapping: str, rule: str, scope: Scope) -> dict[str, Any]:
    (found,) = (one.builder for one in planned(mapping).ngsild_to_ros if one.name == rule)
    made = found.message(scope)
    TYPES.check(found.type_name, made)
    return made


@pytest.mark.parametrize("name", sorted(file.stem for file in SHIPPED.glob("*.yaml")))
def test_a_shipped_mapping_compiles(name: str) -> None:
    assert list(planned(name).names())


def test_the_documented_mappings_are_shipped() -> None:
    names = {file.stem for file in SHIPPED.glob("*.yaml")}
    assert names >= {"arm", "m2o2p", "joint-states", "joint-trajectory", "battery", "odom", "diagnostics"} | {
        "nav2",
        "moveit",
    }


def test_m2o2p_writes_finger_states_and_commands_to_the_glove() -> None:
    states = extracted("m2o2p", "finger-states-right", {"data": np.array([0, 2, 2, 2, 2], np.int32)})
    assert states.entities[0].entity_id == "urn:ngsi-ld:Device:demo:glove-1"
    assert states.entities[0].values == {"fingerStates": [0, 2, 2, 2, 2]}
    raw = extracted("m2o2p", "finger-sensor-values-left", {"data": np.array([1012.06, 3.0], np.float32)})
    assert raw.entities[0].entity_id == "urn:ngsi-ld:Device:demo:glove-2"
    assert raw.entities[0].values == {"fingerSensorValues": [1012.1, 3.0]}
    assert extracted("m2o2p", "command-id-from-ros", {"data": "3"}).entities[0].values == {"commandId": 3}


def test_m2o2p_completes_a_task() -> None:
    text = '{"value": "completed", "id": "urn:ngsi-ld:Task:demo:t1"}'
    update = extracted("m2o2p", "task-completion", {"data": text}).entities[0]
    assert (update.entity_id, update.entity_type) == ("urn:ngsi-ld:Task:demo:t1", "Task")
    assert update.attributes["status"]["value"] == "completed"
    assert update.attributes["status"]["observedAt"]
    assert extracted("m2o2p", "task-completion", {"data": text.replace("completed", "x")}).entities == []


def test_m2o2p_publishes_commands_and_tasks() -> None:
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


def test_a_task_becomes_a_follow_joint_trajectory_goal() -> None:
    (asked,) = planned("joint-trajectory").requests
    assert asked.reads_resource
    robot = {"jointNames": ["base", "shoulder", "elbow"]}
    goal = asked.request.message(Scope({"joints": [0.0] * 3, "operation": "moveTo", "resource": robot}))
    TYPES.check("control_msgs/action/FollowJointTrajectory_Goal", goal)
    assert goal["trajectory"]["points"][0]["time_from_start"] == {"sec": 5}
    assert goal["trajectory"]["joint_names"] == robot["jointNames"]
    with pytest.raises(HandoverError, match="jointNames"):
        asked.request.message(Scope({"joints": [0.0] * 3, "resource": {}}))
    device = {
        "id": "urn:ngsi-ld:Device:demo:arm-1",
        "jointNames": {"value": robot["jointNames"]},
        "targetJoints": {"value": [0.1] * 6},
    }
    trajectory = message("joint-trajectory", "joint-trajectory", scope_of(device, 0.0))
    assert trajectory["joint_names"] == robot["jointNames"]
    assert trajectory["points"][0]["positions"] == [0.1] * 6


def test_joints_battery_and_odometry_are_written_to_devices() -> None:
    joints = {"name": ["a", "b"], "position": np.array([0.123456, 1.0]), "velocity": np.zeros(2)}
    update = extracted("joint-states", "joint-states", joints).entities[0]
    assert update.values["jointPositions"] == [0.1235, 1.0]
    battery = extracted("battery", "battery", {"percentage": 0.5, "power_supply_status": 1}).entities[0]
    assert (battery.values["batteryLevel"], battery.values["charging"]) == (0.5, True)
    way = extracted("odom", "odom", {})
    assert way.errors == []
    assert way.entities[0].values["relativePosition"] == [0.0, 0.0, 0.0]
    assert way.entities[0].values["orientation"] == [0.0, 0.0, 0.0, 1.0]


def test_a_diagnostic_error_raises_an_alert_and_sets_the_device_state() -> None:
    status = TYPES.default("diagnostic_msgs/msg/DiagnosticStatus")
    said = {
        "status": [{**status, "level": 2, "hardware_id": "arm-1", "name": "motor", "message": "hot"}, status]
    }
    (alert,) = extracted("diagnostics", "diagnostics-alerts", said).alerts
    assert (alert.active, alert.severity, alert.description) == (True, "high", "motor: hot")
    (device,) = extracted("diagnostics", "diagnostics-devices", said).entities
    assert device.entity_id == "urn:ngsi-ld:Device:demo:arm-1"
    assert device.values["deviceState"] == "error"


def goal(mapping: str, rule: str, parameters: dict[str, Any]) -> dict[str, Any]:
    (found,) = (one for one in planned(mapping).requests if one.name == rule)
    made = found.request.message(Scope(parameters))
    TYPES.check(f"{found.rule.type}_Goal", made)
    return TYPES.decode(f"{found.rule.type}_Goal", TYPES.encode(f"{found.rule.type}_Goal", made))


def test_a_task_becomes_a_nav2_goal() -> None:
    pose = goal("nav2", "go-to", {"x": 2, "y": 1.5})["pose"]
    assert pose["header"]["frame_id"] == "map"
    assert (pose["pose"]["position"]["x"], pose["pose"]["position"]["y"]) == (2.0, 1.5)
    assert pose["pose"]["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    with pytest.raises(HandoverError):
        goal("nav2", "go-to", {"x": 2})


@given(floats(-20.0, 20.0))
def test_the_yaw_of_a_nav2_goal_is_that_of_the_pose_that_comes_back(yaw: float) -> None:
    orientation = goal("nav2", "go-to", {"x": 2, "y": 1.5, "yaw": yaw})["pose"]["pose"]["orientation"]
    assert (orientation["x"], orientation["y"]) == (0.0, 0.0)
    assert math.hypot(orientation["z"], orientation["w"]) == pytest.approx(1.0)
    reached = {
        "header": {"stamp": {"sec": 1_770_000_000, "nanosec": 0}, "frame_id": "map"},
        "pose": {
            "pose": {"position": {"x": 2.0, "y": 1.5, "z": 0.0}, "orientation": orientation},
            "covariance": np.zeros(36),
        },
    }
    way = extracted("nav2", "map-pose", reached)
    assert way.errors == []
    (device,) = way.entities
    assert device.entity_id == "urn:ngsi-ld:Device:demo:amr-1"
    assert device.values["relativePosition"] == [2.0, 1.5, 0.0]
    assert device.attributes["relativePosition"]["frame"]["value"] == "map"
    turn = device.values["yaw"] - yaw
    assert math.remainder(turn, math.tau) == pytest.approx(0.0, abs=1e-3)


def test_a_nav2_goal_takes_a_quaternion_instead_of_a_yaw() -> None:
    pose = goal("nav2", "go-to", {"x": 2, "y": 1.5, "qz": 0.6, "qw": 0.8, "frame": "hall"})["pose"]
    assert pose["header"]["frame_id"] == "hall"
    assert pose["pose"]["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}


@pytest.mark.parametrize("yaw", ["north", True, math.nan, [1.0]])
def test_a_yaw_that_is_no_angle_is_refused(yaw: object) -> None:
    with pytest.raises(HandoverError, match="is no angle"):
        goal("nav2", "go-to", {"x": 2, "y": 1.5, "yaw": yaw})


def test_a_pose_without_a_rotation_has_no_yaw() -> None:
    pose = TYPES.default("geometry_msgs/msg/PoseWithCovarianceStamped")
    pose["pose"]["pose"]["orientation"] = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}
    way = extracted("nav2", "map-pose", pose)
    assert any("no rotation" in str(error) for error in way.errors)
    assert all("yaw" not in device.values for device in way.entities)


def test_a_task_becomes_a_moveit_goal() -> None:
    points = [{"positions": [0.1, 0.2], "time_from_start": {"sec": 1}}]
    made = goal("moveit", "execute-trajectory", {"jointNames": ["a", "b"], "points": points})
    trajectory = made["trajectory"]["joint_trajectory"]
    assert list(trajectory["joint_names"]) == ["a", "b"]
    assert trajectory["points"][0]["positions"].tolist() == [0.1, 0.2]


def test_values_of_the_body_are_written_with_quality_status_and_sensor() -> None:
    info = {
        **TYPES.default("handover_human_msgs/msg/SignalInfo"),
        "subject": "p-1",
        "source": "strap",
        "method": "ecg",
        "quality": 0.9,
        "validity": 1,
        "calibrated": True,
    }
    made = planned("human-state")
    (rule,) = (one for one in made.ros_to_ngsild if one.name == "heart-rate")
    extractor = rule.for_topic(made, "/human/p_1/heart_rate", {"person": "p_1"}).extractor
    assert extractor is not None
    message = {**TYPES.default(extractor.type_name), "info": info, "rate_bpm": 92.46}
    state = extractor.extract(message, 1_770_000_000.0)
    assert state.errors == []
    (entity,) = state.entities
    assert entity.entity_id == "urn:ngsi-ld:HumanState:demo:p-1"
    read = HumanState.from_ngsild({"id": entity.entity_id, "type": entity.entity_type, **entity.attributes})
    assert read.heart_rate is not None
    assert (read.heart_rate.value, read.heart_rate.unit_code) == (92.5, "BPM")
    assert read.heart_rate.to_normalized() == entity.attributes["heartRate"]
    assert entity.values["heartRate.status"] == "valid"
    assert entity.attributes["heartRate"]["observedBy"]["object"] == "urn:ngsi-ld:Device:demo:strap"


def test_the_messages_of_ros4hc_are_written_without_a_status() -> None:
    rate = extracted("ros4hc", "ros4hc-heart-rate", {"hr": 92, "hr_quality": 3})
    (entity,) = rate.entities
    assert entity.attributes["heartRate"]["value"] == 92
    assert "status" not in entity.attributes["heartRate"]
    assert extracted("ros4hc", "ros4hc-heart-rate", {"hr": 0}).entities == []
    mat = extracted(
        "ros4hc", "ros4hc-pressure-mat", {"rows": 3, "cols": 4, "pressures": np.ones(12, np.float32)}
    )
    assert mat.entities[0].values["pressures"] == [1.0] * 12
    assert extracted("ros4hc", "ros4hc-activity", {"adl": 4}).entities[0].values["activity"] == "4"


def test_events_of_the_eyes_in_ros4hc_are_written_with_units() -> None:
    blink = extracted("ros4hc", "ros4hc-blink", {"duration": 0.1834}).entities[0]
    assert (blink.values["blinkDuration"], blink.attributes["blinkDuration"]["unitCode"]) == (183, "C26")
    assert "status" not in blink.attributes["blinkDuration"]
    movement = {"duration": 0.2501, "amplitude_angle_deg": 4.26}
    fixation = extracted("ros4hc", "ros4hc-fixation", movement).entities[0]
    assert fixation.values["fixationDuration"] == 250
    saccade = extracted("ros4hc", "ros4hc-saccade", movement).entities[0]
    assert (saccade.values["saccadeAmplitude"], saccade.attributes["saccadeAmplitude"]["unitCode"]) == (
        4.3,
        "DD",
    )
    assert extracted("ros4hc", "ros4hc-blink", {"duration": 0.0}).entities == []
    pupils = extracted("ros4hc", "ros4hc-pupils", {"pupil_diameter_right": 3.456, "worn": True}).entities[0]
    assert (pupils.values["pupilDiameter"], pupils.values["wearState"]) == (3.46, "worn")
    read = HumanState.from_ngsild({"id": pupils.entity_id, "type": pupils.entity_type, **pupils.attributes})
    assert read.pupil_diameter is not None
    assert (read.pupil_diameter.value, read.pupil_diameter.unit_code) == (3.46, "MMT")


def test_what_the_eyes_do_is_written_with_quality_and_status() -> None:
    info = {**TYPES.default("handover_human_msgs/msg/SignalInfo"), "subject": "p-1", "source": "glasses"}
    made = planned("human-state")
    (rule,) = (one for one in made.ros_to_ngsild if one.name == "eye-activity")
    extractor = rule.for_topic(made, "/human/p_1/eye_activity", {"person": "p_1"}).extractor
    assert extractor is not None
    values = dict.fromkeys(
        ("blink_duration_ms", "fixation_duration_ms", "saccade_amplitude_deg", "pupil_diameter_mm"), np.nan
    )
    message = {
        **TYPES.default(extractor.type_name), **values, "blink_rate_per_min": 16.24, "saccade_rate_hz": 3.123,
        "info": {**info, "quality": 0.9, "validity": 1},
    }  # fmt: skip
    (entity,) = extractor.extract(message, 1_770_000_000.0).entities
    assert (entity.values["blinkRate"], entity.values["saccadeRate"]) == (16.2, 3.12)
    assert entity.values["blinkRate.status"] == "valid"
    assert "pupilDiameter" not in entity.values, "it was not measured"


def test_sub_attributes_are_of_topics_and_have_none_themselves() -> None:
    deep = {"field": "a", "sub_attributes": {"b": {"field": "b", "sub_attributes": {"c": "c"}}}}
    with pytest.raises(ValueError, match="no sub-attributes"):
        Attribute.model_validate(deep)
    text = """
        services:
          reset:
            service: /reset
            type: std_srvs/srv/Trigger
            task: reset
            resource: Device:arm-1
            outputs: {words: {field: message, sub_attributes: {ok: success}}}
        """
    with pytest.raises(HandoverError, match="sub_attributes"):
        plan.make(parse(textwrap.dedent(text)), TYPES, "demo")
