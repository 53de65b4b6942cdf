"""Type selections and scope queries, and errors in them (clauses 4.17 and 4.19)."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.query.scope_query import scope_query
from handover_broker.query.type_selection import of_types, type_selection

VOCAB = "https://a.example/"


def expand(name: str) -> str:
    return name if ":" in name else VOCAB + name


def types(*names: str) -> set[str]:
    return {VOCAB + name for name in names}


@pytest.mark.parametrize(
    ("written", "wanted", "unwanted"),
    [
        ("Home", ["Home", "Home Vehicle"], ["Vehicle"]),
        ("Home,Vehicle", ["Home", "Vehicle"], ["House"]),
        ("Home|Vehicle", ["Home", "Vehicle"], ["House"]),
        ("(Home;Vehicle)", ["Home Vehicle", "Home Vehicle Boat"], ["Home", "Vehicle"]),
        ("(Home;Vehicle)|Motorhome", ["Home Vehicle", "Motorhome"], ["Home"]),
        ("(Home;Vehicle),Motorhome", ["Home Vehicle", "Motorhome"], ["Home"]),
        ("Home;Vehicle", ["Home Vehicle"], ["Home"]),
        ("((Home,House);Vehicle)", ["Home Vehicle", "House Vehicle"], ["Home House"]),
        ("*", ["Home", "Vehicle"], []),
    ],
)
def test_types_are_chosen_by_expressions(written: str, wanted: list[str], unwanted: list[str]) -> None:
    selection = type_selection(written, expand)
    assert selection == type_selection(selection.written(), expand)
    for names in wanted:
        assert selection.wants(types(*names.split()))
    for names in unwanted:
        assert not selection.wants(types(*names.split()))


def test_a_selection_is_written_with_the_names_of_the_reader() -> None:
    selection = type_selection("(B;A)|C", expand)
    assert selection.written(lambda iri: iri.removeprefix(VOCAB)) == "(A;B),C"
    assert set(selection.names()) == types("A", "B", "C")
    assert of_types(types("C")).wants(types("C", "D"))
    assert type_selection("*", expand).is_every
    assert not selection.is_every


@pytest.mark.parametrize(
    "written", ["", "a b", "A,", ",A", "A;;B", "(A", "A)", "()", "(A;B", "A(B)", "(" * 30 + "A" + ")" * 30,
                "(A,B)" + ";(A,B)" * 20, "A" * 30_000, "*,A"]
)  # fmt: skip
def test_an_invalid_type_selection_is_refused(written: str) -> None:
    with pytest.raises(Problem) as refused:
        type_selection(written, expand)
    assert refused.value.status == 400


@pytest.mark.parametrize(
    ("written", "wanted", "unwanted"),
    [
        ("/Madrid", ["/Madrid"], ["/Madrid/Gardens", "/Paris", ""]),
        ("/Madrid/Gardens/#", ["/Madrid/Gardens", "/Madrid/Gardens/North/Bed1"], ["/Madrid", "/Madrid/A"]),
        ("/Madrid/+/North", ["/Madrid/A/North", "/Madrid/B/North"], ["/Madrid/North", "/Madrid/a/b"]),
        ("/+/+/#", ["/a/b", "/a/b/c"], ["/a"]),
        ("/#", ["/a", "/a/b"], [""]),
        ("(/Madrid/East;/CompanyA)", ["/CompanyA /Madrid/East"], ["/CompanyA", "/Madrid/East"]),
        ("(/Madrid/East;/CompanyA)|/CompanyB", ["/CompanyB"], ["/CompanyA"]),
        ("(/Madrid/East;/CompanyA),CompanyB", ["/CompanyB"], ["/CompanyA"]),
        ("/a;/b", ["/a /b"], ["/a"]),
        ("/a,/b", ["/a", "/b"], ["/c"]),
    ],
)  # fmt: skip
def test_scopes_are_chosen_by_patterns(written: str, wanted: list[str], unwanted: list[str]) -> None:
    query = scope_query(written)
    for scopes in wanted:
        assert query.wants(scopes.split())
    for scopes in unwanted:
        assert not query.wants(scopes.split())


@pytest.mark.parametrize("written", ["", "/", "//", "/a//b", "/#/a", "/a#", "/a+", "(/a", "/a,", ";", "/a/"])
def test_an_invalid_scope_query_is_refused(written: str) -> None:
    with pytest.raises(Problem, match="scopeQ") as refused:
        scope_query(written)
    assert refused.value.status == 400


@given(st.text(alphabet="ab/+#,|;() ", max_size=20))
def test_any_text_is_an_expression_or_refused(written: str) -> None:
    def status(read: Callable[[str], object]) -> int:
        try:
            read(written)
        except Problem as problem:
            return problem.status
        return 200

    assert status(scope_query) in {200, 400}
    assert status(lambda text: type_selection(text, expand)) in {200, 400}
