"""Features and HumanState are equivalent, and an entity is written seldom but never too late."""

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_body.exchange.ngsi_ld import (
    FUSED,
    OF_PERSON,
    EntityThrottle,
    features_of,
    human_state,
    only_fused,
    pressure_mat,
    read_human_state,
    session,
)
from handover_body.formats.errors import ExchangeError
from handover_body.fusion.person_state import FusedValue, fused
from handover_body.model.features import Feature, FeatureName, Status
from handover_datamodels import HumanState

STATE, PERSON = "urn:ngsi-ld:HumanState:demo:p1", "urn:ngsi-ld:Person:demo:p1"
TEXTS = {
    FeatureName.ACTIVITY,
    FeatureName.POSTURE,
    FeatureName.SLEEP_POSITION,
    FeatureName.WEAR_STATE,
}
times = st.integers(0, 4_000_000_000_000_000).map(lambda micros: micros / 1_000_000)


@st.composite
def fused_values(draw: st.DrawFn) -> FusedValue:
    name = draw(st.sampled_from(sorted(OF_PERSON)))
    sources = draw(st.lists(st.text(min_size=1, max_size=8), min_size=1, max_size=3, unique=True))
    value = st.sampled_from(["Rest", "Transfer"]) if name in TEXTS else st.floats(-1e6, 1e6)
    return fused(
        name,
        [
            Feature(
                name,
                source,
                draw(value),
                draw(times),
                draw(st.floats(0, 1)),
                draw(st.sampled_from(Status)),
                draw(st.sampled_from(["", "ecg", "radar"])),
                is_calibrated=draw(st.booleans()),
            )
            for source in sources
        ],
    )


def a_value(value: float | str, at_s: float = 1000.0, status: Status = Status.VALID) -> FusedValue:
    name = FeatureName.POSTURE if isinstance(value, str) else FeatureName.HEART_RATE
    return fused(name, [Feature(name, "strap", value, at_s, 0.9, status)])


def a_state(*values: FusedValue) -> HumanState:
    return human_state(STATE, PERSON, values)


@given(st.lists(fused_values(), max_size=4, unique_by=lambda each: each.name))
def test_features_come_back_from_the_entity_and_its_json(values: list[FusedValue]) -> None:
    written = human_state(STATE, PERSON, values).to_normalized()
    found = {(each.name, each.source): each for each in features_of(read_human_state(written))}
    expected = 0
    for value in values:
        default = found[value.name, FUSED]
        assert (default.value, default.status, default.quality) == (value.value, value.status, value.quality)
        for sensor in value.sensors:
            back = found[sensor.name, sensor.source]
            assert back.at_s == pytest.approx(sensor.at_s, abs=2e-6)
            assert replace(back, at_s=sensor.at_s) == sensor
        expected += 1 + len(value.sensors)
    assert len(found) == expected


def test_the_entity_names_unit_sensor_and_person() -> None:
    value = a_value(92.5)
    written = human_state(STATE, PERSON, [value], {"strap": "urn:ngsi-ld:Device:demo:strap"}).to_normalized()
    assert written["refPerson"]["object"] == PERSON
    default, sensor = written["heartRate"]
    assert default["unitCode"] == sensor["unitCode"] == "BPM"
    assert "datasetId" not in default
    assert sensor["datasetId"] == "urn:ngsi-ld:Dataset:strap"
    assert default["observedBy"]["object"] == "urn:ngsi-ld:Device:demo:strap"


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_number_that_is_not_finite_is_left_out(value: float) -> None:
    assert "heartRate" not in a_state(a_value(value)).to_normalized()


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        ({"observedAt": None}, "observedAt"),
        ({"unitCode": "C26"}, "must be in BPM"),
        ({"quality": 2}, "heartRate"),
    ],
)
def test_a_faulty_entity_is_refused_with_the_rule(change: dict[str, Any], reported: str) -> None:
    written = a_state(a_value(92.5)).to_normalized()
    written["heartRate"] = {
        key: value for key, value in {**written["heartRate"][0], **change}.items() if value is not None
    }
    with pytest.raises(ExchangeError, match=reported):
        features_of(read_human_state(written))


def test_a_value_without_status_and_quality_is_not_usable() -> None:
    bare = {"type": "Property", "value": 90, "observedAt": "2026-03-02T09:12:04Z"}
    (found,) = features_of(
        read_human_state({"id": STATE, "type": "HumanState", "refPerson": PERSON, "heartRate": bare})
    )
    assert (found.status, found.quality) == (Status.IMPLAUSIBLE, 0.0)


def test_a_mat_and_a_session_become_entities() -> None:
    names = (FeatureName.CENTRE_OF_PRESSURE_X, FeatureName.ACTIVE_CELLS, FeatureName.HEART_RATE)
    values = [fused(name, [Feature(name, "mat", 9.0, 1000.0, 1.0)]) for name in names]
    mat = pressure_mat("urn:ngsi-ld:PressureMat:demo:m", "urn:ngsi-ld:Device:demo:m", values)
    assert mat.active_cells is not None
    assert (mat.active_cells.value, "heartRate" in mat.to_normalized()) == (9, False)
    assert {each.name for each in features_of(mat)} == set(names[:2])
    made = session("urn:ngsi-ld:PhysiologicalSession:demo:s", PERSON, 1000.0, end_s=1060.0, sha256="a" * 64)
    assert made.to_normalized()["endedAt"]["value"]["@value"] == "1970-01-01T00:17:40.000000Z"


@given(
    st.lists(
        st.tuples(st.floats(0.01, 3), st.floats(60, 100), st.sampled_from(Status)), min_size=1, max_size=40
    )
)
def test_an_entity_is_written_at_most_once_a_second_and_never_far_from_the_truth(
    steps: list[tuple[float, float, Status]],
) -> None:
    throttle, now_s, written_at = EntityThrottle(), 0.0, [-10.0]
    last: tuple[float, Status] = (0.0, Status.VALID)
    for wait_s, rate, status in steps:
        now_s += wait_s
        if throttle.offer(a_state(a_value(rate, now_s, status)), now_s) is not None:
            assert now_s - written_at[-1] >= 1.0
            written_at.append(now_s)
            last = rate, status
        elif now_s - written_at[-1] >= 1.0:
            assert abs(rate - last[0]) < 1.0
            assert status is last[1]
    if throttle.due(now_s + 1.0) is None:
        assert abs(steps[-1][1] - last[0]) < 1.0
        assert steps[-1][2] is last[1]


def test_an_unchanged_entity_is_refreshed_and_a_failed_write_is_repeated() -> None:
    throttle = EntityThrottle()
    state = a_state(a_value(80))
    assert throttle.offer(state, 0.0) is state
    assert throttle.offer(state, 2.0) is None
    throttle.failed()
    assert throttle.due(2.5) is state
    assert throttle.due(12.4) is None
    assert throttle.due(12.5) is state
    assert throttle.due(3.0) is state  # the clock was set back


def test_texts_and_sensors_that_come_are_changes() -> None:
    throttle = EntityThrottle()
    throttle.offer(a_state(a_value("sitting")), 0.0)
    assert throttle.offer(a_state(a_value("sitting")), 1.0) is None
    assert throttle.offer(a_state(a_value("standing")), 2.0) is not None
    assert throttle.offer(a_state(a_value("standing"), a_value(80)), 3.0) is not None


def test_a_broker_that_keeps_one_value_gets_the_fused_one() -> None:
    of_all, sensor = (
        {"type": "Property", "value": 70.0},
        {"type": "Property", "value": 71.0, "datasetId": "urn:a"},
    )
    person = {"type": "Relationship", "object": "urn:ngsi-ld:Person:demo:a"}
    entity = {"id": "urn:a", "type": "HumanState", "refPerson": person}
    for instances in ([of_all, sensor], [sensor, of_all], of_all):
        assert only_fused({**entity, "heartRate": instances}) == {**entity, "heartRate": of_all}
