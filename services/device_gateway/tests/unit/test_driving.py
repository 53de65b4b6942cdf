"""Velocities of a person to a registered robot: limits, dead-man control, and the stop."""

import time
from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover.control.dead_man import TIMEOUT_S
from handover_datamodels.streams import HumanInput
from handover_devices.driving import MAX_BASE, DriveSession, NotDrivable, require_drivable
from handover_devices.model.description import DeviceDescription, DeviceKind
from handover_devices.registry.device import Device, LatestValue
from handover_devices.registry.templates import templates
from handover_devices.storage.device_store import StoredDevice


class Wire:
    """Keeps what was sent; `is_full` while the device reads nothing."""

    boot = "b1"

    def __init__(self) -> None:
        self.sent: list[Mapping[str, Any]] = []
        self.is_full = False

    def send(self, message: Mapping[str, Any]) -> None:
        self.sent.append(message)

    def send_latest(self, message: Mapping[str, Any]) -> bool:
        if not self.is_full:
            self.sent.append(message)
        return not self.is_full

    def end(self, code: str, reason: str, *, retry: bool) -> None:
        raise NotImplementedError


class Robot:
    """A registered robot over a wire, with a clock of its own."""

    def __init__(self, description: DeviceDescription) -> None:
        self.wire = Wire()
        self.device = Device(StoredDevice("robot-1", description, None, 0, 0))
        self.device.link, self.device.drives = self.wire, True
        self.now_s = 100.0
        for name in self.device.values:
            self.device.latest[name] = LatestValue(time.time() + 3600, 0.0)  # fresh during the test
        self.session = DriveSession(self.device, now=lambda: self.now_s)
        self._seq = 0

    def give(self, *, held: bool, **members: Any) -> None:
        self._seq += 1
        self.session.receive(HumanInput(seq=self._seq, held=held, **members))

    def step(self, seconds: float) -> None:
        self.now_s += seconds
        self.session.step()


def nao() -> Robot:
    return Robot(templates()["nao"])


def mycobot() -> Robot:
    return Robot(templates()["mycobot280"])


def test_a_walking_robot_walks_within_its_limit_while_the_control_is_held_and_gets_one_stop() -> None:
    robot = nao()
    robot.give(held=True, linear=(5.0, 0.0, 1.0))
    assert not robot.wire.sent, "the control has to be released first"
    robot.give(held=False)
    robot.give(held=True, linear=(5.0, 0.0, 1.0), angular=(0.0, 0.0, -5.0))
    fastest, turning = MAX_BASE[DeviceKind.HUMANOID]
    assert robot.wire.sent[-1]["base"] == [fastest, 0.0, -turning]
    robot.step(0.02)
    robot.give(held=False, linear=(5.0, 0.0, 0.0))
    assert robot.wire.sent[-1]["held"] is False
    count = len(robot.wire.sent)
    robot.step(0.02)
    robot.give(held=False)
    assert len(robot.wire.sent) == count
    stop = robot.session.view()["stop"]
    assert stop == {"beginMs": 0.0, "restMs": None}
    robot.now_s += 0.25
    robot.device.event = ("rest", {"seq": robot.wire.sent[-1]["seq"]}, time.time())
    robot.session.step()
    assert robot.session.view()["stop"]["restMs"] == pytest.approx(270, abs=0.2)


def test_silence_stops_the_robot_and_a_robot_that_reads_nothing_gets_nothing_old() -> None:
    robot = nao()
    robot.give(held=False)
    robot.give(held=True, linear=(0.05, 0.0, 0.0))
    robot.wire.is_full = True
    count = len(robot.wire.sent)
    robot.step(0.05)
    assert len(robot.wire.sent) == count, "a velocity never waits"
    robot.step(TIMEOUT_S)
    assert robot.wire.sent[-1]["held"] is False
    robot.wire.is_full = False
    robot.step(0.02)
    robot.give(held=True, linear=(0.05, 0.0, 0.0))
    assert robot.wire.sent[-1]["held"] is False, "after a loss the control has to be released"


def test_a_joint_stops_before_its_limit_and_moves_away_from_it() -> None:
    robot = mycobot()
    robot.give(held=False)
    robot.give(held=True, joints=(9.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert robot.wire.sent[-1]["joints"] == {"joint1": pytest.approx(0.3 * 2.7925)}
    robot.device.latest["joint1"] = LatestValue(time.time() + 3600, 2.9)
    robot.give(held=True, joints=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert robot.wire.sent[-1]["held"] is False
    assert robot.session.view()["limit"] == "joint1 is at its limit"
    robot.give(held=True, joints=(-0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert robot.wire.sent[-1]["joints"] == {"joint1": -0.5}
    del robot.device.latest["joint1"]
    robot.give(held=True, joints=(-0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert robot.wire.sent[-1]["held"] is False
    assert "the position of joint1 is not known" in robot.session.view()["limit"]
    with pytest.raises(NotDrivable, match="joints has 2 values, and robot-1 has 6"):
        robot.give(held=True, joints=(0.0, 0.0))


def test_what_cannot_be_driven_says_why() -> None:
    sensor = Robot(DeviceDescription(kind=DeviceKind.SENSOR)).device
    with pytest.raises(NotDrivable, match="neither joints nor a base"):
        require_drivable(sensor)
    device = nao().device
    require_drivable(device)
    device.drives = False
    with pytest.raises(NotDrivable, match="follows no velocities"):
        require_drivable(device)
    device.link = None
    with pytest.raises(NotDrivable, match="not connected"):
        require_drivable(device)


ACTS = st.lists(
    st.tuples(
        st.sampled_from(("hold", "release", "silence")),
        st.floats(0.001, 0.3),
        st.tuples(*[st.floats(-10, 10)] * 3),
    ),
    max_size=40,
)


@given(ACTS)
@settings(max_examples=80, deadline=None)
def test_no_velocity_is_sent_without_a_control_that_is_held_and_none_beyond_a_limit(acts: Any) -> None:
    robot = nao()
    fastest, turning = MAX_BASE[DeviceKind.HUMANOID]
    held_s, was_released = -1.0, False
    for act, wait_s, velocity in acts:
        robot.now_s += wait_s
        if robot.now_s - held_s > TIMEOUT_S:
            was_released = False
        before = len(robot.wire.sent)
        if act == "silence":
            robot.session.step()
        else:
            held_s, was_released = robot.now_s, was_released or act == "release"
            robot.give(held=act == "hold", linear=velocity, angular=velocity)
        sent = robot.wire.sent[before:]
        for message in sent:
            if message["held"]:
                assert act != "release"
                assert was_released
                assert robot.now_s - held_s <= TIMEOUT_S
                x, y, rz = message["base"]
                assert max(abs(x), abs(y)) <= fastest
                assert abs(rz) <= turning
        if act == "release" and before and robot.wire.sent[before - 1]["held"]:
            assert sent[-1]["held"] is False
