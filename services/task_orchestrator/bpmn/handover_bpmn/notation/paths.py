"""Paths: which nodes every path to a node passes."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

_ENTRY = ""
"""A node before all starts; no node of a process has this id."""


@dataclass(frozen=True)
class Dominators:
    """A node dominates another if every path from the starts to the other passes it.

    The dominators of a node are its ancestors in a tree; `first` and `last` number the tree so that the
    descendants of a node are those between its two numbers.
    """

    first: Mapping[str, int]
    last: Mapping[str, int]

    def dominates(self, dominator: str, other: str) -> bool:
        """Return whether every path to `other` passes `one`; False for nodes that cannot be reached."""
        if dominator not in self.first or other not in self.first:
            return False
        return self.first[dominator] <= self.first[other] <= self.last[dominator]


def dominators(successors: Callable[[str], Iterable[str]], starts: Iterable[str]) -> Dominators:
    """Return the dominators of all nodes that can be reached from `starts`.

    The algorithm is that of Cooper, Harvey and Kennedy (A Simple, Fast Dominance Algorithm, 2001): visit the
    nodes in reverse postorder, and set the parent of each to the nearest common ancestor of its predecessors,
    until nothing changes. For a -> b -> d and a -> c -> d the parent of b, c and d is a.
    """
    entered = list(starts)
    graph: dict[str, list[str]] = {_ENTRY: entered}
    order: list[str] = []
    stack: list[tuple[str, Iterator[str]]] = [(_ENTRY, iter(entered))]
    while stack:
        node, following = stack[-1]
        for successor in following:
            if successor not in graph:
                graph[successor] = list(successors(successor))
                stack.append((successor, iter(graph[successor])))
                break
        else:
            order.append(node)
            stack.pop()
    order.reverse()
    number = {node: nth for nth, node in enumerate(order)}
    predecessors: dict[str, list[str]] = {node: [] for node in order}
    for node in order:
        for successor in graph[node]:
            predecessors[successor].append(node)
    parents = {_ENTRY: _ENTRY}
    changed = True
    while changed:
        changed = False
        for node in order[1:]:
            reached = [name for name in predecessors[node] if name in parents]
            parent = reached[0]
            for predecessor in reached[1:]:
                parent = _common(parent, predecessor, parents, number)
            if parents.get(node) != parent:
                parents[node] = parent
                changed = True
    return _numbered(order, parents)


def _common(first: str, other: str, parents: Mapping[str, str], number: Mapping[str, int]) -> str:
    while first != other:
        while number[first] > number[other]:
            first = parents[first]
        while number[other] > number[first]:
            other = parents[other]
    return first


def _numbered(order: list[str], parents: Mapping[str, str]) -> Dominators:
    below: dict[str, list[str]] = {node: [] for node in order}
    for node in order[1:]:
        below[parents[node]].append(node)
    first: dict[str, int] = {}
    last: dict[str, int] = {}
    stack = [(_ENTRY, False)]
    while stack:
        node, is_done = stack.pop()
        if is_done:
            last[node] = len(first) - 1
        else:
            first[node] = len(first)
            stack.append((node, True))
            stack += [(descendant, False) for descendant in below[node]]
    return Dominators(first, last)
