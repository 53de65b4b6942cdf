"""Messages: a text with its code and parameters, as it travels and comes back."""

import ast
import math
import pickle
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover.messages import Message, message, message_in, number_text, with_code
from handover_web.messages import python_sources
from tests.kit.paths import REPOSITORY

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


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e6, max_value=1e6))
def test_a_number_in_a_message_is_rounded_for_people(value: float) -> None:
    said = message("robot.late", "{value} s late", value=value)
    digits = said.removesuffix(" s late")
    assert math.isclose(float(digits), value, rel_tol=5e-4)
    assert len(digits) <= len("-1.234e-300")
    assert digits == str(said.parameters["value"]) == number_text(value)


def test_numbers_of_people_are_short() -> None:
    assert [number_text(each) for each in (9.495999999999185, 5.0, 0.1 + 0.2, 86_400.5)] == [
        "9.496",
        "5",
        "0.3",
        "86400",
    ]


_UNIT = re.compile(r"_(s|m|mm|h|rad|deg|hz|bpm|kg|n|nm|v|celsius|mps|radps|rad_s|m_s)$")
_WHOLE = {"radius_mm", "retry_after_s"}
"""Names of whole numbers."""


def unformatted(file: Path) -> Iterator[str]:
    """Yield the numbers with a unit that a text of people shows with all their digits."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.JoinedStr):
            continue
        text = "".join(str(part.value) for part in node.values if isinstance(part, ast.Constant))
        for part in node.values:
            if isinstance(part, ast.FormattedValue) and part.format_spec is None and " " in text:
                name = ast.unparse(part.value).rpartition(".")[2]
                if name.isidentifier() and name.islower() and _UNIT.search(name) and name not in _WHOLE:
                    yield f"{file.relative_to(REPOSITORY)}:{part.lineno}: {name}"


def test_no_text_has_a_number_with_all_its_digits() -> None:
    folders = ("datamodels", "handover", "glove_sdk_bridge", "ros_fiware_bridge", "services", "webui")
    files = [file for folder in folders for file in python_sources(REPOSITORY / folder)]
    found = [one for file in files for one in unformatted(file)]
    assert not found, f"use handover.messages.number_text: {found}"
