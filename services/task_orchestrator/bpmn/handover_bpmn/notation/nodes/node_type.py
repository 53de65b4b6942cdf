"""Type of a flow node: how it is read from a file, and the rules for it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeAlias

from lxml import etree

from handover_bpmn.model import Fault, Kind, Node, Scope
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.scope_graph import ScopeGraph


class ReadScope(Protocol):
    """Reads the content of a subprocess."""

    def __call__(
        self, container: etree._Element, context: Context, depth: int, *, in_event_subprocess: bool
    ) -> Scope:
        """Return the content of `container`."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Where a node is."""

    depth: int
    """In how many subprocesses."""
    in_event_subprocess: bool
    read_scope: ReadScope


Read: TypeAlias = Callable[[etree._Element, Node, Context, Surroundings], Node]
"""Completes a node that has its id, kind and name; what cannot be read is a fault."""


def no_faults(node: Node, graph: ScopeGraph) -> Iterator[Fault]:  # noqa: ARG001 - the interface of checks
    """Yield nothing."""
    yield from ()


@dataclass(frozen=True, slots=True)
class NodeType:
    """How a kind of flow nodes is read and checked."""

    kind: Kind
    read: Read
    parts: frozenset[str] | None
    """The child elements that it may have; others are reported. None: those of a scope."""
    has_incoming: bool = True
    """Whether a sequence flow may lead to it."""
    has_outgoing: bool = True
    """Whether a sequence flow may leave it."""
    has_conditions: bool = False
    """Whether conditions of the sequence flows that leave it have an effect."""
    joins: bool = False
    """Whether it may be an end: where several sequence flows meet and none leaves."""
    check: Callable[[Node, ScopeGraph], Iterator[Fault]] = no_faults
    """Yields the faults of a node of this kind in its scope."""
