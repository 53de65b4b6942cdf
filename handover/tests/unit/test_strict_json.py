"""The types of JSON in bodies: no conversion between booleans, numbers, texts and times."""

from datetime import UTC, datetime
from datetime import time as time_of_day
from typing import Annotated, Any, Literal

import pytest
import yaml
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, TypeAdapter, ValidationError, model_validator

from handover.formats.strict_json import StrictJson, StrictModel
from handover.formats.validation import LocalMoment, Moment


class Check(StrictModel):
    model_config = ConfigDict(extra="forbid")

    count: Annotated[int, Field(ge=0)] = 0

    @model_validator(mode="after")
    def _is_small(self) -> "Check":
        assert self.count < 10, "less than ten"
        return self


class Rule(StrictModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    type: bool = False
    default: int = 0
    limit: FiniteFloat | None = None
    category: Literal[1, 2] = 1
    place: tuple[float, float] = (0.0, 0.0)
    counts: dict[int, int] = Field(default_factory=dict)
    check: Check | None = None
    parts: list["Rule"] = Field(default_factory=list)
    at: Moment | None = None
    since: LocalMoment | None = None
    opens: time_of_day | None = None
    extra: Any = None

    @model_validator(mode="before")
    @classmethod
    def _of_a_name(cls, value: Any) -> Any:
        return {"type": True} if value == "on" else value


class Rules(StrictModel):
    by_name: dict[str, Rule | Check]


OTHERS = [
    *({"type": value} for value in (0, 1, 1.0, "true", "on")),
    *({"default": value} for value in (False, True, "1", 1.5, 1e30)),
    *({"limit": value} for value in (False, "1.5")),
    *({"category": value} for value in (True, "1")),
    {"place": [True, 0]},
    {"counts": {"1": True}},
    {"check": {"count": True}},
    {"parts": [{"parts": [{"default": "1"}]}]},
    *({name: value} for name in ("at", "since", "opens") for value in (0, 0.5, True, "0.5", "1e3", " 5 ")),
]


@pytest.mark.parametrize("body", OTHERS, ids=str)
def test_a_value_of_another_type_is_refused(body: dict[str, Any]) -> None:
    for model, document in ((Rule, body), (Rules, {"by_name": {"x": body}})):
        with pytest.raises(ValidationError):
            model.model_validate(document)


def test_what_json_schema_accepts_is_accepted() -> None:
    rule = Rule.model_validate(
        {
            "type": True, "default": 3.0, "limit": 1, "category": 2, "place": [1, 2.5], "counts": {"7": 2.0},
            "check": {"count": 9.0}, "parts": ["on"], "at": "2026-11-01T10:00:00Z", "since": "2026-11-01",
            "opens": "10:00", "extra": {"any": [True, 0, "1", 1.0]},
        }
    )  # fmt: skip
    assert (rule.default, rule.limit, rule.place, rule.counts) == (3, 1.0, (1.0, 2.5), {7: 2})
    assert rule.check == Check(count=9)
    assert rule.parts[0].type is True
    assert (rule.at, rule.since) == (datetime(2026, 11, 1, 10, tzinfo=UTC), datetime(2026, 11, 1))  # noqa: DTZ001
    assert rule.extra == {"any": [True, 0, "1", 1.0]}


def test_the_schema_is_that_of_the_plain_model() -> None:
    class Plain(BaseModel):
        on: bool = False
        count: Annotated[int, Field(ge=0)] = 0
        level: int | None = None

    class Strict(StrictModel):
        on: bool = False
        count: Annotated[int, Field(ge=0)] = 0
        level: int | None = None

    assert {**Strict.model_json_schema(), "title": "Plain"} == Plain.model_json_schema()


def test_a_plain_model_inside_a_strict_one_keeps_its_conversions() -> None:
    class Plain(BaseModel):
        count: int

    class Strict(StrictModel):
        plain: Plain

    assert Strict.model_validate({"plain": {"count": "1"}}).plain.count == 1
    assert Plain.model_validate({"count": "2"}).count == 2


def test_a_body_that_is_no_model_is_strict_with_the_annotation() -> None:
    levels: TypeAdapter[Any] = TypeAdapter(Annotated[dict[int, dict[str, float]], StrictJson()])
    assert levels.validate_python({"3": {"thumb": 1}}) == {3: {"thumb": 1.0}}
    for value in (True, "1"):
        with pytest.raises(ValidationError):
            levels.validate_python({"3": {"thumb": value}})


def test_the_error_names_the_field_the_rule_and_an_example() -> None:
    with pytest.raises(ValidationError, match=r"opens\n.*ISO 8601 text, for example 10:00, not as a number"):
        Rule.model_validate({"opens": 36_000})
    with pytest.raises(ValidationError, match="in YAML in quotes"):
        Rule.model_validate(yaml.safe_load("opens: 10:00"))
