"""FEEL, the expressions of Camunda 8: values, null, errors, limits and the budget of an evaluation."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_bpmn.languages.base import NOW, ExpressionError, within_limits
from handover_bpmn.languages.feel import read_feel
from handover_bpmn.languages.feel.functions import FUNCTIONS
from handover_bpmn.languages.tokens import MAX_CHARACTERS
from services.task_orchestrator.tests.unit.bpmn.languages.values import JSON

ORDER = {
    "approved": True,
    "score": 4,
    "name": "Ada",
    "nothing": None,
    "numbers": [1, 2, 3, 4],
    "order": {
        "id": "o-1",
        "total": 12.5,
        "lines": [{"part": "gear", "count": 2}, {"part": "shaft", "count": 5}],
    },
    "due": "2026-06-01T08:00:00Z",
    "item name": "x",
    NOW: "2026-05-31T08:00:00+02:00",
}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("= score > 3", True),
        ("score > 3", True),
        ("=approved and score <= 4 or nothing", True),
        ('name = "Ada"', True),
        ('name != "Bob"', True),
        ("not(approved)", False),
        ("not (nothing)", None),
        ("missing", None),
        ("missing.part[1]", None),
        ("missing = null", True),
        ("score = null", False),
        ('score = "4"', None),
        ('score < "4"', None),
        ("nothing + 1", None),
        ('name + " Lovelace"', "Ada Lovelace"),
        ("name + 1", None),
        ("false and nothing", False),
        ("true and nothing", None),
        ("true or nothing", True),
        ("false or nothing", None),
        ("2 + 3 * 4 - 6 / 4", 12.5),
        ("6 / 3", 2),
        ("1 / 0", None),
        ("(2 + 3) * 4", 20),
        ("10 - 4 - 3", 3),
        ("-score + 1", -3),
        ("2 ** 3", 8),
        (".5 + 1e2", 100.5),
        ("if score > 3 then \"high\" else if score > 1 then \"middle\" else \"low\"", "high"),
        ("if nothing then 1 else 2", 2),
        ("score between 1 and 4 and approved", True),
        ("score in [1..4]", True),
        ("score in [1..4)", False),
        ("score in (4..9]", False),
        ("score in ]4..9[", False),
        ("score in (1, 4)", True),
        ("score in (< 2, > 3)", True),
        ("score in > 5", False),
        ("score in numbers", True),
        ("[1, [2, 3]]", [1, [2, 3]]),
        ("[]", []),
        ('{a: 1, "b c": a + 1}', {"a": 1, "b c": 2}),
        ("{a: 1, b: {c: a}}.b.c", 1),
        ("{}", {}),
        ("order.lines.part", ["gear", "shaft"]),
        ("order.lines[count > 2].part", ["shaft"]),
        ('order.lines[part = "gear"][1].count', 2),
        ("order.lines[item.count > score].part", ["shaft"]),
        ("numbers[1]", 1),
        ("numbers[-1]", 4),
        ("numbers[5]", None),
        ("numbers[0]", None),
        ("numbers[item > 2]", [3, 4]),
        ("numbers[even(item)]", [2, 4]),
        ("score[1]", 4),
        ("`item name`", "x"),
        ("for n in numbers return n * 2", [2, 4, 6, 8]),
        ("for a in 1..2, b in [a, 10] return a * b", [1, 10, 4, 20]),
        ("for a in 3..1 return a", [3, 2, 1]),
        ("for n in [1..3] return n", [1, 2, 3]),
        ("some n in numbers satisfies n > 3", True),
        ("every n in numbers satisfies n > 3", False),
        ("every n in [] satisfies n > 3", True),
        ("count(numbers) + sum(numbers)", 14),
        ("sum(1, 2, 3)", 6),
        ("min(numbers) + max(1, 7)", 8),
        ("mean(numbers)", 2.5),
        ("sum([])", None),
        ('min(["b", "a"])', "a"),
        ("all([true, nothing])", None),
        ("any(false, true)", True),
        ("append(numbers, 5, 6)", [1, 2, 3, 4, 5, 6]),
        ("concatenate([1], [2], [3])", [1, 2, 3]),
        ("union([1, 2], [2, 3])", [1, 2, 3]),
        ("distinct values([1, 1.0, true])", [1, True]),
        ("flatten([1, [2, [3]]])", [1, 2, 3]),
        ("reverse(numbers)", [4, 3, 2, 1]),
        ("sublist(numbers, 2, 2)", [2, 3]),
        ("remove(numbers, 1)", [2, 3, 4]),
        ("insert before(numbers, 1, 0)", [0, 1, 2, 3, 4]),
        ("index of([1, 2, 1], 1)", [1, 3]),
        ("list contains(numbers, 3)", True),
        ("list  contains (numbers, 9)", False),
        ("is empty([])", True),
        ('contains(name, "d") and starts with(name, "A") and ends with(name, "a")', True),
        ("upper case(name) + lower case(name)", "ADAada"),
        ('substring("hello", 2, 3)', "ell"),
        ('substring("hello", -2)', "lo"),
        ('substring before("a-b", "-") + substring after("a-b", "-")', "ab"),
        ("string length(name)", 3),
        ('trim("  x ")', "x"),
        ('matches(name, "^A.a$")', True),
        ("[1] instance of list and not(null instance of number)", True),
        ("today() instance of date and now() instance of date  and time", True),
        ('duration("PT1H") instance of days and time duration', True),
        ('replace("a-b-c", "-", "+")', "a+b+c"),
        ('split("a;b", ";")', ["a", "b"]),
        ('string join(["a", nothing, "b"], ", ")', "a, b"),
        ('string(1.5) + string(true) + string([1])', "1.5true[1]"),
        ('number("12") + number("1.5")', 13.5),
        ('number("x")', None),
        ("contains(score, 1)", None),
        ("floor(-1.5) + ceiling(1.2)", 0),
        ("round half up(2.5, 0) + round up(1.2, 0) + round down(1.8, 0)", 6),
        ("decimal(1.125, 2)", 1.12),
        ("abs(-3) + modulo(-7, 4)", 4),
        ("sqrt(16)", 4),
        ("is defined(missing)", False),
        ("is defined(order.id)", True),
        ('get value(order, "id")', "o-1"),
        ("get or else(missing, 1)", 1),
        ("get entries({a: 1})", [{"key": "a", "value": 1}]),
        ('context put({a: 1}, "b", 2)', {"a": 1, "b": 2}),
        ("context merge([{a: 1}, {a: 2}])", {"a": 2}),
        ("now()", "2026-05-31T08:00:00+02:00"),
        ("today()", "2026-05-31"),
        ('now() + duration("P1MT1H")', "2026-06-30T09:00:00+02:00"),
        ("date and time(due) > now()", True),
        ("date and time(due) - now()", "P1DT2H"),
        ('date("2026-05-31") + @"P1D"', "2026-06-01"),
        ("date(2026, 5, 31).month", 5),
        ('date("2026-13-01")', None),
        ('date("2026-05-31") - date("2026-06-01")', "-P1D"),
        ('duration("PT90M").hours', 1),
        ('duration("PT1H") * 1.5', "PT1H30M"),
        ('duration("P1Y") + duration("P2M")', "P1Y2M"),
        ('-duration("PT0.5S")', "-PT0.5S"),
        ('day of week(date("2026-05-31")) + month of year(today())', "SundayMay"),
        ('@"2026-05-31T08:00:00Z".hour', 8),
        ("1 /* one */ + 2 // three", 3),
    ],
)  # fmt: skip
def test_an_expression_has_its_value(text: str, value: object) -> None:
    result = read_feel(text).value(ORDER)
    assert result == value
    assert type(result) is type(value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "position 1: expected a value instead of the end"),
        ("=", "position 2: expected a value instead of the end"),
        ("1 +", "position 4: expected a value instead of the end"),
        ("a b", 'position 3: expected an operator or the end instead of "b"'),
        ("a == b", 'expected a value instead of "="'),
        ("a < b < c", 'expected an operator or the end instead of "<"'),
        ("(a", 'expected ")" instead of the end'),
        ("[1, 2", 'expected "]" instead of the end'),
        ("[1..2", 'expected "]" or ")" instead of the end'),
        ("{a 1}", 'expected ":" instead of "1"'),
        ("if a then b", 'expected "else"'),
        ("for a return b", 'expected "in" instead of "return"'),
        ("some a in b", 'expected "satisfies"'),
        ("'text'", "no end"),
        ('"text', "no end"),
        ("a ? b : c", "'?' is not part of the language"),
        ("a.1", 'position 2: expected an operator or the end instead of ".1"'),
        ("a.+", 'expected a name instead of "+"'),
        ("and", 'expected a value instead of "and"'),
        ("a && b", "'&' is not part of the language"),
        ("a instance of bean", "types are: Any, null, number"),
        ("sort(a, b)", "the function sort() is not supported"),
        ("count()", "count() has 1 arguments, not 0"),
        ("substring(a, 1, 2, 3)", "2 to 3 arguments, not 4"),
        ('substring(string: "a", start position: 1)', "named arguments are not supported"),
        ('@"soon"', "no ISO 8601 date"),
        ("function(a) a + 1", 'expected a value instead of "function"'),
        ("(" * 100, "nested at most"),
        ("-" * 100 + "a", "nested at most"),
        ("[" * 100, "nested at most"),
        ("a+" * 3000 + "a", "at most 2000 parts"),
        ('"' + "x" * MAX_CHARACTERS + '"', "at most 10000 characters"),
        ("12345678901234567890", "a number is too large"),
        ("1e999", "a number is too large"),
    ],
)
def test_an_invalid_expression_is_refused_with_position_and_reason(text: str, reason: str) -> None:
    with pytest.raises(ExpressionError) as refusal:
        read_feel(text)
    assert reason in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("9007199254740992 * 9007199254740992", "too large"),
        ("1e300 * 1e300", "finite"),
        ("10 ** 400", "too large"),
        ('now() + duration("P9000Y")', "years 1 to 9999"),
        ("for i in 1..1000000000000 return i", "stopped after 200000 steps"),
        ("for i in 1..1000, j in 1..1000 return i", "stopped after"),
        ("some i in 1..1000, j in 1..1000 satisfies i + j < 0", "stopped after"),
        ("count([1..1000000][item > 0])", "stopped after"),
        ("for i in 1..2000 return count(for j in 1..2000 return j)", "stopped after"),
        ("for i in 1..10000 return list contains(long, 0)", "stopped after"),
        ("for i in 1..10000 return long = long", "stopped after"),
        ("count(for i in 1..10000 return text + text)", "stopped after"),
        ("for i in 1..100000 return long", "stopped after"),
        ("for i in 1..10000 return string([long])", "stopped after"),
        ("string(for i in 1..5000 return text)", "stopped after"),
        ("for i in 1..20000 return i", "at most 10000 items"),
        ("text + text + text", "characters"),
        ('matches(text, "x")', "at most 10000 characters"),
        ('matches("x", "(")', "invalid for RE2"),
        ('matches("x", "(((x{30}){30}){30})")', "RE2"),
        ('matches("x", "(?:abcdefgh){100}")', "at most 500 steps"),
        ('replace(many, "x", many)', "characters"),
        ('replace(text, "x", "y")', "at most 10000 characters"),
        ('string join([text, text, text], "")', "characters"),
    ],
)
def test_an_evaluation_beyond_a_limit_is_stopped_with_the_reason(text: str, reason: str) -> None:
    variables = {**ORDER, "long": list(range(1, 9000)), "text": "x" * 250_000, "many": "x" * 9_000}
    with pytest.raises(ExpressionError) as refusal:
        read_feel(text).value(variables)
    assert reason in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("a.b + c[d > item] * count(e)", {"a", "c", "d", "e"}),
        ("for f in g return f + h", {"g", "h"}),
        ("{i: j, k: i}", {"j"}),
        ("now() > date and time(l)", {"l"}),
        ("for m in m return m", {"m"}),
    ],
)
def test_an_expression_names_the_variables_it_reads(text: str, names: set[str]) -> None:
    assert read_feel(text).names() == names


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("for i in 0..4 return if i = 0 then 1 else i * partial[-1]", [1, 1, 2, 6, 24]),
        ("for a in 1..2, b in 1..2 return count(partial)", [0, 1, 2, 3]),
        ("for a in 1..2 return for b in 1..2 return count(partial)", [[0, 1], [0, 1]]),
        ("for partial in 1..2 return partial", [1, 2]),
        ("for a in 1..3 return partial", [[], [[]], [[], [[]]]]),
        ('for d in @"2026-02-28"..@"2026-03-01" return d', ["2026-02-28", "2026-03-01"]),
        ('for d in (@"2026-03-02"..@"2026-02-28") return d', ["2026-03-01"]),
        ('[@"2026-02-28"..@"2026-03-01"][item.day = 1]', ["2026-03-01"]),
        ("for x in missing return x", None),
        ("some x in missing satisfies x", None),
        ("every x in missing satisfies x", None),
        ("[1..3].start + [1..3].end", 4),
        ('duration("P1D") / duration("PT1H")', 24),
        ('duration("PT90M") / duration("PT1H")', 1.5),
        ('duration("-P1Y") / duration("P1M")', -12),
        ('duration("P1Y") / duration("P1D")', None),
        ('duration("P1D") / duration("PT0S")', None),
        ("[{item: 1}, {item: 2}][item > 1]", [{"item": 2}]),
        ('[{k: 1}, {k: 2}][item.k > 1]', [{"k": 2}]),
        ('context put({a: 1}, ["b", "c"], 2)', {"a": 1, "b": {"c": 2}}),
        ('context put({a: {b: 1, c: 2}}, ["a", "b"], 3)', {"a": {"b": 3, "c": 2}}),
        ('context put({a: 1}, [], 2)', None),
        ('get value({a: {b: 1}}, ["a", "b"])', 1),
        ('get value({a: {b: 1}}, ["a", "c", "d"])', None),
        ('get value({a: 1}, [])', None),
        ('replace("abcd", "(ab)|(a)", "[1=$1][2=$2]")', "[1=ab][2=]cd"),
        (r'replace("0123456789", "(\d{3})(\d{3})(\d{4})", "($1) $2-$3")', "(012) 345-6789"),
        ('replace("How do you feel?", "Feel", "FEEL", "i")', "How do you FEEL?"),
        (r'replace("a.b", "\\.", "\\$$0")', "a$.b"),
        ('replace("aaa", "", "-")', "-a-a-a-"),
        (r'split("John Doe", "\s")', ["John", "Doe"]),
        ('split("a;b;c;;", ";")', ["a", "b", "c", "", ""]),
        (r'split("a|b", "\|")', ["a", "b"]),
        ('split("a, b,c", ", *")', ["a", "b", "c"]),
        ('matches("FooBar", "foo", "i")', True),
        ('substring before("abc", "")', ""),
        ('substring after("abc", "")', "abc"),
        ('substring after("abc", "x")', ""),
        (r'"\ud83d\ude00" + "\u0041\U01F600"', "\U0001f600A\U0001f600"),
    ],
)  # fmt: skip
def test_a_construct_of_camunda_8_and_dmn_has_its_value(text: str, value: object) -> None:
    assert read_feel(text).value({}) == value


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("for x in 1..1.5 return x", "a range from 1 to 1.5"),
        ("for x in 1..missing return x", "a range from 1 to null"),
        ('some x in ["a".."c"] satisfies true', "a range from 'a' to 'c'"),
        ("for x in [now()..now()] return x", "a range from"),
        ("now().timezone", ".timezone"),
        ('date and time("2026-05-01T08:00:00@Europe/Berlin")', "time zone"),
        ('split("a|b", "|")', "split()"),
        ('replace("a", "a", "$1")', "$1"),
        ('replace("a", "(?=a)", "b")', "RE2"),
        ('matches("a", "a", "x")', 'the flag "x"'),
        (
            'years and months duration(@"2026-05-01T08:00:00", @"2026-06-01T08:00:00Z")',
            "years and months duration()",
        ),
        (
            'years and months duration(@"2026-05-01", @"2026-06-01T08:00:00Z")',
            "years and months duration()",
        ),
        ("to base64(half)", "surrogate"),
        ("context put({}, half, 1)", "surrogate"),
    ],
)
def test_what_has_no_value_is_an_error_that_names_it_and_never_null(text: str, named: str) -> None:
    with pytest.raises(ExpressionError) as refusal:
        read_feel(text).value({"half": "\ud800"})
    assert named in str(refusal.value)


def test_half_of_a_surrogate_pair_is_refused_where_it_is_written() -> None:
    with pytest.raises(ExpressionError, match="lone surrogate"):
        read_feel(r'to base64("\ud800")')


VARIABLES = st.dictionaries(st.sampled_from("ab"), JSON)
PIECES = st.sampled_from(
    [
        *("a", "b", "1", "2.5", '"t"', "true", "null", "(", ")", "[", "]", ".", ",", "..", ":", " ", "-"),
        *("{", "}", "+", "*", "/", "**", "=", "<", ">=", " and ", " or ", "not(", " in ", " between "),
        *("for a in ", " return ", "some b in ", " satisfies ", "if ", " then ", " else "),
        *("count(", "string(", "@", "date(", "sum("),
    ]
)


@settings(max_examples=4 * settings.default.max_examples)
@given(st.lists(PIECES, max_size=14).map("".join) | st.text(max_size=40), VARIABLES)
def test_any_text_is_an_expression_or_an_expression_error(text: str, variables: dict[str, object]) -> None:
    try:
        value = read_feel(text).value(variables)
    except ExpressionError:
        return
    assert within_limits(value) is value


OPERANDS = st.sampled_from(
    [
        "a",
        "b",
        "1",
        "2.5",
        "-3",
        '"t"',
        "true",
        "null",
        "a.k",
        "b[1]",
        "date(a)",
        "duration(b)",
        "[a, b, 1]",
        "now()",
        '""',
        '"(a|)"',
        '@"2026-05-01"',
        '@"2026-05-01T08:00:00"',
        '@"9999-12-31T23:59:59+02:00"',
        '@"-P9999Y"',
        "{k: a}",
    ]
)


def _combine(parts: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    signs = st.sampled_from(["+", "-", "*", "/", "**", "=", "!=", "<", "<=", "and", "or", "in"])

    return (
        st.builds("({} {} {})".format, parts, signs, parts)
        | st.builds("(if {0} then {1} else {2})".format, parts, parts, parts)
        | st.builds("({0} between {1} and {2})".format, parts, parts, parts)
        | st.builds("(for a in {} return {})".format, parts, parts)
        | st.builds("(some x in {} satisfies x = {})".format, parts, parts)
        | st.builds("({})[{}]".format, parts, parts)
        | st.builds("({}).{}".format, parts, st.sampled_from(["k", "year", "hours"]))
        | st.builds("[{}..{}]".format, parts, parts)
        | st.builds("(-{})".format, parts)
        | st.builds(
            lambda name, values: f"{name}({', '.join(values[: FUNCTIONS[name].most])})",
            st.sampled_from(sorted(FUNCTIONS)),
            st.lists(parts, min_size=3, max_size=3),
        )
    )


@settings(max_examples=6 * settings.default.max_examples)
@given(st.recursive(OPERANDS, _combine, max_leaves=12), VARIABLES)
def test_any_expression_yields_json_or_an_expression_error(text: str, variables: dict[str, object]) -> None:
    try:
        value = read_feel(text).value(variables)
    except ExpressionError as error:
        assert "cannot be evaluated" not in str(error)  # noqa: PT017 - such an error is a defect
        return
    assert within_limits(value) is value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ('cycle(3, duration("PT1H"))', "R3/PT1H"),
        ('cycle(duration("P1D"))', "R/P1D"),
        ('cycle("x", duration("P1D"))', None),
        ("cycle(3, 4)", None),
        ('is blank("  ") and not(is blank("a"))', True),
        ('to base64("gear")', "Z2Vhcg=="),
        ('from json(to json({a: [1, "x"]}))', {"a": [1, "x"]}),
        ('from json("{")', None),
        ('number("1.000,5", ".", ",")', 1000.5),
        ('number("1 000", " ")', 1000),
        ('number("1,5", ",,")', None),
        ("median([3, 1, 2])", 2),
        ("median(1, 2)", 1.5),
        ('median(["a"])', None),
        ("median([])", None),
        ("stddev([2, 4, 7, 5]) > 2.08", True),
        ("stddev([1])", None),
        ("mode([6, 3, 9, 6, 6])", [6]),
        ('mode(["a"])', None),
        ("product([2, 3, 4])", 24),
        ("product([1e200, 1e200])", None),
        ("log(1)", 0),
        ("log(0)", None),
        ("exp(0)", 1),
        ("exp(1e9)", None),
        ("partition([1, 2, 3], 2)", [[1, 2], [3]]),
        ("partition([1], 0)", None),
        ("duplicate values([1, 2, 1, 2, 1])", [1, 2]),
        ("list replace([1, 2], -1, 5)", [1, 5]),
        ("list replace([1, 2], 3, 5)", None),
        ('context([{key: "a", value: 1}])', {"a": 1}),
        ('context([{key: "a"}])', None),
        ("context merge({a: 1}, {b: 2})", {"a": 1, "b": 2}),
        ('day of year(date("2026-02-01"))', 32),
        ('week of year(date("2026-02-01"))', 5),
        ('last day of month(date("2028-02-03"))', "2028-02-29"),
        ('years and months duration(date("2024-01-31"), date("2026-03-01"))', "P2Y1M"),
        ('years and months duration(date("2026-03-01"), date("2024-03-01"))', "-P2Y"),
    ],
)
def test_a_function_of_camunda_8_has_its_value(text: str, value: object) -> None:
    assert read_feel(text).value({}) == value
