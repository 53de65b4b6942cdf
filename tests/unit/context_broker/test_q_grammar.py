"""The query language: read as the specification writes it, refused with the place and the reason."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from services.context_broker.entity import Entity
from services.context_broker.q_grammar import (
    And,
    Compare,
    Exists,
    Kind,
    Literal,
    Matches,
    Or,
    Path,
    Span,
    parse,
)
from services.context_broker.q_match import Equality, equality, predicate

VOCAB = "https://a.example/"


def expand(name: str) -> str:
    return name if ":" in name else VOCAB + name


def number(value: float) -> Literal:
    return Literal(Kind.NUMBER, value)


def text(value: str) -> Literal:
    return Literal(Kind.TEXT, value)


def test_and_binds_tighter_than_or() -> None:
    assert parse("a;b|c") == Or((And((Exists(Path(("a",))), Exists(Path(("b",))))), Exists(Path(("c",)))))
    assert parse("a;(b|c)") == And((Exists(Path(("a",))), Or((Exists(Path(("b",))), Exists(Path(("c",)))))))


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("5", number(5)),
        ("-0.5", number(-0.5)),
        ("1e3", number(1000.0)),
        ("true", Literal(Kind.TRUTH, True)),
        ("false", Literal(Kind.TRUTH, False)),
        ('"true"', text("true")),
        ('"a;b|c)"', text("a;b|c)")),
        (r'"say \"hello\""', text('say "hello"')),
        ('"erä"', text("erä")),
        ("urn:ngsi-ld:Task:demo:1", Literal(Kind.URI, "urn:ngsi-ld:Task:demo:1")),
        ("2026-01-01T00:00:00Z", Literal(Kind.TIME, 1767225600.0)),
        ("2026-01-01", Literal(Kind.TIME, 1767225600.0)),
        ("12:30:00Z", Literal(Kind.TIME, "12:30:00Z")),
        ("1..5", Span(number(1), number(5))),
        ("1.5..2.5", Span(number(1.5), number(2.5))),
        ('"a".."b"', Span(text("a"), text("b"))),
    ],
)
def test_a_value_is_what_it_looks_like(written: str, value: Literal | Span) -> None:
    assert parse(f"a=={written}") == Compare(Path(("a",)), "==", (value,))


def test_a_list_of_values_and_ranges() -> None:
    expected = (number(1), Span(number(3), number(5)), text("x"))
    assert parse('a==1,3..5,"x"') == Compare(Path(("a",)), "==", expected)


def test_paths_lead_to_attributes_of_attributes_and_into_values() -> None:
    assert parse("a.b.observedAt") == Exists(Path(("a", "b", "observedAt")))
    assert parse("a.b[c.d]>1") == Compare(Path(("a", "b"), ("c", "d")), ">", (number(1),))
    assert parse('a["c.d"]') == Exists(Path(("a",), ("c.d",)))
    assert parse("https://a.example/x.y") == Exists(Path(("https://a.example/x.y",)))
    assert parse("ex:a.b") == Exists(Path(("ex:a", "b")))


def test_patterns_end_where_their_brackets_do() -> None:
    for written in ("a~=^(b|c);d", 'a~="^(b|c)";d', "(a~=^(b|c));d"):
        tree = parse(written)
        assert isinstance(tree, And)
        first = tree.terms[0]
        assert isinstance(first, Matches)
        assert first.pattern.pattern == "^(b|c)"
    negated = parse('a!~="x"')
    assert isinstance(negated, Matches)
    assert negated.negated


@pytest.mark.parametrize(
    "written",
    [
        "",
        ";",
        "a;",
        "a|",
        "|a",
        "(a",
        "a)",
        "()",
        "a b",
        "a==",
        "a==1..",
        "a==..2",
        "a==1..true",
        'a==1.."x"',
        "a==true..false",
        "a>1,2",
        "a>1..2",
        "a==hello",
        'a=="x',
        "a[",
        "a[]",
        "a[b",
        "a[b..c]",
        "a.",
        ".a",
        "a=1",
        "a~=",
        'a~="("',
        "1==1",
        "a==2026-13-01",
        "(" * 60 + "a" + ")" * 60,
        "a" * 30_000,
    ],
)
def test_what_cannot_be_read_is_refused_with_a_reason(written: str) -> None:
    with pytest.raises(Problem) as refused:
        parse(written)
    assert refused.value.status == 400
    assert refused.value.detail.startswith("q ")


SIGNS = st.sampled_from(
    [
        *'ab.[](),;|=<>!~"\\ 019-:*?+{}^$',
        "==",
        "!=",
        ">=",
        "<=",
        "~=",
        "!~=",
        "..",
        "true",
        "urn:x:1",
        '"t"',
        "é",
    ]
)
ENTITY = Entity(
    "urn:x:1",
    ("urn:t",),
    {
        VOCAB + "a": [{"type": "Property", "value": ["a", 1, {"b": {"a": 0}}, None, True]}],
        VOCAB + "b": [
            {"type": "Property", "value": "b", VOCAB + "a": [{"type": "Property", "value": 1.5}]},
            {"type": "Relationship", "object": ["urn:x:1"], "datasetId": "urn:x:d"},
        ],
    },
    "2026-01-01T00:00:00Z",
    "2026-01-01T00:00:00Z",
)


@given(st.lists(SIGNS, max_size=25).map("".join) | st.text(max_size=40))
def test_a_query_is_answered_or_refused_but_never_breaks(written: str) -> None:
    def answer() -> int:
        try:
            return int(predicate(parse(written), expand)(ENTITY))
        except Problem as problem:
            return problem.status

    assert answer() in {True, False, 400}


PLAIN = st.one_of(
    st.integers(-3, 3),
    st.sampled_from(["a", "b", "urn:x:1"]),
    st.booleans(),
    st.lists(st.integers(0, 2), max_size=2),
)


@given(
    values=st.lists(PLAIN, max_size=4),
    wanted=st.lists(st.sampled_from(["1", "2", '"a"', "true", "urn:x:1"]), min_size=1, max_size=3),
)
def test_an_equality_for_an_index_holds_of_every_hit(values: list[object], wanted: list[str]) -> None:
    from services.context_broker.q_match import scalars

    instances = [
        {"type": "Property", "value": value, "datasetId": f"urn:x:{place}"}
        for place, value in enumerate(values)
    ]
    attributes = {VOCAB + "a": instances} if instances else {}
    entity = Entity("urn:x:1", ("urn:t",), attributes, "", "")
    tree = parse(f"a=={','.join(wanted)};a")
    promise = equality(tree, expand)
    assert promise is not None
    if predicate(tree, expand)(entity):
        assert not promise.values.isdisjoint(scalars(instances))


def test_only_what_an_index_can_answer_becomes_an_equality() -> None:
    assert equality(parse('b>1;a=="x"'), expand) == Equality(VOCAB + "a", frozenset({"x", VOCAB + "x"}))
    for written in (
        "a==1..2",
        "a!=1",
        "a|b==1",
        "a.b==1",
        "a[b]==1",
        "a==2026-01-01T00:00:00Z",
        "createdAt==1",
    ):
        assert equality(parse(written), expand) is None, written
