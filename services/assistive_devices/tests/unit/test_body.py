"""Which values of a body a controller uses: valid ones of quality 0.5, by its own clock."""

from typing import Any

import pytest

from handover_cases.model.body import read_body


def message(**members: Any) -> dict[str, Any]:
    known = {"name": "heartRate", "value": 80.0, "quality": 0.9, "status": "valid", "ageS": 0.2}
    return {**known, **members}


def test_a_fresh_valid_value_is_used_until_it_is_old() -> None:
    body = read_body([message()], 100.0)
    assert body.number("heartRate", 100.0, 3.0) == 80.0
    assert body.number("heartRate", 102.7, 3.0) == 80.0
    assert body.number("heartRate", 102.9, 3.0) is None, "no message came: it ages here"


@pytest.mark.parametrize(
    "fault",
    [{"status": "stale"}, {"status": "implausible"}, {"quality": 0.4}, {"quality": None}, {"value": None},
     {"value": "sitting"}, {"ageS": 4.0}],
)  # fmt: skip
def test_a_value_with_a_fault_is_none(fault: dict[str, Any]) -> None:
    assert read_body([message(**fault)], 100.0).number("heartRate", 100.0, 3.0) is None


def test_an_age_below_0_makes_no_value_fresher() -> None:
    body = read_body([message(ageS=-1000.0)], 100.0)
    assert body.number("heartRate", 103.5, 3.0) is None


def test_words_are_read_as_words() -> None:
    body = read_body([message(name="sleepPosition", value="left")], 100.0)
    assert body.text("sleepPosition", 100.0, 3.0) == "left"
    assert body.text("heartRate", 100.0, 3.0) is None
