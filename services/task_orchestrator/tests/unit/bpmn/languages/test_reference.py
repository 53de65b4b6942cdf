"""The reference page of the expression languages is right and complete."""

import json
import re
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import pytest

from handover_bpmn.languages.base import Expression
from handover_bpmn.languages.feel import read_feel
from handover_bpmn.languages.feel.functions import FUNCTIONS
from handover_bpmn.languages.juel import read_juel
from handover_bpmn.languages.juel.methods import EXECUTION_PROPERTIES, METHODS
from handover_bpmn.languages.native import read
from handover_bpmn.timing.timers import due_at, parse_cycle
from tests.kit.paths import REPOSITORY

PAGE = (REPOSITORY / "docs/reference/expressions.md").read_text(encoding="utf-8")
READERS: dict[str, Callable[[str], Expression]] = {"Native": read, "JUEL": read_juel, "FEEL": read_feel}
VARIABLES = json.loads(re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)[0])


def _rows(heading: str) -> list[tuple[str, str]]:
    table = PAGE.partition(f"| {heading} expression | Value |\n|---|---|\n")[2].partition("\n\n")[0]
    return re.findall(r"^\| `(.*)` \| `(.*)` \|$", table, re.MULTILINE)


EXAMPLES = [(heading, text, value) for heading in READERS for text, value in _rows(heading)]


@pytest.mark.parametrize(("heading", "text", "value"), EXAMPLES)
def test_an_example_has_its_value(heading: str, text: str, value: str) -> None:
    result: Any = READERS[heading](text.replace("\\|", "|")).value(VARIABLES)
    assert json.dumps(result) == json.dumps(json.loads(value))


def test_every_language_has_examples() -> None:
    assert {heading for heading, _, _ in EXAMPLES} == set(READERS)
    assert len(EXAMPLES) > 40


def test_every_function_method_and_property_is_listed() -> None:
    assert {name for name in FUNCTIONS if f"`{name}(`" not in PAGE} == set()
    assert {name for name in METHODS | EXECUTION_PROPERTIES if f"`{name}`" not in PAGE} == set()


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (kind, text)
        for kind, texts in re.findall(r"^\| (date|duration|cycle) \| (.*?) \| ", PAGE, re.MULTILINE)
        for text in re.findall(r"`(.*?)`", texts)
    ],
)
def test_an_example_of_a_timer_is_valid(kind: str, text: str) -> None:
    since = datetime(2026, 5, 1, tzinfo=UTC)
    due = parse_cycle(text).first(since) if kind == "cycle" else due_at(text, since)
    assert due > since
