"""Dominators, compared with their definition."""

from hypothesis import given
from hypothesis import strategies as st

from handover_bpmn.notation.paths import dominators

NODES = st.sampled_from("abcdefgh")
GRAPHS = st.dictionaries(NODES, st.lists(NODES, max_size=4))


def reached(graph: dict[str, list[str]], starts: list[str], without: str | None = None) -> set[str]:
    found: set[str] = set()
    stack = list(starts)
    while stack:
        node = stack.pop()
        if node not in found and node != without:
            found.add(node)
            stack += graph.get(node, [])
    return found


@given(GRAPHS, st.lists(NODES, min_size=1, max_size=2, unique=True))
def test_a_node_dominates_those_that_cannot_be_reached_without_it(
    graph: dict[str, list[str]], starts: list[str]
) -> None:
    found = dominators(lambda node: graph.get(node, []), starts)
    everywhere = reached(graph, starts)
    for one in "abcdefgh":
        without = reached(graph, starts, without=one)
        for other in "abcdefgh":
            expected = one in everywhere and other in everywhere and other not in without
            assert found.dominates(one, other) is expected
