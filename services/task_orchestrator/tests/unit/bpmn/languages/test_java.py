"""Conditions and values of Java, MVEL, JavaScript and Groovy that have the form of JUEL."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_bpmn.languages.base import ExpressionError, within_limits
from handover_bpmn.languages.java import read_java, read_java_assignment
from services.task_orchestrator.tests.unit.bpmn.languages.values import JSON

ORDER = {
    "approved": True,
    "refused": False,
    "count": 2,
    "code": "1",
    "blank": "",
    "nothing": None,
    "items": ["gear", "shaft", "nut"],
    "order": {"length": 7},
}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("return approved;", True),
        ("return (count > 1 && !refused);", True),
        ("eval(count == 2);", True),
        ("code === '1' && count !== 3", True),
        ('$code == "1"', True),
        ('"$code == 1L"', "$code == 1L"),
        ("#{approved}", True),
        ("(Integer) count > 1L", True),
        ("((Boolean) approved)", True),
        ("((java.lang.Boolean) approved) == true", True),
        ("(count) > 1", True),
        ("Boolean.TRUE.equals(approved)", True),
        ("java.lang.Boolean.FALSE.equals(approved)", False),
        ("items.size == 3 && items.size() == 3 && code.length > 0", True),
        ("order.length", 7),
        ("code + '1'", "11"),
        ("count + 1", 3),
        ("'count: ' + count + nothing", "count: 2null"),
        ("Integer.parseInt(code) + 1", 2),
        ("java.lang.Integer.toString(count) + 1", "21"),
        ("Objects.equals(code, '1')", True),
        ('kcontext.getVariable("code") == "1"', True),
        ("KieFunctions.isNull(nothing) && KieFunctions.isEmpty(blank)", True),
        ("KieFunctions.isTrue(approved) && KieFunctions.isFalse(refused)", True),
        ("KieFunctions.isTrue(nothing) || KieFunctions.isFalse(nothing)", False),
        ('KieFunctions.equalsTo(count, "2")', True),
        ('KieFunctions.contains("gear", "ea")', True),
        ('KieFunctions.startsWith(nothing, "g")', False),
        ('KieFunctions.endsWith("gear", "r")', True),
        ('KieFunctions.greaterThan(count, "1") && KieFunctions.lessOrEqualThan(count, "2")', True),
        ('KieFunctions.lessThan(nothing, "1") || KieFunctions.greaterOrEqualThan(nothing, "1")', False),
        ('KieFunctions.between(count, "1", "3")', True),
    ],
)
def test_an_expression_has_its_value(text: str, value: object) -> None:
    assert read_java(text).value(ORDER) == value


@pytest.mark.parametrize(
    "text",
    [
        "if (count > 1) { return true; }",
        "Person(name == 'Ada')",
        "KieFunctions.unknown(count)",
        "KieFunctions.isTrue()",
        "Runtime.exec('x')",
        "count = 3",
        "items.stream().anyMatch(x -> x == 1)",
        "",
    ],
)
def test_anything_else_is_no_expression(text: str) -> None:
    with pytest.raises(ExpressionError):
        read_java(text)


def test_an_assignment_has_a_name_and_a_value() -> None:
    found = read_java_assignment('kcontext.setVariable("code", code + "1")')
    assert found is not None
    assert (found[0], found[1].value(ORDER)) == ("code", "11")
    assert read_java_assignment("System.exit(1)") is None


@given(st.text(st.sampled_from("aA.()\"'$#{}1L+=!,;[ ]return"), max_size=40), JSON)
def test_no_text_raises_anything_but_the_error_of_expressions(text: str, value: object) -> None:
    with suppress(ExpressionError):
        within_limits(read_java(text).value({"a": value, "A": value}))
