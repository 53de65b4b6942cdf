"""JUEL, the expressions of Camunda 7: values, coercions, errors and limits."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_bpmn.languages.base import NOW, ExpressionError, within_limits
from handover_bpmn.languages.juel import read_juel, read_set_variable, read_template
from handover_bpmn.languages.tokens import MAX_CHARACTERS
from services.task_orchestrator.tests.unit.bpmn.languages.values import JSON

ORDER = {
    "approved": True,
    "score": 4,
    "ratio": 0.5,
    "name": "Ada",
    "text": "17",
    "nothing": None,
    "items": ["gear", "shaft"],
    "order": {"id": "o-1", "total": 12.5, "lines": [{"part": "gear", "count": 2}], "open": True},
    "document": '{"customer": {"age": 20, "tags": ["new"]}}',
    "since": "2026-05-01T08:00:00Z",
    "execution": {"processBusinessKey": "key-7", "processInstanceId": "p-1"},
    NOW: "2026-05-31T08:00:00+02:00",
}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("${approved}", True),
        ("#{!approved}", False),
        ("${ not approved }", False),
        ("${!approved || score > 3}", True),
        ("${approved and score le 3}", False),
        ("${score == 4}", True),
        ("${score eq '4'}", True),
        ("${score != 5 && name ne 'Bob'}", True),
        ("${text + 3}", 20),
        ("${nothing + 1}", 1),
        ("${nothing == null}", True),
        ("${name == null}", False),
        ("${approved == 'true'}", True),
        ("${1 < 2 == true}", True),
        ("${name < 'Bob'}", True),
        ("${nothing < 1}", False),
        ("${nothing <= null}", True),
        ("${2 + 3 * 4 - 6 / 4}", 12.5),
        ("${(2 + 3) * 4}", 20),
        ("${10 - 4 - 3}", 3),
        ("${7 mod 4 + 7 % 4}", 6),
        ("${-7 % 4}", -3),
        ("${7 div 2}", 3.5),
        ("${-score}", -4),
        ("${- -score}", 4),
        ("${1.5e2}", 150.0),
        ("${.5}", 0.5),
        ("${name += ' ' += score}", "Ada 4"),
        ("${empty nothing}", True),
        ("${empty missing}", True),
        ("${empty missing.part}", True),
        ("${not empty items}", True),
        ("${!empty order.none}", False),
        ("${score > 3 ? 'high' : score > 1 ? 'middle' : 'low'}", "high"),
        ("${order.total}", 12.5),
        ("${order['id']}", "o-1"),
        ("${order.lines[0].part}", "gear"),
        ("${order.lines[score - 4]['count']}", 2),
        ("${order.lines[5]}", None),
        ("${order.unknown.part}", None),
        ("${items[1]}", "shaft"),
        ('${"it\'s"}', "it's"),
        (r"${'it\'s \\ {}'}", "it's \\ {}"),
        ("${name.equals('Ada')}", True),
        ("${text.equals(17)}", False),
        ("${name.equalsIgnoreCase('ADA')}", True),
        ("${name.contains('d') && name.startsWith('A') && name.endsWith('a')}", True),
        ("${name.toUpperCase().toLowerCase().trim().length()}", 3),
        ("${name.substring(1)}", "da"),
        ("${name.substring(0, 2)}", "Ad"),
        ("${name.charAt(0)}", "A"),
        ("${name.matches('A.') || name.matches('(A|d|a)+')}", True),
        ("${name.indexOf('a')}", 2),
        ("${name.replace('a', 'o').concat('!')}", "Ado!"),
        ("${'a.b'.split('\\\\.')}", ["a", "b"]),
        ("${'a,b'.split(',').size()}", 2),
        ("${name.isEmpty()}", False),
        ("${items.contains('gear')}", True),
        ("${items.get(0)}", "gear"),
        ("${items.size() == 2}", True),
        ("${items.isEmpty()}", False),
        ("${order.containsKey('id')}", True),
        ("${order.get('id')}", "o-1"),
        ("${order.getOrDefault('none', 3)}", 3),
        ("${order.getTotal() > 10}", True),
        ("${order.isOpen()}", True),
        ("${order.keySet()}", ["id", "total", "lines", "open"]),
        ("${order.total.intValue()}", 12),
        ("${score.toString()}", "4"),
        ("${ratio.doubleValue()}", 0.5),
        ('${order.prop("lines").elements().get(0).prop("count").numberValue() < 21}', True),
        ("${S(document).prop('customer').prop('age').value()}", 20),
        ("${JSON(document).prop('customer').hasProp('name')}", False),
        ("${execution.getVariable('name')}", "Ada"),
        ("${execution.getVariable('missing')}", None),
        ("${execution.hasVariable('missing')}", False),
        ("${execution.processBusinessKey}", "key-7"),
        ("${execution.getProcessInstanceId()}", "p-1"),
        ("${now()}", "2026-05-31T08:00:00+02:00"),
        ("${dateTime().plusMonths(1).plusDays(1).toDate()}", "2026-07-01T08:00:00+02:00"),
        ("${since.minusHours(9)}", "2026-04-30T23:00:00Z"),
        ("${dateTime().withTimeAtStartOfDay().toString()}", "2026-05-31T00:00:00+02:00"),
        ("Hello ${name}!", "Hello Ada!"),
        ("${name}${score}", "Ada4"),
        ("${nothing}#{approved}", "true"),
        ("\\${name} is ${name}", "${name} is Ada"),
        ("{${order.lines}}", '{[{"part": "gear", "count": 2}]}'),
        ("  ${score}\n", 4),
    ],
)
def test_an_expression_has_its_value(text: str, value: object) -> None:
    result = read_juel(text).value(ORDER)
    assert result == value
    assert type(result) is type(value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("approved", "no JUEL expression"),
        ("", "no JUEL expression"),
        ("\\${approved}", "no JUEL expression"),
        ("${}", 'position 3: expected a value instead of "}"'),
        ("${approved", 'expected an operator or "}" instead of the end'),
        ("${1 +}", 'position 6: expected a value instead of "}"'),
        ("${a b}", 'position 5: expected an operator or "}" instead of "b"'),
        ("${(a}", 'expected ")" instead of "}"'),
        ("${a ? b}", 'expected ":"'),
        ("${'a}", "has no end"),
        ("${a = b}", "'=' is not part of the language"),
        ("${a.}", 'expected a name instead of "}"'),
        ("${bean.invoke(a)}", "position 8: the method .invoke() is not supported"),
        ("${helper()}", "the function helper() is not supported; functions are: JSON, S, dateTime, now"),
        ("${now(1)}", "now() has 0 arguments, not 1"),
        ("${execution}", "is no value"),
        ("${execution.engine}", "execution.engine is not supported"),
        ("${execution.setVariable('a', 1)}", "side effect"),
        ("${execution.getProcessEngineServices()}", "execution.getProcessEngineServices() is not supported"),
        ("${" + "(" * 100, "nested at most"),
        ("${" + "-" * 100 + "a}", "nested at most"),
        ("${" + "a+" * 3000 + "a}", "at most 2000 parts"),
        ("${'" + "x" * MAX_CHARACTERS + "'}", "at most 10000 characters"),
        ("${12345678901234567890}", "a number is too large"),
    ],
)
def test_an_invalid_expression_is_refused_with_position_and_reason(text: str, reason: str) -> None:
    with pytest.raises(ExpressionError) as refusal:
        read_juel(text)
    assert reason in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("${missing}", 'there is no variable "missing"; variables are: approved, document,'),
        ("${name + 1}", 'not the text "Ada"; `+=` or .concat() joins texts'),
        ("${score && true}", "a condition needs true or false, not a number"),
        ("${!items}", "not a list"),
        ("${name == 4}", 'not the text "Ada"'),
        ("${items < order}", "cannot order a list and an object"),
        ("${score / 0}", "division by zero"),
        ("${score % 0}", "division by zero"),
        ("${9007199254740992 * 9007199254740992}", "too large"),
        ("${1e300 * 1e300}", "finite"),
        ("${score.part}", 'a number has no property "part"'),
        ("${items.get(2)}", "a list of 2 has no item 2"),
        ("${items['x']}", 'not the text "x"'),
        ("${items[0.5]}", "whole number"),
        ("${score.startsWith('4')}", "a number has no method .startsWith()"),
        ("${nothing.trim()}", "null has no method .trim()"),
        ("${name.substring(9)}", "position 9 is outside"),
        ("${name.substring(2, 1)}", "ends before it starts"),
        ("${name.trim(1)}", ".trim() of a text has 0 arguments, not 1"),
        ("${name.contains(1)}", "the argument is a text, not a number"),
        ("${name.split('a|b')}", "not a regular expression"),
        ("${order.prop('none')}", 'no "none" in the object; it has: id, lines, open, total'),
        ("${order.prop('id').numberValue()}", "the JSON value is a text"),
        ("${S(name)}", "no JSON"),
        ("${name.plusDays(1)}", "no ISO 8601 date"),
        ("${since.plusDays(0.5)}", "whole number of units"),
        ("${since.plusYears(9000)}", "years 1 to 9999"),
    ],
)
def test_an_evaluation_that_fails_names_the_expression_and_the_reason(text: str, reason: str) -> None:
    with pytest.raises(ExpressionError, match=r"^`\$\{") as refusal:
        read_juel(text).value(ORDER)
    assert reason in str(refusal.value)


def test_a_template_without_expression_is_a_literal() -> None:
    assert read_template("a } plain $ text").value({}) == "a } plain $ text"
    assert read_template("\\${name}").value({}) == "${name}"
    assert read_template("Hello ${name}").value({"name": "Ada"}) == "Hello Ada"


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("${a.b[c] > d.size() ? e : true}", {"a", "c", "d", "e"}),
        ("${execution.getVariable('f') == now()}", {"f"}),
        ("${a} and #{b}", {"a", "b"}),
        ("${empty g}", {"g"}),
    ],
)
def test_an_expression_names_the_variables_it_reads(text: str, names: set[str]) -> None:
    assert read_juel(text).names() == names


def test_an_assignment_is_read_as_name_and_value() -> None:
    assignment = read_set_variable("${execution.setVariable('total', price * 2)}")
    assert assignment is not None
    name, expression = assignment
    assert (name, expression.value({"price": 4}), expression.names()) == ("total", 8, {"price"})
    assert read_set_variable("${price}") is None
    with pytest.raises(ExpressionError, match=r"position .*expected a text in quotes"):
        read_set_variable("${execution.setVariable(total, 1)}")
    with pytest.raises(ExpressionError, match=r"nothing can follow"):
        read_set_variable("${execution.setVariable('total', 1)}!")


def test_a_text_that_grows_beyond_the_limit_is_refused() -> None:
    long = "x" * 600_000
    for text in ("${a += a}", "${a} ${a}", "${a.concat(a)}", "${a.replace('x', a)}"):
        with pytest.raises(ExpressionError, match="characters"):
            read_juel(text).value({"a": long})


VARIABLES = st.dictionaries(st.sampled_from("ab"), JSON)
PIECES = st.sampled_from(
    [
        *("a", "b", "1", "2.5", "'t'", "true", "null", "(", ")", "[", "]", ".", ",", "?", ":", " ", "!", "-"),
        *(
            "+",
            "*",
            "/",
            "%",
            "==",
            "<",
            ">=",
            "&&",
            "or",
            "empty ",
            "not ",
            "+=",
            ".size()",
            ".get(",
            "${",
            "}",
        ),
        *(".substring(", ".plusDays(", ".replace(", ".prop(", "execution", "now()", "S(", ".getX()"),
    ]
)


@settings(max_examples=4 * settings.default.max_examples)
@given(
    st.lists(PIECES, max_size=14).map("".join) | st.text(max_size=40),
    VARIABLES,
)
def test_any_text_is_an_expression_or_an_expression_error(text: str, variables: dict[str, object]) -> None:
    try:
        value = read_juel("${" + text + "}").value(variables)
    except ExpressionError as error:
        assert "cannot be evaluated" not in str(error)  # noqa: PT017 - such an error is a defect
        return
    assert within_limits(value) is value


OPERANDS = st.sampled_from(["a", "b", "1", "2.5", "-3", "'t'", "'7'", "true", "null", "a.k", "b[0]", "''"])


def _combine(parts: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    signs = st.sampled_from(["+", "-", "*", "/", "%", "==", "!=", "<", "<=", ">", ">=", "&&", "||", "+="])
    calls = st.sampled_from(
        [
            *(
                "size()",
                "get({})",
                "contains({})",
                "equals({})",
                "substring({})",
                "replace({}, {})",
                "trim()",
            ),
            *(
                "plusDays({})",
                "plusYears({})",
                "intValue()",
                "prop({})",
                "indexOf({})",
                "compareTo({})",
                "value()",
            ),
        ]
    )
    return (
        st.builds("({} {} {})".format, parts, signs, parts)
        | st.builds("({0} ? {1} : {2})".format, parts, parts, parts)
        | st.builds("{}({})".format, st.sampled_from(["empty ", "!", "-", "S", "JSON"]), parts)
        | st.builds(lambda base, call, part: f"({base}).{call.format(part, part)}", parts, calls, parts)
    )


@settings(max_examples=4 * settings.default.max_examples)
@given(st.recursive(OPERANDS, _combine, max_leaves=12), VARIABLES)
def test_any_expression_yields_json_or_an_expression_error(text: str, variables: dict[str, object]) -> None:
    try:
        value = read_juel("${" + text + "}").value(variables)
    except ExpressionError as error:
        assert "cannot be evaluated" not in str(error)  # noqa: PT017 - such an error is a defect
        return
    assert within_limits(value) is value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("${variables:get(name)}", "Ada"),
        ("${vars:get(missing)}", None),
        ("${vars:getOrDefault('missing', 3)}", 3),
        ("${var:exists(nothing) || vars:exists(missing)}", False),
        ("${vars:isEmpty(nothing) && variables:isNotEmpty(items)}", True),
        ("${variables:equals(name, 'Ada') && vars:notEquals(missing, 1)}", True),
        ("${vars:eq(text, 17) && vars:ne(score, 5)}", True),
        ("${vars:lt(score, 5) && vars:lowerThanOrEquals(score, 4)}", True),
        ("${vars:gte(score, 4) && vars:greaterThan(score, 3)}", True),
        ("${vars:gt(missing, 3)}", False),
        ("${vars:contains(items, 'gear', 'shaft') && !vars:contains(items, 'nut', 'gear')}", True),
        ("${vars:containsAny(name, 'x', 'd')}", True),
        ("${approved ? vars : name}", 1),
    ],
)
def test_functions_of_flowable_read_variables_that_may_be_missing(text: str, value: object) -> None:
    assert read_juel(text).value({**ORDER, "vars": 1}) == value


@pytest.mark.parametrize(
    "text", ["${vars:eq(name)}", "${vars:get(name, 1)}", "${vars:get(1)}", "${vars:other(x)}"]
)
def test_a_wrong_function_of_flowable_is_an_error(text: str) -> None:
    with pytest.raises(ExpressionError):
        read_juel(text)
