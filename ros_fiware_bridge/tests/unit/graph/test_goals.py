"""What is said of a goal that did not succeed."""

from typing import Any

import pytest

from handover_ros.graph.goals import MAX_RESULT_CHARS, result_text


@pytest.mark.parametrize(
    ("result", "text"),
    [
        (
            {"error_code": -5, "error_string": "wrist: goal tolerance", "SUCCESSFUL": 0},
            "error_code -5, error_string wrist: goal tolerance",
        ),
        ({"result": {}, "sequence": [1, 2]}, ""),
        ({"success": False, "message": ""}, ""),
        ({}, ""),
    ],
)
def test_the_result_of_a_goal_is_said_by_its_texts_and_numbers(result: dict[str, Any], text: str) -> None:
    assert result_text(result) == text


def test_a_long_result_is_cut() -> None:
    assert len(result_text({"text": "x" * 10_000})) == MAX_RESULT_CHARS
