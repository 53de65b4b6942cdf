"""The query language: parsed as specified, refused with the position and the reason."""

import json
import operator
from math import inf
from typing import Any

import orjson
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.model.entity import Entity
from handover_broker.query.indexes.attribute_index import AttributeIndex, ids_of
from handover_broker.query.indexes.q_index import Equality, Range, conditions, scalars
from handover_broker.query.q_grammar import (
    And,
    Compare,
    Exists,
    LinkPath,
    Literal,
    LiteralKind,
    Matches,
    Or,
    Path,
    Span,
    parse,
    paths,
)
from handover_broker.query.q_match import no_lookup, predicate

VOCAB = "https://a.example/"


def expand(name: str) -> str:
    return name if ":" in name else VOCAB + name


def number(value: float) -> Literal:
    return Literal(LiteralKind.NUMBER, value)


def text(value: str) -> Literal:
    return Literal(LiteralKind.TEXT, value)


def test_and_binds_tighter_than_or() -> None:
    assert parse("a;b|c") == Or((And((Exists(Path(("a",))), Exists(Path(("b",))))), Exists(Path(("c",)))))
    assert parse("a;(b|c)") == And((Exists(Path(("a",))), Or((Exists(Path(("b",))), Exists(Path(("c",)))))))


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("5", number(5)),
        ("-0.5", number(-0.5)),
        ("1e3", number(1000.0)),
        ("true", Literal(LiteralKind.TRUTH, True)),
        ("false", Literal(LiteralKind.TRUTH, False)),
        ('"true"', text("true")),
        ('"a;b|c)"', text("a;b|c)")),
        (r'"say \"hello\""', text('say "hello"')),
        ('"erä"', text("erä")),
        ("urn:ngsi-ld:Task:demo:1", Literal(LiteralKind.URI, "urn:ngsi-ld:Task:demo:1")),
        ("2026-01-01T00:00:00Z", Literal(LiteralKind.TIME, 1767225600.0)),
        ("2026-01-01", Literal(LiteralKind.TIME, 1767225600.0)),
        ("12:30:00Z", Literal(LiteralKind.TIME, "12:30:00Z")),
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
        assert first.pattern.text == "^(b|c)"
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
        "a{",
        "a{}",
        "a{b",
        "a{b}}",
        "a{b}.c",
        "a{T:}",
        "a{T,b}",
        "a{b==1}",
        "(" * 60 + "a" + ")" * 60,
        "a" * 30_000,
    ],
)
def test_an_invalid_query_is_refused_with_the_reason_and_position(written: str) -> None:
    with pytest.raises(Problem) as refused:
        parse(written)
    assert refused.value.status == 400
    assert refused.value.detail.startswith("q ")


SIGNS = st.sampled_from(
    [
        *'ab.[](),;|=<>!~"\\ 019-:*?+{}^$é_',
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
    asked=st.sampled_from(["==1", "==2,1", '=="a"', "==true", "==urn:x:1", "==0..1", ">0", "<=1", ">=2;a<2"]),
)
def test_conditions_for_an_index_hold_of_every_hit(values: list[object], asked: str) -> None:
    instances = [
        {"type": "Property", "value": value, "datasetId": f"urn:x:{place}"}
        for place, value in enumerate(values)
    ]
    attributes = {VOCAB + "a": instances} if instances else {}
    entity = Entity("urn:x:1", ("urn:t",), attributes, "", "")
    tree = parse(f"a{asked};a")
    promised = conditions(tree, expand)
    assert promised
    if predicate(tree, expand)(entity):
        index = AttributeIndex(VOCAB + "a", [entity])
        assert all(list(ids_of(index.found(one))) == ["urn:x:1"] for one in promised)


NUMBERS = (
    st.integers(2**53 - 2, 2**53 + 2)
    | st.integers(2**64 - 3, 2**64 + 3)
    | st.integers(-(2**63) - 3, -(2**63) + 3)
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
)
RELATIONS = {
    "==": operator.eq, "!=": operator.ne, ">": operator.gt, ">=": operator.ge, "<": operator.lt,
    "<=": operator.le,
}  # fmt: skip


@given(NUMBERS, NUMBERS, st.sampled_from(sorted(RELATIONS)))
@example(2**53 + 1, 2**53, "!=")
@example(2**53 + 1, 2**53 + 1, "!=")
@example(2**70, 2**70, "==")
def test_numbers_are_compared_as_they_were_sent(sent: float, wanted: float, relation: str) -> None:
    """Also those that a double does not hold; a body and a query are read alike."""
    value, other = (orjson.loads(json.dumps(number)) for number in (sent, wanted))
    asked = parse(f"a{relation}{json.dumps(wanted)}")
    attributes = {VOCAB + "a": [{"type": "Property", "value": value}]}
    thing = Entity("urn:x:1", ("urn:t",), attributes, "", "")
    expected = RELATIONS[relation](value, other)
    assert predicate(asked, expand)(thing) is expected
    for condition in conditions(asked, expand):
        found = list(ids_of(AttributeIndex(condition.attribute, [thing]).found(condition)))
        assert found or not expected


def test_a_range_has_whole_and_other_numbers() -> None:
    assert parse("a==1..2.5") == Compare(Path(("a",)), "==", (Span(number(1), number(2.5)),))


def test_only_what_an_index_can_answer_becomes_a_condition() -> None:
    assert conditions(parse('b>1;a=="x"'), expand) == (
        Range(VOCAB + "b", 1, inf),
        Equality(VOCAB + "a", frozenset({"x"})),
    )
    assert conditions(parse("a==1..2"), expand) == (Range(VOCAB + "a", 1, 2),)
    for written in (
        "a!=1",
        "a|b==1",
        "a.b==1",
        "a[b]==1",
        "a{b}==1",
        'a>"x"',
        "a==2026-01-01T00:00:00Z",
        "createdAt==1",
    ):
        assert conditions(parse(written), expand) == (), written


OPERATIONS = st.lists(st.tuples(st.integers(0, 3), st.lists(PLAIN, max_size=3)), max_size=12)


@given(OPERATIONS, st.integers(-3, 3), st.integers(-3, 3))
def test_an_updated_index_equals_a_rebuilt_one(
    changes: list[tuple[int, list[object]]], low: int, high: int
) -> None:
    kept = AttributeIndex(VOCAB + "a", [])
    wanted = Range(VOCAB + "a", low, high)
    entities: dict[int, Entity] = {}
    for number, values in changes:
        kept.found(wanted)
        instances = [{"type": "Property", "value": value} for value in values]
        after = Entity(f"urn:x:{number}", ("urn:t",), {VOCAB + "a": instances}, "", "") if values else None
        kept.refile(entities.get(number), after)
        entities.pop(number, None)
        if after is not None:
            entities[number] = after
    fresh = AttributeIndex(VOCAB + "a", entities.values())
    for one in (wanted, Equality(VOCAB + "a", frozenset({low, "a"}))):
        assert set(ids_of(kept.found(one))) == set(ids_of(fresh.found(one)))
    assert set(ids_of(fresh.found(wanted))) == {
        one.id
        for one in entities.values()
        if any(
            isinstance(value, int) and low <= value <= high for value in scalars(one.attributes[VOCAB + "a"])
        )
    }


def test_a_path_goes_through_relationships_into_other_entities() -> None:
    tree = parse("sensor{Device,Thing:humidity.accuracy}==40")
    assert tree == Compare(
        Path(("sensor",), (), LinkPath(("Device", "Thing"), Path(("humidity", "accuracy")))),
        "==",
        (number(40),),
    )
    assert next(paths(parse("a{b{c[d]}}"))).hops == 2
    assert parse("a{b}") == Exists(Path(("a",), (), LinkPath((), Path(("b",)))))


def things() -> dict[str, Entity]:
    def entity(ident: str, kind: str, **attributes: dict[str, Any]) -> Entity:
        found = {VOCAB + key: [value] for key, value in attributes.items()}
        return Entity(f"urn:x:{ident}", (VOCAB + kind,), found, "", "")

    def link(*names: str) -> dict[str, Any]:
        targets = [f"urn:x:{name}" for name in names]
        return {"type": "Relationship", "object": targets if len(targets) > 1 else targets[0]}

    def value(said: object) -> dict[str, Any]:
        return {"type": "Property", "value": said}

    many = {"type": "ListRelationship", "objectList": [{"object": "urn:x:b"}, {"object": "urn:x:c"}]}
    found = (
        entity("a", "Room", sensor=link("b"), both=link("b", "c"), many=many, gone=link("d")),
        entity("b", "Device", humidity=value(40), next=link("c")),
        entity("c", "Valve", name=value("main"), next=link("a")),
    )
    return {one.id: one for one in found}


@pytest.mark.parametrize(
    ("written", "holds"),
    [
        ("sensor{humidity}==40", True),
        ("sensor{humidity}>40", False),
        ("sensor{Device:humidity}==40", True),
        ("sensor{Valve:humidity}==40", False),
        ("sensor{Valve,Device:humidity}==40", True),
        ("sensor{humidity}", True),
        ("sensor{name}", False),
        ("both{humidity}==40;both{name}==\"main\"", True),
        ("many{name}==\"main\"", True),
        ("sensor{next{name}}==\"main\"", True),
        ("sensor{next{next{sensor}}}==urn:x:b", True),
        ("gone{name}", False),
        ("sensor{humidity}!=41", True),
        ("gone{name}!=\"main\"", False),
    ],
)  # fmt: skip
def test_linked_entities_can_be_queried(written: str, holds: bool) -> None:
    entities = things()
    question = predicate(parse(written), expand)
    assert question(entities["urn:x:a"], entities.get) is holds
    assert question(entities["urn:x:a"], no_lookup) is False


@pytest.mark.parametrize(
    ("written", "holds"),
    [
        ("color==red", True),
        ('color=="red"', True),
        ("color!=red", False),
        ("color==blue,red", True),
        ("color==blue", False),
        ("color==https://a.example/red", True),
    ],
)
def test_terms_are_expanded_on_request(written: str, holds: bool) -> None:
    instance = {"type": "VocabProperty", "vocab": VOCAB + "red"}
    entity = Entity("urn:x:1", ("urn:t",), {VOCAB + "color": [instance]}, "", "")
    assert predicate(parse(written, {"color"}), expand)(entity) is holds
    assert not predicate(parse('color=="red"'), expand)(entity)
    with pytest.raises(Problem, match="double quotes"):
        parse("color==red")


@pytest.mark.parametrize(
    ("written", "holds"),
    [
        ("owner==urn:x:2", True),
        ('owner=="urn:x:2"', True),
        ("owner!=urn:x:3", True),
        ('owner>"urn:a"', False),
        ("owner~=urn", False),
        ("owner!~=other", False),
        ("size!~=a", False),
        ("size!=\"3\"", True),
        ("word[en]==\"red\"", True),
        ("word[en]==\"rouge\"", False),
        ("word[*]==\"rouge\"", True),
        ("word[*]!=\"red\"", False),
        ("word[de]!=\"rot\"", False),
        ("list[1].x", False),
        ("list[1]==5", True),
        ("list[7]", False),
        ("at==12:30:00Z", True),
        ("at>12:00:00", True),
        ("at<12:00:00.5Z", False),
    ],
)  # fmt: skip
def test_kinds_of_values_are_compared_as_the_standard_has_it(written: str, holds: bool) -> None:
    def value(said: object) -> list[dict[str, Any]]:
        return [{"type": "Property", "value": said}]

    words: dict[str, Any] = {
        "type": "LanguageProperty",
        "languageMap": {"en": ["red", "ruby"], "fr": "rouge"},
    }
    attributes: dict[str, list[dict[str, Any]]] = {
        VOCAB + "owner": [{"type": "Relationship", "object": "urn:x:2"}],
        VOCAB + "size": value(3),
        VOCAB + "word": [words],
        VOCAB + "list": value([4, 5]),
        VOCAB + "at": value({"@type": "Time", "@value": "12:30:00Z"}),
    }
    entity = Entity("urn:x:1", ("urn:t",), attributes, "", "")
    if written == "list[1].x":
        with pytest.raises(Problem):
            parse(written)
        return
    assert predicate(parse(written), expand)(entity) is holds
