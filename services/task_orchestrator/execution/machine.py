"""Machine: creates, moves and cancels tokens and frames, and reads and sets their variables."""

from collections import ChainMap, deque
from collections.abc import Iterator, Mapping, MutableMapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, TypeAlias

from handover.messages import message, text_of
from services.task_orchestrator.execution.graph import Graph, Plan
from services.task_orchestrator.execution.state import (
    Frame,
    Incident,
    Library,
    RunFailed,
    State,
    Token,
    TokenState,
)
from services.task_orchestrator.languages.base import ExpressionError
from services.task_orchestrator.model import Kind, Node

MAX_STEPS = 10_000
"""Nodes that the tokens of a process may enter without waiting for anything; more are an endless loop."""
MAX_CALLS = 20
"""Called processes within each other; more are a cycle."""


@dataclass(frozen=True, slots=True)
class ThrownMessage:
    """A message that the process has sent."""

    name: str
    key: Any
    variables: Mapping[str, Any]
    element: str


@dataclass(frozen=True, slots=True)
class ThrownSignal:
    """A signal that the process has broadcast."""

    name: str
    variables: Mapping[str, Any]
    element: str


@dataclass(frozen=True, slots=True)
class UncaughtEscalation:
    """An escalation that nothing in the process has caught; the process continues."""

    code: str | None
    element: str


Effect: TypeAlias = ThrownMessage | ThrownSignal | UncaughtEscalation


@dataclass
class Machine:
    """The state of one process while it is changed at the moment `now`."""

    state: State
    library: Library
    now: datetime
    queue: deque[int] = field(default_factory=deque)
    """The tokens that are ready or finishing."""
    steps: int = 0
    effects: list[Effect] = field(default_factory=list)
    variables_changed: bool = False
    joins_to_check: dict[tuple[int, str], None] = field(default_factory=dict)

    # Lookup

    def frame_of(self, token: Token) -> Frame:
        """Return the frame of a token."""
        return self.state.frames[token.frame]

    def node(self, token: Token) -> Node:
        """Return the node at which a token is."""
        return self.frame_of(token).graph.nodes[token.node]

    def element(self, token: Token) -> str:
        """Return the id of the element of a token; within a called process with the calling elements."""
        return self.frame_of(token).prefix + token.node

    def host(self, frame: Frame) -> Token | None:
        """Return the token in whose node a frame runs; None for the process itself."""
        return None if frame.host is None else self.state.tokens[frame.host]

    # Tokens

    def add_token(
        self,
        frame: Frame,
        node: str,
        *,
        via: str | None = None,
        state: TokenState = TokenState.READY,
        results: dict[str, Any] | None = None,
    ) -> Token:
        """Create a token at `node`; one that is ready or finishing is put into the queue."""
        token = Token(self.state.new_id(), frame.id, node, state, via=via, results=results)
        self.state.tokens[token.id] = token
        frame.tokens[token.id] = token
        if state in {TokenState.READY, TokenState.FINISHING}:
            self.queue.append(token.id)
        return token

    def change_state(self, token: Token, state: TokenState) -> None:
        """Set the state of a token; one that is ready or finishing is put into the queue."""
        token.state = state
        if state in {TokenState.READY, TokenState.FINISHING}:
            self.queue.append(token.id)

    def remove(self, token: Token) -> None:
        """Remove a token with all that runs in its node; a frame without tokens is complete."""
        frame = self.frame_of(token)
        self._discard(token)
        if not frame.tokens:
            self._complete(frame)

    def _discard(self, token: Token) -> None:
        for inner in list(token.inner):
            self._discard(self.state.tokens[inner])
        if token.child is not None:
            self.discard_frame(self.state.frames[token.child])
        self.clear_waits(token)
        if token.body is not None and token.body in self.state.tokens:
            self.state.tokens[token.body].inner.remove(token.id)
        del self.frame_of(token).tokens[token.id]
        del self.state.tokens[token.id]
        self._check_joins(token.frame)

    def clear_waits(self, owner: Token | Frame) -> None:
        """Remove the waits of a token, or those of a frame for its event subprocesses."""
        for wait in owner.waits:
            self.state.waits.pop(wait, None)
        owner.waits.clear()

    def _check_joins(self, frame: int) -> None:
        """Check inclusive joins of a frame again, since a token that they waited for may have gone."""
        graph = self.state.frames[frame].graph
        for join in graph.upstream:
            self.joins_to_check[frame, join] = None

    # Frames

    def add_frame(
        self, graph: Graph, host: Token | None, *, plan: Plan | None = None, variables: dict[str, Any]
    ) -> Frame:
        """Create a frame; `plan` is that of its process, if the frame is one."""
        prefix = ""
        if host is not None:
            outer = self.frame_of(host)
            prefix = f"{outer.prefix}{host.node}." if plan is not None else outer.prefix
        frame = Frame(
            self.state.new_id(),
            graph.scope.id,
            None if host is None else host.id,
            process=None if plan is None else (plan.definition.name, plan.version),
            variables=variables,
            graph=graph,
            prefix=prefix,
        )
        self.state.frames[frame.id] = frame
        if host is not None:
            host.child = frame.id
            host.state = TokenState.SCOPE
        return frame

    def discard_frame(self, frame: Frame) -> None:
        """Remove a frame with all its tokens and waits; its host does not continue."""
        for token in list(frame.tokens.values()):
            if token.id in frame.tokens:  # not removed with another one
                self._discard(token)
        self.clear_waits(frame)
        host = self.host(frame)
        if host is not None:
            host.child = None
        del self.state.frames[frame.id]

    def _complete(self, frame: Frame) -> None:
        """Continue the host of a frame whose last token has ended."""
        host = self.host(frame)
        if host is None:
            self.clear_waits(frame)
            self.state.completed = True
            return
        if host.state is not TokenState.SCOPE:
            return
        if frame.process is not None:
            host.results = dict(frame.variables)
        elif self._leaves_compensations(frame, host):
            host.inside = {
                "variables": frame.variables,
                "data": frame.data,
                "compensations": frame.compensations,
            }
        self.discard_frame(frame)
        self.change_state(host, TokenState.FINISHING)

    def _leaves_compensations(self, frame: Frame, host: Token) -> bool:
        if self.node(host).triggered_by_event:
            return False
        return bool(frame.compensations) or frame.graph.compensation_subprocess is not None

    def cancel_others(self, frame: Frame, but: Token) -> None:
        """Cancel all tokens of a frame but one."""
        for token in list(frame.tokens.values()):
            if token is not but and token.id in frame.tokens:
                self._discard(token)

    # Variables

    def variables(self, token: Token) -> Mapping[str, Any]:
        """Return the variables that a token sees: its own, those of its frame and of the enclosing ones."""
        return ChainMap(*self._layers(token))

    def frame_variables(self, frame: Frame) -> Mapping[str, Any]:
        """Return the variables that are visible in a frame."""
        return ChainMap(*self._frame_layers(frame))

    def _layers(self, token: Token) -> Iterator[MutableMapping[str, Any]]:
        if token.local:
            yield token.local
        if token.body is not None:
            yield self.state.tokens[token.body].local
        yield from self._frame_layers(self.frame_of(token))

    def _frame_layers(self, frame: Frame) -> Iterator[MutableMapping[str, Any]]:
        yield frame.variables
        host = self.host(frame)
        while host is not None and frame.process is None:
            if host.local:
                yield host.local
            if host.body is not None:
                yield self.state.tokens[host.body].local
            frame = self.frame_of(host)
            yield frame.variables
            host = self.host(frame)

    def set_variables(self, frame: Frame, values: Mapping[str, Any]) -> None:
        """Set variables where the nearest enclosing scope has them, else in the process."""
        if not values:
            return
        layers = list(self._frame_layers(frame))
        for name, value in values.items():
            owner = next((layer for layer in layers if name in layer), layers[-1])
            owner[name] = value
        self.variables_changed = True

    def data_owner(self, frame: Frame, data: str) -> dict[str, Any]:
        """Return the data objects, by id, of the scope that has the data object `data`."""
        while data not in frame.graph.scope.data_objects and frame.process is None and frame.host is not None:
            frame = self.frame_of(self.state.tokens[frame.host])
        return frame.data

    # Incidents

    def raise_incident(
        self, token: Token, reason: str, details: dict[str, Any] | None = None, *, stage: TokenState
    ) -> None:
        """Stop a token until somebody retries, skips, moves or cancels it."""
        if stage is TokenState.READY:
            self.undo_entry(token)
        token.incident = Incident(stage, reason, self.now, details or {})
        token.state = TokenState.INCIDENT

    def undo_entry(self, token: Token) -> None:
        """Remove what a token has begun in its node, so that it can enter again."""
        self.clear_waits(token)
        for inner in list(token.inner):
            self._discard(self.state.tokens[inner])
        if token.child is not None:
            self.discard_frame(self.state.frames[token.child])
        token.loop = None
        if token.body is None:
            token.local.clear()

    def fail_process(self, reason: str) -> None:
        """End the process: nothing has caught an error."""
        root = self.state.root
        for token in list(root.tokens.values()):
            if token.id in root.tokens:
                self._discard(token)
        self.clear_waits(root)
        self.state.failure = reason

    @contextmanager
    def failures(self, token: Token) -> Iterator[None]:
        """Convert an error of an expression into a `RunFailed` that names the node of the token."""
        try:
            yield
        except (ExpressionError, ValueError, OverflowError) as error:
            raise self.failure(token, text_of(error)) from error

    def failure(self, token: Token, why: str) -> RunFailed:
        """Return the error that the token cannot continue; it names the node as it is drawn."""
        node = self.node(token)
        drawn = f'"{node.name}"' if node.name and node.name != node.id else f'"{self.element(token)}"'
        return RunFailed(
            message("process.failed_at", "at {element}: {why}", element=drawn, why=why.strip(" ."))
        )


def is_activity(node: Node) -> bool:
    """Return whether a node is an activity, which may have boundary events and loops."""
    return node.kind.value.endswith(("Task", "task")) or node.kind in {Kind.SUB_PROCESS, Kind.CALL_ACTIVITY}
