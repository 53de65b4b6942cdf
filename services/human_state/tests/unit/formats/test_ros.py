"""Samples and features come back from the bytes of ROS 2 messages."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rosbags", reason="the extra [ros] is not installed")

from handover_body.formats import ros
from handover_body.formats.errors import ExchangeError
from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import Samples, SensorFault, SensorReport, SignalInfo, SignalKind
from handover_ros.types.type_store import TypeStore
from services.human_state.tests.unit.exchange.random_signals import features, same_values, samples
from tests.kit.paths import REPOSITORY

TYPES = TypeStore()
FOLDER = REPOSITORY / "ros_fiware_bridge/handover_ros/messages" / "handover_human_msgs"
OURS = sorted(name for name in TYPES.type_names() if name.startswith(ros.PACKAGE))


def over_the_wire(type_name: str, message: dict[str, Any]) -> dict[str, Any]:
    return TYPES.decode(type_name, TYPES.encode(type_name, message))


@pytest.mark.parametrize("name", OURS)
def test_a_message_type_is_sound_has_a_hash_and_says_what_it_is(name: str) -> None:
    assert TYPES.sound(name).fields
    assert TYPES.hash(name).startswith("RIHS01_")
    text = (FOLDER / "msg" / f"{name.removeprefix(ros.PACKAGE)}.msg").read_text()
    assert text.startswith("# ")


def test_colcon_gets_every_message_file() -> None:
    listed = re.findall(r'"msg/(\w+)\.msg"', (FOLDER / "CMakeLists.txt").read_text())
    assert sorted(listed) == sorted(name.removeprefix(ros.PACKAGE) for name in OURS)
    assert sorted(listed) == sorted(file.stem for file in (FOLDER / "msg").iterdir())


def test_the_parser_of_rosbags_reads_every_message_file() -> None:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for file in (FOLDER / "msg").iterdir():
        store.register(get_types_from_msg(file.read_text(), ros.PACKAGE + file.stem))
    assert store.generate_msgdef(f"{ros.PACKAGE}HumanState", ros_version=2)[0]


@given(samples())
def test_samples_come_back(given: Samples) -> None:
    found = [
        ros.samples_of(name, over_the_wire(name, message)) for name, message in ros.messages_of(given, "p-1")
    ]
    joined = replace(
        found[0],
        values=np.concatenate([each.values for each in found]),
        times_s=np.concatenate([each.sample_times_s() for each in found]),
    )
    assert same_values(joined, given)
    for each in found:
        assert (each.info.method, each.clock, each.quality, each.has_contact, each.uncertainty_s) == (
            given.info.method,
            given.clock,
            given.quality,
            given.has_contact,
            given.uncertainty_s,
        )
        assert replace(each.info, method="") == replace(given.info, method="")


@given(features())
def test_a_feature_comes_back(given: Feature) -> None:
    name, message = ros.feature_message(given, "p-1")
    back = ros.feature_of(over_the_wire(name, message))
    assert back.at_s == pytest.approx(given.at_s, abs=1e-6)
    assert replace(back, at_s=given.at_s) == given
    if (typed := ros.typed_message(given, "p-1")) is not None:
        assert over_the_wire(*typed)["info"]["subject"] == "p-1"
    state = ros.state_message([given], "p-1", given.at_s)
    assert len(over_the_wire(*state)["features"]) == 1


def test_intervals_are_in_seconds_whatever_the_sensor_gives() -> None:
    info = SignalInfo(SignalKind.INTER_BEAT_INTERVAL, "C26", None, max_value=2000.0)
    given = Samples("strap", info, 10.0, np.array([[800.0], [810.0]]), np.array([10.0, 10.81]))
    ((name, message),) = ros.messages_of(given)
    assert over_the_wire(name, message)["intervals_s"].tolist() == [0.8, 0.81]
    back = ros.samples_of(name, message)
    assert (back.info.unit, back.info.max_value) == ("SEC", 2.0)


def test_a_value_in_another_unit_is_not_mislabelled() -> None:
    info = SignalInfo(SignalKind.SKIN_TEMPERATURE, "FAH", 1.0)
    ((name, message),) = ros.messages_of(Samples("s", info, 0.0, np.array([[97.0]])))
    assert (name, message["kind"], message["info"]["unit"]) == (
        f"{ros.PACKAGE}OtherSignal",
        "skinTemperature",
        "FAH",
    )


@pytest.mark.parametrize(
    "change",
    [
        {"samples": {"channels": ["a", "b"], "values": [1.0], "start_s": 0.0, "times_s": []}},
        {"samples": {"channels": ["a"], "values": [1.0], "start_s": 0.0, "times_s": [1.0, 2.0]}},
        {"samples": {"channels": [], "values": [], "start_s": 0.0, "times_s": []}},
        {"kind": "soul"},
        {"info": {}},
    ],
)
def test_a_faulty_message_is_refused(change: dict[str, Any]) -> None:
    info = SignalInfo(SignalKind.SLEEP, "", 1.0)
    ((name, message),) = ros.messages_of(Samples("s", info, 0.0, np.array([[1.0]])))
    with pytest.raises(ExchangeError, match="OtherSignal"):
        ros.samples_of(name, {**message, **change})


def test_a_quality_that_is_none_counts_as_the_worst() -> None:
    name, message = ros.feature_message(Feature(FeatureName.HEART_RATE, "s", 80.0, 1.0, 1.0))
    message["info"]["quality"] = 3.0
    assert ros.feature_of(message).quality == 0.0
    with pytest.raises(ExchangeError, match="no signal"):
        ros.samples_of(name, message)


@given(st.sampled_from(SensorFault))
def test_faults_and_markers_are_messages(fault: SensorFault) -> None:
    report = SensorReport("strap", 10.5, fault=fault, text="off", details={"gap_s": 2.0})
    message = ros.fault_message(report, "p-1")
    assert message is not None
    assert over_the_wire(*message)["fault"] == fault.value
    assert ros.fault_message(replace(report, fault=None)) is None
    assert (
        over_the_wire(*ros.marker_message("task", "start", 1.5))["header"]["stamp"]["nanosec"] == 500_000_000
    )


@pytest.mark.parametrize(
    ("kind", "channels", "expected"),
    [
        (SignalKind.GAIT, ("cadence_per_min", "asymmetry"), "Gait"),
        (SignalKind.MOOD, ("valence", "arousal"), "Mood"),
        (SignalKind.MOVEMENT, ("",), "Movement"),
        (SignalKind.GAIT, ("hips",), "OtherSignal"),
    ],
)
def test_gait_mood_and_movement_have_fields(
    kind: SignalKind, channels: tuple[str, ...], expected: str
) -> None:
    values = np.linspace(0.25, 0.75, 2 * len(channels)).reshape(2, -1)
    one = Samples("s", SignalInfo(kind, "", None, channels), 1.0, values, np.array([1.0, 2.0]))
    made = [(name, over_the_wire(name, message)) for name, message in ros.messages_of(one, "p-1")]
    assert {name for name, _ in made} == {ros.PACKAGE + expected}
    back = [ros.samples_of(name, message) for name, message in made]
    assert np.concatenate([each.values for each in back]).tolist() == values.tolist()
    assert {each.info for each in back} == {one.info}


EYES = (SignalKind.BLINK, SignalKind.FIXATION, SignalKind.SACCADE, SignalKind.GAZE)


@given(
    kind=st.sampled_from(EYES),
    rows=st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 5), min_size=1, max_size=4),
    has_gaze=st.booleans(),
    has_size=st.booleans(),
    has_speed=st.booleans(),
)
def test_events_of_the_eyes_come_back(
    kind: SignalKind, rows: list[tuple[float, ...]], has_gaze: bool, has_size: bool, has_speed: bool
) -> None:
    channels: tuple[str, ...] = ("gaze_x", "gaze_y")
    if kind is not SignalKind.GAZE:
        of_movement = ("amplitude_deg",) * has_size + ("peak_velocity",) * has_speed
        channels = ("duration_s", *channels * has_gaze, *of_movement)
    values = np.array(rows)[:, : len(channels)]
    times_s = 1.0 + np.arange(len(rows))
    one = Samples("glasses", SignalInfo(kind, "DD", None, channels), 1.0, values, times_s)
    made = [(name, over_the_wire(name, message)) for name, message in ros.messages_of(one, "p-1")]
    assert {name for name, _ in made} == {f"{ros.PACKAGE}EyeEvent"}
    back = [ros.samples_of(name, message) for name, message in made]
    assert np.array_equal(np.concatenate([each.values for each in back]), values, equal_nan=True)
    assert np.concatenate([each.sample_times_s() for each in back]).tolist() == times_s.tolist()
    assert {each.info for each in back} == {one.info}


@pytest.mark.parametrize("change", [{"kind": 0}, {"kind": 9}, {"gaze": [1.0]}, {"kind": 4, "gaze": []}])
def test_a_faulty_event_of_the_eyes_is_refused(change: dict[str, Any]) -> None:
    info = SignalInfo(SignalKind.BLINK, "", None, ("duration_s",))
    ((name, message),) = ros.messages_of(Samples("s", info, 1.0, np.array([[0.2]]), np.array([1.0])))
    with pytest.raises(ExchangeError, match="EyeEvent"):
        ros.samples_of(name, {**message, **change})
