"""Faults of documents, in words for people."""

import pytest
from pydantic import BaseModel, ValidationError, model_validator

from handover.formats.validation import fault_lines, fault_text


class Motion(BaseModel):
    joints: list[float]
    speed: float = 1.0

    @model_validator(mode="after")
    def check(self) -> "Motion":
        if not self.joints:
            raise ValueError("a motion has joints")
        return self


def faults(document: object) -> ValidationError:
    with pytest.raises(ValidationError) as caught:
        Motion.model_validate(document)
    return caught.value


def test_each_fault_has_its_place() -> None:
    assert fault_lines(faults({"joints": [1, "x"], "speed": "fast"})) == [
        "joints.1: Input should be a valid number, unable to parse string as a number",
        "speed: Input should be a valid number, unable to parse string as a number",
    ]


def test_a_rule_of_ours_is_shown_without_the_name_of_its_exception() -> None:
    assert fault_text(faults({"joints": []}), "motion") == "motion: a motion has joints"


def test_many_faults_are_counted() -> None:
    text = fault_text(faults({"joints": ["x"] * 9}))
    assert text.count("joints.") == 5
    assert text.endswith("; and 4 more")
