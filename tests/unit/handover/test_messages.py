"""Messages: a text with its code and parameters, as it travels and comes back."""

import pickle
from typing import Any

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover.messages import Message, message, message_in, with_code

PARAMETERS = st.dictionaries(
    st.text(min_size=1), st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.text()
)


def test_a_message_is_its_english_text() -> None:
    said = message("glove.unknown", 'there is no glove "{glove}"; known: {known}', glove="{x}", known="none")
    assert said == 'there is no glove "{x}"; known: none'
    assert f"{said}!" == 'there is no glove "{x}"; known: none!'
    assert (said.code, said.parameters) == ("glove.unknown", {"glove": "{x}", "known": "none"})
    assert pickle.loads(pickle.dumps(said)).parameters == said.parameters


def test_a_problem_has_the_code_and_the_parameters_of_its_detail() -> None:
    body = Problem(404, "Unknown glove", message("glove.unknown", 'no "{glove}"', glove="g")).body()
    assert body["detail"] == 'no "g"'
    assert body["detailCode"] == "glove.unknown"
    assert body["detailParameters"] == {"glove": "g"}
    assert Problem(404, "Unknown glove", "plain").body().keys() == {"type", "title", "status", "detail"}


@given(PARAMETERS, PARAMETERS)
def test_what_travels_as_json_is_the_same_message(outer: dict[str, Any], inner: dict[str, Any]) -> None:
    part = Message("the arm is away", "arm.away", inner)
    whole = Message("it failed: the arm is away", "task.failed", {**outer, "reason": part})
    there = orjson.loads(orjson.dumps(with_code("reason", whole)))
    back = message_in(there, "reason")
    assert isinstance(back, Message)
    assert (back, back.code, back.parameters) == (whole, whole.code, whole.parameters)
    assert isinstance(back.parameters["reason"], Message)
    assert back.parameters["reason"].parameters == inner


@pytest.mark.parametrize(
    ("members", "expected"),
    [
        ({}, None),
        ({"reason": 7}, None),
        ({"reason": "plain"}, "plain"),
        ({"reason": "x", "reasonCode": 7, "reasonParameters": {}}, "x"),
        ({"reason": "x", "reasonCode": "a.b", "reasonParameters": []}, "x"),
    ],
)
def test_what_is_no_message_stays_text(members: dict[str, Any], expected: str | None) -> None:
    back = message_in(members, "reason")
    assert back == expected
    assert not isinstance(back, Message)
