"""A topic of `handover_human_msgs` is read from DDS, and its types are those of the message files."""

import asyncio
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from handover.formats.ros_dds import TopicEndpoints, struct_of
from handover_body.drivers.base import PacketError
from handover_body.drivers.ros_topic import ros4hc
from handover_body.drivers.ros_topic.driver import RosTopicDriver, RosTopicSettings
from handover_body.drivers.ros_topic.messages import INFO, SAMPLES, fields_of, type_of
from handover_body.drivers.runner import RunnerTiming, SensorRunner
from handover_body.formats.ros import messages_of
from handover_body.model.signals import Samples, SensorReport, SignalInfo, SignalKind
from tests.kit.paths import REPOSITORY
from tests.kit.ros_domains import ros_domain
from tests.kit.waiting import until

MESSAGES = REPOSITORY / "ros_fiware_bridge/handover_ros/messages" / "handover_human_msgs" / "msg"
ECG = SignalInfo(SignalKind.ECG, "D82", 130.0, ("I",))


def definition_of(name: str, folder: Path = MESSAGES) -> list[tuple[str, str]]:
    lines = (line.partition("#")[0].split() for line in (folder / f"{name}.msg").read_text().splitlines())
    words = {"string": "str"}
    return [
        (field, words.get(kind.removesuffix("[]"), kind.removesuffix("[]")) + ("[]" if "[]" in kind else ""))
        for kind, field in (line for line in lines if len(line) == 2 and "=" not in line[1])
    ]


def test_the_types_are_those_of_the_message_files() -> None:
    assert definition_of("SignalInfo") == list(INFO)
    assert definition_of("Samples") == list(SAMPLES)
    for kind in SignalKind:
        name, fields = fields_of(kind)
        head = [("header", "std_msgs/Header"), ("info", "handover_human_msgs/SignalInfo")]
        found = [(field, of.replace("/msg/", "/")) for field, of in fields]
        assert definition_of(name) == [*head, *found], name


def as_dds(made: Any, message: dict[str, Any]) -> Any:
    """Return a message as an instance of a DDS type."""
    kinds = made.__annotations__
    return made(
        **{
            name: as_dds(kinds[name], value)
            if isinstance(value, dict)
            else (value.tolist() if isinstance(value, np.ndarray) else value)
            for name, value in message.items()
        }
    )


async def test_a_topic_is_read_over_dds() -> None:
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.topic import Topic

    domain = ros_domain()
    settings = RosTopicSettings(
        topic="/ecg", kind=SignalKind.ECG, unit="D82", rate_hz=130.0, channels=("I",), domain=domain
    )
    items: list[Samples | SensorReport] = []
    runner = SensorRunner(
        RosTopicDriver("strap", settings), items.append, timing=RunnerTiming(0.01, 0.02, 0.01)
    )
    task = asyncio.create_task(runner.run())
    try:
        qos = Qos(Policy.DataRepresentation(use_cdrv0_representation=True))
        participant = DomainParticipant(domain)
        made = type_of(SignalKind.ECG)
        writer = DataWriter(participant, Topic(participant, "rt/ecg", made), qos=qos)

        def publish() -> int:
            values = np.array([[100.0], [250.0]])
            ((_, message),) = messages_of(Samples("h10", ECG, time.time(), values), "p-1")
            writer.write(as_dds(made, message))
            return sum(isinstance(one, Samples) for one in items)

        await until(publish)
        first = next(one for one in items if isinstance(one, Samples))
        assert first.source == "strap"
        assert set(first.values.ravel()) <= {100.0, 250.0}
        assert first.uncertainty_s > 0
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


def test_a_message_in_another_unit_is_refused_and_other_sensors_are_ignored() -> None:
    ((name, message),) = messages_of(Samples("h10", ECG, 1.0, np.zeros((2, 1))))
    given: dict[str, Any] = {"topic": "/ecg", "kind": "ecg", "rate_hz": 130, "channels": ["I"]}
    volts = RosTopicDriver("strap", RosTopicSettings.model_validate({**given, "unit": "VLT"}))
    with pytest.raises(PacketError, match="the settings say 1 in VLT"):
        volts.read(name, message)
    other = RosTopicDriver("s", RosTopicSettings.model_validate({**given, "unit": "D82", "source": "x"}))
    assert other.read(name, message) is None


@given(values=st.lists(st.floats(), max_size=9), channels=st.lists(st.text(max_size=3), max_size=3))
def test_any_message_is_read_or_refused(values: list[float], channels: list[str]) -> None:
    ((name, message),) = messages_of(Samples("h10", ECG, 1.0, np.zeros((2, 1))))
    message["samples"].update(values=values, channels=channels)
    driver = RosTopicDriver(
        "s", RosTopicSettings(topic="/ecg", kind=SignalKind.ECG, unit="D82", rate_hz=130.0, channels=("I",))
    )
    with suppress(PacketError):
        samples = driver.read(name, message)
        assert samples is not None
        assert len(samples.values) == len(values)


@pytest.mark.parametrize(
    ("kind", "unit", "channels"),
    [
        (SignalKind.PRESSURE_MAP, "C62", ("r1c1", "r1c2", "r2c1")),
        (SignalKind.INTER_BEAT_INTERVAL, "SEC", ("",)),
        (SignalKind.GAIT, "", ("speed_mps", "cadence_per_min")),
        (SignalKind.STEPS, "C62", ("",)),
        (SignalKind.BLINK, "", ("duration_s",)),
        (SignalKind.GAZE, "DD", ("gaze_x", "gaze_y")),
    ],
)
def test_signals_of_every_message_are_read(kind: SignalKind, unit: str, channels: tuple[str, ...]) -> None:
    row = np.arange(1.0, len(channels) + 1)[None, :]
    ((name, message),) = messages_of(
        Samples("mat", SignalInfo(kind, unit, None, channels), 1.0, row, np.array([1.0]))
    )
    driver = RosTopicDriver("s", RosTopicSettings(topic="/t", kind=kind, unit=unit, channels=channels))
    samples = driver.read(name, message)
    assert samples is not None
    assert samples.info.kind is kind
    assert samples.values.tolist() == row.tolist()


def test_another_signal_on_the_same_topic_is_ignored() -> None:
    info = SignalInfo(SignalKind.STEPS, "C62", None)
    ((name, message),) = messages_of(Samples("s", info, 1.0, np.ones((1, 1)), np.array([1.0])))
    driver = RosTopicDriver("s", RosTopicSettings(topic="/t", kind=SignalKind.PRESENCE, unit="C62"))
    assert driver.read(name, message) is None


ROS4HC = REPOSITORY / "ros_fiware_bridge/handover_ros/types" / "definitions" / "ros2_hc_msgs" / "msg"
EYES = sorted(ros4hc.SIGNALS)


def test_the_types_of_ros4hc_are_those_of_the_bridge() -> None:
    for kind in EYES:
        name, fields = ros4hc.FIELDS[kind]
        assert definition_of(name, ROS4HC) == [("header", "std_msgs/Header"), *fields], name


def reading(kind: SignalKind, rate_hz: float | None = None) -> RosTopicDriver:
    given = {"topic": "/eye", "kind": kind, "messages": "ros2_hc_msgs", "rate_hz": rate_hz}
    return RosTopicDriver("glasses", RosTopicSettings.model_validate(given))


def test_events_of_ros4hc_are_read_with_their_end() -> None:
    header = {"stamp": {"sec": 100, "nanosec": 0}, "frame_id": "pupil_glasses"}
    blink = {
        "header": header,
        "duration": 0.25,
        "start_time_ns": 99_500_000_000,
        "end_time_ns": 99_750_000_000,
    }
    samples = reading(SignalKind.BLINK).read("", blink)
    assert samples is not None
    assert (samples.values.tolist(), samples.sample_times_s().tolist()) == ([[0.25]], [99.75])
    unstamped = reading(SignalKind.BLINK).read("", {**blink, "end_time_ns": 0})
    assert unstamped is not None
    assert unstamped.start_s == 100.0
    gaze = dict.fromkeys((name for name, _ in ros4hc.FIELDS[SignalKind.GAZE][1]), 3.5)
    for is_worn in (True, False):
        pupils = reading(SignalKind.EYE_STATE, 200.0).read("", {"header": header, **gaze, "worn": is_worn})
        assert pupils is not None
        assert (pupils.has_contact, pupils.quality, pupils.values.tolist()) == (is_worn, is_worn, [[3.5] * 4])


@given(
    st.sampled_from(EYES),
    st.dictionaries(
        st.sampled_from(["duration", "end_time_ns", "start_time_ns", "worn", "gaze_x", "header"]),
        st.floats() | st.integers() | st.none() | st.text(max_size=3),
    ),
)
def test_a_hostile_message_of_ros4hc_is_read_or_refused(kind: SignalKind, change: dict[str, Any]) -> None:
    message = dict.fromkeys((name for name, _ in ros4hc.FIELDS[kind][1]), 1)
    message = {"header": {"stamp": {"sec": 1, "nanosec": 0}}, **message, **change}
    with suppress(PacketError):
        samples = reading(kind).read("", message)
        assert samples is not None
        assert samples.values.shape == (1, len(samples.info.channels))


@pytest.mark.parametrize(
    "given",
    [
        {"kind": "ecg", "messages": "ros2_hc_msgs"},
        {"kind": "blink", "messages": "ros2_hc_msgs", "unit": "DD"},
        {"kind": "ecg"},
        {"messages": "ros2_hc_msgs"},
    ],
)
def test_settings_of_topics_that_cannot_be_are_refused(given: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        RosTopicSettings.model_validate({"topic": "/eye", **given})


async def test_a_search_finds_the_topics_that_it_can_read() -> None:
    domain = ros_domain()
    endpoints = TopicEndpoints(domain)
    blink = ros4hc.type_of(SignalKind.BLINK)
    header = struct_of("std_msgs/msg/String", (("data", "str"),))
    writers = [
        endpoints.writer(name, made, max_blocking_ns=0)
        for name, made in (("/ecg", type_of(SignalKind.ECG)), ("/eye/blink", blink), ("/words", header))
    ]
    expected = {("/ecg", "handover_human_msgs/msg/Ecg"), ("/eye/blink", "ros2_hc_msgs/msg/Blink")}

    async def is_found() -> bool:
        found = await RosTopicDriver.discover(0.2, domain)
        return {(one.address, one.name) for one in found} == expected

    await until(is_found)
    assert len(writers) == 3
