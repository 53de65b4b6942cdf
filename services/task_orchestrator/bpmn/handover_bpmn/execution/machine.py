"""Machine: creates, moves and cancels tokens and frames, and reads and sets their variables."""

from collections import ChainMap, deque
from collections.abc import Iterable, Iterator, Mapping, MutableMapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, TypeAlias

from handover.messages import Message, text_of
from handover_bpmn.execution.graph import Graph, Plan
from handover_bpmn.execution.state import (
    Frame,
    Incident,
    Library,
    RunFailed,
    State,
    Token,
    TokenState,
    prefix_within,
)
from handover_bpmn.languages.base import EXECUTION, NOW, ExpressionError
from handover_bpmn.model import MultiInstance, Node

MAX_STEPS = 25_000
"""Nodes that tokens may enter in one step of the process; more are an endless loop."""
ACTIVE = frozenset({TokenState.READY, TokenState.FINISHING, TokenState.LEAVING})
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


class VisibleVariables(ChainMap[str, Any]):
    """The variables that a token or frame sees.

    Beside them expressions read the time of the step, and the properties of `execution` that JUEL has. Those
    are no variables: they are not listed or copied.
    """

    def __init__(self, machine: "Machine", token: Token | None, *layers: MutableMapping[str, Any]) -> None:
        super().__init__(*layers)
        self._machine = machine
        self._token = token

    def __missing__(self, key: str) -> Any:
        if key == NOW:
            return self._machine.now.isoformat()
        if key == EXECUTION:
            return self._machine.execution(self._token)
        raise KeyError(key)

    def __contains__(self, key: object) -> bool:
        return key in (NOW, EXECUTION) or super().__contains__(key)


@dataclass
class Machine:
    """The state of one process while it is changed at the moment `now`."""

    state: State
    library: Library
    now: datetime
    identity: Mapping[str, Any] = field(default_factory=dict)
    """The properties of `execution`: the id of the process, business key and definition."""
    queue: deque[int] = field(default_factory=deque)
    """The tokens that are about to do something."""
    steps: int = 0
    effects: list[Effect] = field(default_factory=list)
    variables_changed: bool = False
    joins_to_check: dict[tuple[int, str], None] = field(default_factory=dict)
    left_frames: dict[int, None] = field(default_factory=dict)
    """The frames that a token has left, or in which one waits at a join."""

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
        """Create a token at `node`; one that is about to do something is put into the queue."""
        token = Token(self.state.new_id(), frame.id, node, state, via, results=results)
        self.state.tokens[token.id] = token
        frame.tokens[token.id] = token
        if state in ACTIVE:
            self.queue.append(token.id)
        return token

    def change_state(self, token: Token, state: TokenState) -> None:
        """Set the state of a token, which ends its incident; an active one is put into the queue."""
        token.state = state
        token.incident = None
        if state in ACTIVE:
            self.queue.append(token.id)

    def remove(self, token: Token) -> None:
        """Remove a token with all that runs in its node; a frame without tokens is complete."""
        frame = self.frame_of(token)
        self._discard(token)
        if not frame.tokens:
            self._complete(frame)

    def _discard(self, token: Token) -> None:
        tokens = self.state.tokens
        for inner in list(token.inner):
            self._discard(tokens[inner])
        if token.child is not None:
            self.discard_frame(self.state.frames[token.child])
        if token.waits:
            self.state.clear_waits(token)
        frame = self.state.frames[token.frame]
        del frame.tokens[token.id]
        del tokens[token.id]
        if token.body is not None:
            del tokens[token.body].inner[token.id]
            return
        if token.compensates is not None and token.compensates in tokens:
            self.queue.append(token.compensates)
        self.left_frames[frame.id] = None
        for join in frame.graph.inclusive_joins:  # it may have waited for this token
            self.joins_to_check[frame.id, join] = None

    # Frames

    def add_frame(
        self, graph: Graph, host: Token | None, *, plan: Plan | None = None, variables: dict[str, Any]
    ) -> Frame:
        """Create a frame; `plan` is that of its process, if the frame is one."""
        prefix = ""
        if host is not None:
            prefix = prefix_within(self.frame_of(host), host, is_call=plan is not None)
        frame = Frame(
            self.state.new_id(),
            graph.scope.id,
            None if host is None else host.id,
            process=None if plan is None else (plan.definition.name, plan.version),
            variables=variables,
            graph=graph,
            prefix=prefix,
        )
        self.state.add_frame(frame)
        if host is not None:
            host.child = frame.id
            self.change_state(host, TokenState.SCOPE)
        return frame

    def discard_frame(self, frame: Frame) -> None:
        """Remove a frame with all its tokens and waits; its host does not continue."""
        self._discard_all(frame.tokens.values())
        self.state.clear_waits(frame)
        host = self.host(frame)
        if host is not None:
            host.child = None
        del self.state.frames[frame.id]

    def _complete(self, frame: Frame) -> None:
        """Continue the host of a frame whose last token has ended."""
        host = self.host(frame)
        if host is None:
            self.state.clear_waits(frame)
            self.state.completed = True
            return
        if host.state is not TokenState.SCOPE:  # it compensates
            return
        if frame.process is not None:
            host.results = frame.variables
        elif self._leaves_completions(frame, host):
            host.inside = {
                "local": host.local,
                "variables": frame.variables,
                "data": frame.data,
                "completions": frame.completions,
            }
        self.discard_frame(frame)
        self.change_state(host, TokenState.FINISHING)

    def _leaves_completions(self, frame: Frame, host: Token) -> bool:
        if self.node(host).triggered_by_event:
            return False
        return bool(frame.completions) or frame.graph.compensation_subprocess is not None

    def cancel_others(self, frame: Frame, but: Token) -> None:
        """Cancel all tokens of a frame but one."""
        self._discard_all(token for token in frame.tokens.values() if token is not but)

    # Variables

    def variables(self, token: Token) -> MutableMapping[str, Any]:
        """Return the variables that a token sees: its own, those of its frame and of the enclosing ones.

        The mapping changes with the state and must not be changed.
        """
        frame = self.state.frames[token.frame]
        return VisibleVariables(self, token, *self._own_layers(token), *self._layers(frame))

    def execution(self, token: Token | None) -> dict[str, Any]:
        """Return the properties of `execution`."""
        here = {} if token is None else {"id": str(token.id), "currentActivityId": token.node}
        if token is not None:
            here["currentActivityName"] = self.node(token).name
            key = self.business_key(self.frame_of(token))
            if key is not None:
                here |= {"processBusinessKey": key, "businessKey": key}
        return {**self.identity, **here}

    def business_key(self, frame: Frame) -> str | None:
        """Return the business key of the called process of a frame; None if it is that of the process."""
        while frame.key is None and frame.host is not None:
            frame = self.state.frames[self.state.tokens[frame.host].frame]
        return frame.key

    def copy_variables(self, token: Token) -> VisibleVariables:
        """Return a copy of the variables that a token sees."""
        copied: dict[str, Any] = {}
        for layer in reversed([*self._own_layers(token), *self._layers(self.frame_of(token))]):
            copied.update(layer)
        return VisibleVariables(self, token, copied)

    def frame_variables(self, frame: Frame) -> MutableMapping[str, Any]:
        """Return the variables that are visible in a frame."""
        return VisibleVariables(self, None, *self._layers(frame))

    def _own_layers(self, token: Token) -> Iterator[dict[str, Any]]:
        if token.local:
            yield token.local
        if token.body is not None:
            yield self.state.tokens[token.body].local

    def _layers(self, frame: Frame) -> Iterator[dict[str, Any]]:
        """Yield the variables of a frame and of the enclosing ones up to the process."""
        yield frame.variables
        while frame.process is None and frame.host is not None:
            host = self.state.tokens[frame.host]
            yield from self._own_layers(host)
            frame = self.state.frames[host.frame]
            yield frame.variables

    def set_variables(self, frame: Frame, values: Mapping[str, Any], *, token: Token | None = None) -> None:
        """Set variables where the nearest enclosing scope has them.

        Others become variables of the process, or of the instance if the frame is within an activity whose
        instances have an output collection. With a token its local variables are scopes as well.
        """
        if not values:
            return
        self.variables_changed = True
        if frame.process is not None and token is None:
            frame.variables.update(values)
            return
        layers = [*(() if token is None else self._own_layers(token)), *self._layers(frame)]
        default = self._default_layer(frame)
        for name, value in values.items():
            next((layer for layer in layers if name in layer), default)[name] = value

    def _default_layer(self, frame: Frame) -> dict[str, Any]:
        while frame.process is None and frame.host is not None:
            host = self.state.tokens[frame.host]
            if host.body is not None and has_output_collection(self.node(host)):
                return host.local
            frame = self.state.frames[host.frame]
        return frame.variables

    def data_owner(self, frame: Frame, data: str) -> dict[str, Any]:
        """Return the data objects, by id, of the scope that has the data object `data`."""
        while data not in frame.graph.scope.data_objects and frame.process is None and frame.host is not None:
            frame = self.frame_of(self.state.tokens[frame.host])
        return frame.data

    # Incidents

    def raise_incident(
        self, token: Token, reason: str, details: dict[str, Any] | None = None, *, stage: TokenState
    ) -> None:
        """Stop a token until an engineer retries, skips, moves or cancels it."""
        if stage is TokenState.READY:
            self.undo_entry(token)
        token.incident = Incident(stage, reason, self.now, details or {})
        token.state = TokenState.INCIDENT

    def report_incident(self, token: Token, reason: str) -> None:
        """Raise an incident at a token in whose node something runs or waits, which continues."""
        token.incident = Incident(token.state, reason, self.now)

    def undo_entry(self, token: Token) -> None:
        """Remove what a token has begun in its node, so that it can enter again."""
        self.state.clear_waits(token)
        for inner in list(token.inner):
            self._discard(self.state.tokens[inner])
        if token.child is not None:
            self.discard_frame(self.state.frames[token.child])
        if token.compensation is not None:
            token.compensation = None
            self._discard_all(
                compensating
                for compensating in self.state.tokens.values()
                if compensating.compensates == token.id
            )
        token.loop = None
        if token.body is None:
            token.local.clear()

    def _discard_all(self, tokens: Iterable[Token]) -> None:
        """Discard tokens, of which one may be within another."""
        for token in list(tokens):
            if token.id in self.state.tokens:
                self._discard(token)

    def fail_process(self, reason: str) -> None:
        """End the process: nothing has caught an error."""
        root = self.state.root
        self._discard_all(root.tokens.values())
        self.state.clear_waits(root)
        self.state.failure = reason

    @contextmanager
    def failures(self, token: Token) -> Iterator[None]:
        """Convert an error of an expression into a `RunFailed` that names the node of the token."""
        try:
            yield
        except (ExpressionError, ValueError, OverflowError) as error:
            raise self.failure(token, text_of(error)) from error

    def check_steps(self, token: Token, following: int = 0) -> None:
        """Raise `RunFailed` if the tokens have entered too many nodes, with those that certainly follow."""
        if self.steps + following > MAX_STEPS:
            raise RunFailed.translated(
                "process.endless_loop",
                'at "{element}": {limit} steps without waiting for anything',
                element=self.node(token).name or self.element(token),
                limit=MAX_STEPS,
            )

    def failure(self, token: Token, why: str) -> RunFailed:
        """Return the error that the token cannot continue; it names the node as it is drawn."""
        node = self.node(token)
        drawn = node.name if node.name and node.name != node.id else self.element(token)
        reason = why if isinstance(why, Message) else why.strip(" .")
        return RunFailed.translated("process.failed_at", 'at "{element}": {why}', element=drawn, why=reason)


def has_output_collection(node: Node) -> bool:
    """Return whether the results of each instance of an activity stay local, for its output collection."""
    return isinstance(node.loop, MultiInstance) and node.loop.output_collection is not None
