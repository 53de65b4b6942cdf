"""Spans: the parts of a process during which resources are reserved, and what is reserved for them.

A reservation is acquired all at once, and nothing is acquired while it is held; so reservations cannot
deadlock. Therefore spans that nest or overlap form one *union*: it is reserved when a token enters the first
of its spans, with the resources of all of them, and released when no token is left in it.

Two spans overlap if a token within the extent of one can be in the other. The extent of a span are its
members and the nodes on which its end depends: those from which a token can still reach a member of a lane,
since a lane is held until no token can return to it, and those from which tokens come for which a joining
gateway within the span waits.

For example a group holds the robot for the activities `scan` and `pick`, and a subprocess within the group
holds the scale. Both are one union: robot and scale are reserved together when a token enters the group.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from handover.messages import message
from handover_bpmn.languages.base import Json, Variables
from handover_bpmn.model import Activity, Kind, LinkEvent, MultiInstance, Node, Scope, Span, SpanKind
from handover_bpmn.references import is_reference

MAX_NEEDS = 16
"""Resources that one span may reserve."""
_JOINS = frozenset({Kind.PARALLEL, Kind.INCLUSIVE})


@dataclass(frozen=True, slots=True)
class Need:
    """One resource that a span reserves: by its id, or whichever has the role and skills."""

    resource: str | None = None
    role: str | None = None
    skills: tuple[str, ...] = ()

    @property
    def described(self) -> str:
        """Return it as it is written in a file."""
        if self.resource is not None:
            return self.resource
        role = [] if self.role is None else [f"role:{self.role}"]
        return " ".join([*role, *(f"skill:{skill}" for skill in self.skills)])


def read_needs(text: str) -> tuple[Need, ...]:
    """Return what a text such as `Device:ur10-1, role:picker skill:grip` reserves; raise `ValueError`."""
    needs = tuple(_read_need(part.split()) for part in text.split(",") if part.strip())
    if not needs:
        raise ValueError(
            message(
                "reservation.nothing",
                "a reservation names a resource (Device:ur10-1), a role (role:picker) or skills (skill:grip)",
            )
        )
    return needs


def _read_need(words: list[str]) -> Need:
    roles = [word.removeprefix("role:") for word in words if word.startswith("role:")]
    skills = tuple(word.removeprefix("skill:") for word in words if word.startswith("skill:"))
    others = [word for word in words if not word.startswith(("role:", "skill:"))]
    if len(others) == len(words) == 1 and is_reference(others[0]):
        return Need(resource=others[0])
    if others or len(roles) > 1 or "" in (*roles, *skills):
        raise ValueError(
            message(
                "reservation.unreadable",
                '"{text}" reserves nothing: write a resource (Device:ur10-1), or one role:NAME and any '
                "number of skill:NAME; a comma separates several resources",
                text=" ".join(words)[:100],
            )
        )
    return Need(role=roles[0] if roles else None, skills=skills)


def evaluated_needs(span: Span, variables: Variables) -> tuple[Need, ...]:
    """Return what a span reserves with these variables.

    Raises `ExpressionError` if a variable is missing, `ValueError` if a value names nothing to reserve.
    """
    needs = tuple(
        need for value in span.needs for text in _texts(value.value(variables)) for need in read_needs(text)
    )
    if len(needs) > MAX_NEEDS:
        raise ValueError(
            message(
                "reservation.too_many",
                '"{span}" reserves {count} resources; {limit} are possible',
                span=span.name,
                count=len(needs),
                limit=MAX_NEEDS,
            )
        )
    return needs


def _texts(value: Json) -> list[str]:
    return [str(text) for text in value] if isinstance(value, list) else ["" if value is None else str(value)]


@dataclass(frozen=True, slots=True)
class SpanUnion:
    """Spans that nest or overlap, and that are reserved together; all nodes are of one scope."""

    spans: tuple[Span, ...]
    """The outermost first."""
    entry: frozenset[str]
    """Nodes at which a token makes the reservation necessary."""
    held: frozenset[str]
    """Nodes at which a token keeps the reservation."""
    extent: frozenset[str]
    """Nodes whose activities may use what is reserved."""
    activities: tuple[Activity, ...]
    """The activities of the extent, with those of its subprocesses."""

    @property
    def id(self) -> str:
        """Return the id of its outermost span."""
        return self.spans[0].id


@dataclass(frozen=True, slots=True)
class _Placed:
    """A span, and the way from the process to its scope: each scope and the node that leads to the next."""

    span: Span
    scope: Scope
    way: tuple[tuple[Scope, Node], ...]
    extent: frozenset[str]


def find_unions(scope: Scope) -> dict[str, tuple[SpanUnion, ...]]:
    """Return the unions of a process, by the id of the scope whose nodes they have."""
    unions: dict[str, tuple[SpanUnion, ...]] = {}
    for placed in _joined(list(_placed(scope, ()))):
        anchor = min(placed, key=lambda placed_span: len(placed_span.way)).scope
        unions[anchor.id] = (*unions.get(anchor.id, ()), _union(anchor, placed))
    return unions


def spans_in_parallel_instances(scope: Scope) -> Iterator[tuple[Span, Node]]:
    """Yield the spans that are in a parallel multi-instance activity within another span, with that activity.

    They cannot be reserved with the outer one: the number of their instances is not known then.
    """
    for placed in _joined(list(_placed(scope, ()))):
        depth = min(len(placed_span.way) for placed_span in placed)
        for placed_span in placed:
            for _, node in placed_span.way[depth:]:
                if isinstance(node.loop, MultiInstance) and not node.loop.sequential:
                    yield placed_span.span, node
                    break


def predecessors(scope: Scope) -> dict[str, list[str]]:
    """Return for each node those from which a token can move to it directly."""
    sources: dict[str, list[str]] = defaultdict(list)
    links: dict[str, str] = {}
    for flow in scope.flows.values():
        sources[flow.target].append(flow.source)
    for node in scope.nodes.values():
        if node.kind is Kind.BOUNDARY_EVENT and node.attached_to is not None:
            sources[node.id].append(node.attached_to)
        elif node.kind is Kind.CATCH_EVENT and isinstance(node.event, LinkEvent):
            links[node.event.name] = node.id
    for node in scope.nodes.values():
        if node.kind is Kind.THROW_EVENT and isinstance(node.event, LinkEvent) and node.event.name in links:
            sources[links[node.event.name]].append(node.id)
    return sources


def _placed(scope: Scope, way: tuple[tuple[Scope, Node], ...]) -> Iterator[_Placed]:
    for span in scope.spans:
        yield _Placed(span, scope, way, _extent(scope, span))
    for node in scope.nodes.values():
        if node.scope is not None:
            yield from _placed(node.scope, (*way, (scope, node)))


def _extent(scope: Scope, span: Span) -> frozenset[str]:
    awaited = span.members
    if span.kind is not SpanKind.LANE:
        awaited = frozenset(name for name in span.members if scope.nodes[name].kind in _JOINS)
    return span.members | _upstream(scope, awaited)


def _upstream(scope: Scope, targets: Iterable[str]) -> frozenset[str]:
    """Return the nodes from which a token can reach one of `targets`."""
    sources = predecessors(scope)
    nodes: set[str] = set()
    stack = [source for target in targets for source in sources.get(target, ())]
    while stack:
        name = stack.pop()
        if name not in nodes:
            nodes.add(name)
            stack += sources.get(name, ())
    return frozenset(nodes)


def _joined(placed: list[_Placed]) -> list[list[_Placed]]:
    """Return the spans in sets of those that overlap directly or by others."""
    sets: list[list[_Placed]] = []
    for placed_span in placed:
        overlapping = [group for group in sets if any(_overlap(placed_span, other) for other in group)]
        sets = [group for group in sets if group not in overlapping]
        sets.append([*(other for group in overlapping for other in group), placed_span])
    return sets


def _overlap(first: _Placed, other: _Placed) -> bool:
    if len(first.way) > len(other.way):
        first, other = other, first
    if first.scope is other.scope:
        return bool(first.extent & other.span.members or other.extent & first.span.members)
    if len(first.way) == len(other.way):
        return False
    scope, node = other.way[len(first.way)]
    return scope is first.scope and node.id in first.extent


def _union(anchor: Scope, placed: list[_Placed]) -> SpanUnion:
    depth = min(len(placed_span.way) for placed_span in placed)
    entry: set[str] = set()
    held: set[str] = set()
    extent: set[str] = set()
    for placed_span in placed:
        if placed_span.scope is not anchor:
            entry.add(placed_span.way[depth][1].id)
            continue
        entry |= placed_span.span.members
        extent |= placed_span.extent
        if placed_span.span.kind is SpanKind.LANE:
            held |= placed_span.extent
    extent |= entry
    activities = tuple(a for name in sorted(extent) for a in _activities(anchor.nodes[name]))
    ordered = sorted(placed, key=lambda placed_span: (len(placed_span.way), -len(placed_span.span.members)))
    return SpanUnion(
        tuple(placed_span.span for placed_span in ordered),
        frozenset(entry),
        frozenset(entry | held),
        frozenset(extent),
        activities,
    )


def _activities(node: Node) -> Iterator[Activity]:
    if node.activity is not None:
        yield node.activity
    for inner in node.scope.nodes.values() if node.scope is not None else ():
        yield from _activities(inner)


def spans_at(union: SpanUnion, names: Mapping[str, object]) -> tuple[Span, ...]:
    """Return the spans of a union that contain one of the nodes `names`, the innermost first."""
    return tuple(span for span in reversed(union.spans) if any(name in span.members for name in names))
