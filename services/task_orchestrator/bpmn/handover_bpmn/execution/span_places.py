"""Span places: the spans for which resources are reserved, and where tokens are within them."""

from collections.abc import Iterator
from dataclasses import dataclass

from handover_bpmn.execution.state import Frame, State, Token
from handover_bpmn.model import SpanKind
from handover_bpmn.spans import SpanUnion, spans_at


@dataclass(frozen=True, slots=True)
class ActiveSpan:
    """Spans in which tokens are, and for which resources are reserved together."""

    key: str
    element: str
    """The id of the outermost span; within a called process after those of the call activities."""
    union: SpanUnion
    is_entered: bool
    """Whether a token is at a member; else one can still come to it."""
    outer: tuple[str, ...]
    """The keys of those that enclose it: of the calling processes, the innermost first."""


@dataclass(frozen=True, slots=True)
class SpanPlace:
    """Where a token is within an `ActiveSpan`: the ids of its spans, the innermost first."""

    key: str
    is_member: bool
    spans: tuple[str, ...]
    lanes: tuple[str, ...]


def active_spans(state: State) -> tuple[ActiveSpan, ...]:
    """Return the spans in which tokens are, those of calling processes first."""
    places_ = []
    for frame in state.frames.values():
        if not frame.graph.unions:
            continue
        nodes = {token.node for token in frame.tokens.values()}
        for union in frame.graph.unions:
            if not union.held.isdisjoint(nodes):
                host = None if frame.host is None else state.tokens[frame.host]
                places_.append(
                    ActiveSpan(
                        _span_key(frame, union),
                        frame.prefix + union.id,
                        union,
                        not union.entry.isdisjoint(nodes),
                        tuple(place.key for place in places(state, host) if place.is_member),
                    )
                )
    return tuple(places_)


def places(state: State, token: Token | None) -> Iterator[SpanPlace]:
    """Yield the spans within which a token is, the innermost first."""
    names: dict[str, None] = {}
    while token is not None:
        frame = state.frames[token.frame]
        names[token.node] = None
        for union in frame.graph.unions:
            if token.node in union.extent:
                spans = spans_at(union, names)
                yield SpanPlace(
                    _span_key(frame, union),
                    token.node in union.entry,
                    tuple(span.id for span in spans),
                    tuple(span.id for span in spans if span.kind is SpanKind.LANE),
                )
        if frame.process is not None:
            names = {}
        outer = token.compensates if token.compensates is not None else frame.host
        token = None if outer is None else state.tokens[outer]


def frame_of_span(state: State, key: str) -> Frame:
    """Return the frame of an `ActiveSpan`."""
    return state.frames[int(key.partition(".")[0])]


def _span_key(frame: Frame, union: SpanUnion) -> str:
    return f"{frame.id}.{union.id}"
