"""Run: the execution of one process, as its callers see it.

Every change happens at a moment that the caller gives. A step that fails unexpectedly has no effect but an
incident at the token that caused it: the state before the step is restored from its snapshot.
"""

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

import structlog

from handover.messages import message, text_of
from handover_bpmn.execution import queries, span_places, token_acts
from handover_bpmn.execution.activities import no_plain_start, open_work
from handover_bpmn.execution.advance import settle
from handover_bpmn.execution.events import trigger
from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.machine import MAX_STEPS, Effect, Machine
from handover_bpmn.execution.migration import Finding, Migration
from handover_bpmn.execution.propagation import (
    is_caught,
    register_event_subprocesses,
    throw_error,
    throw_escalation,
)
from handover_bpmn.execution.queries import (
    EntityWait,
    InnerScope,
    OpenActivity,
    OpenIncident,
    OpenToken,
    Subscription,
)
from handover_bpmn.execution.span_places import ActiveSpan, SpanPlace
from handover_bpmn.execution.state import (
    Frame,
    Incident,
    Library,
    NotStorable,
    RunFailed,
    State,
    Token,
    TokenState,
    Wait,
    read_snapshot,
)
from handover_bpmn.execution.state_index import StateIndex, WorkChanges
from handover_bpmn.execution.waits import holds_for
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.model import Activity

log = structlog.stdlib.get_logger(__name__)


class _HasObstacles(RunFailed):
    """The run cannot be migrated."""


_NEVER = datetime.min.replace(tzinfo=UTC)
"""The moment of a machine that only reads."""


class Run:
    """The execution of one process. Not thread-safe."""

    __slots__ = ("_identity", "_index", "_library", "_now", "_saved", "_state", "effects", "plan")

    def __init__(
        self, plan: Plan, state: State, library: Library, identity: Mapping[str, Any] | None = None
    ) -> None:
        self.plan = plan
        self._identity = identity or {}
        self._now = _NEVER
        """When the last change was made."""
        self.effects: list[Effect] = []
        """Messages, signals and escalations that the process has thrown; the caller takes them away."""
        self._state = state
        self._library = library
        self._index = StateIndex(state)
        self._saved: bytes = b""
        """The snapshot of the state after the last change."""

    @classmethod
    def start(
        cls,
        plan: Plan,
        variables: Mapping[str, Any],
        now: datetime,
        library: Library,
        *,
        at: str | None = None,
        results: Mapping[str, Any] | None = None,
        identity: Mapping[str, Any] | None = None,
    ) -> "Run":
        """Return a new run, advanced as far as possible.

        It starts at the none start event, or at the event `at` with the variables `results` that it brings.
        Raises `RunFailed` if the process has no such start.
        """
        run = cls(plan, State(), library, identity)
        root = Frame(
            run._state.new_id(),
            plan.graph.scope.id,
            process=(plan.definition.name, plan.version),
            variables=dict(variables),
            graph=plan.graph,
        )
        run._state.add_frame(root)
        if at is not None and at not in plan.graph.nodes:
            raise RunFailed(f'there is no event "{at}" in "{plan.definition.name}"')
        starts = plan.graph.starts if at is None else [plan.graph.nodes[at]]
        if not starts:
            raise RunFailed(no_plain_start(plan.definition.name))
        machine = run._machine(now)
        try:
            register_event_subprocesses(machine, root)
        except (ExpressionError, ValueError) as error:
            raise RunFailed(text_of(error)) from error
        stage = TokenState.READY if at is None else TokenState.FINISHING
        tokens = [
            machine.add_token(root, start.id, state=stage, results=dict(results or {}) or None).id
            for start in starts
        ]
        run._saved = run._take_snapshot()
        run._change(
            lambda machine: machine.queue.extend(tokens),
            now,
            lambda state, error: _stop(state.tokens[tokens[0]], stage, _reason(error), now),
        )
        return run

    @classmethod
    def resume(
        cls, plan: Plan, snapshot: bytes, library: Library, *, identity: Mapping[str, Any] | None = None
    ) -> "Run":
        """Return the run of a `snapshot`; raise `RunFailed` if this release cannot read it."""
        run = cls(plan, read_snapshot(snapshot, library), library, identity)
        run._index.update()
        run._saved = snapshot
        return run

    # State

    @property
    def completed(self) -> bool:
        """Return whether all tokens have ended."""
        return self._state.completed

    @property
    def failure(self) -> str | None:
        """Return the error that has ended the process, if nothing caught it."""
        return self._state.failure

    def variables(self) -> dict[str, Any]:
        """Return the variables of the process itself."""
        return dict(self._state.root.variables)

    def versions(self) -> frozenset[tuple[str, int]]:
        """Return name and version of the process and of those that it calls now."""
        return frozenset(frame.process for frame in self._state.frames.values() if frame.process is not None)

    def visible_variables(self) -> Mapping[str, Any]:
        """Return what expressions at the process itself read; the mapping must not be changed."""
        return self._machine(self._now).frame_variables(self._state.root)

    def open(self) -> tuple[OpenActivity, ...]:
        """Return the activities that performers work on, in the order in which they were reached."""
        machine = self._machine(self._now)
        return tuple(
            queries.open_activity(machine, self._state.tokens[token]) for token in self._index.working
        )

    def open_visits(self) -> dict[str, int]:
        """Return the visit of each open activity by token, in the order in which they were reached."""
        return {str(token): visit for token, visit in self._index.working.items()}

    def take_work_changes(self) -> WorkChanges:
        """Return the activities that were opened and left since the last call."""
        return self._index.take_work_changes()

    def open_activity(self, token: str, now: datetime | None = None) -> OpenActivity:
        """Return the open activity of `token`, with `now` as the time that its expressions read.

        Raises `RunFailed` if it is not open.
        """
        return queries.open_activity(self._machine(now or self._now), self._working(token))

    def visit(self, token: str) -> int | None:
        """Return the visit of the activity of `token` that a performer works on; None if there is none."""
        position = self._find(token)
        return position.visit if position is not None and position.state is TokenState.WORK else None

    def activity(self, token: str) -> Activity:
        """Return the activity of an open `token`; raise `RunFailed` if it is not open."""
        position = self._working(token)
        activity = self._state.frames[position.frame].graph.nodes[position.node].activity
        assert activity is not None  # noqa: S101 - only such a token is open
        return activity

    def element(self, token: str) -> str | None:
        """Return the id of the element at which `token` is; None if there is no such token."""
        position = self._find(token)
        return None if position is None else self._state.frames[position.frame].prefix + position.node

    def incidents(self) -> tuple[OpenIncident, ...]:
        """Return the tokens that cannot continue."""
        return queries.incidents(self._machine(self._now), self._index.incidents)

    def tokens(self) -> tuple[OpenToken, ...]:
        """Return the tokens, two at one element as two."""
        return queries.tokens(self._machine(self._now))

    def inner_scopes(self) -> tuple[InnerScope, ...]:
        """Return the subprocesses, instances, called processes and activities with variables of their own."""
        return queries.inner_scopes(self._machine(self._now))

    def waiting(self) -> tuple[str, ...]:
        """Return the ids of the elements at which tokens are, and of the events that are waited for."""
        return self._index.waiting()

    def subscriptions(self) -> tuple[Subscription, ...]:
        """Return the messages and signals that the process waits for."""
        return queries.subscriptions(self._machine(self._now), self._index.subscribed)

    def entity_waits(self) -> tuple[EntityWait, ...]:
        """Return the events with a filter of entities that the process waits for."""
        return queries.entity_waits(self._machine(self._now), self._index.subscribed)

    @property
    def has_spans(self) -> bool:
        """Return whether resources may be reserved for what runs."""
        return self.plan.may_reserve and any(frame.graph.unions for frame in self._state.frames.values())

    def active_spans(self) -> tuple[ActiveSpan, ...]:
        """Return the spans in which tokens are, those of calling processes first."""
        return span_places.active_spans(self._state)

    def span_variables(self, key: str) -> Mapping[str, Any]:
        """Return the variables that the scope of an `ActiveSpan` sees; the mapping must not be changed."""
        return self._machine(self._now).frame_variables(span_places.frame_of_span(self._state, key))

    def places(self, token: str) -> tuple[SpanPlace, ...]:
        """Return the spans within which a token is, the innermost first."""
        return tuple(span_places.places(self._state, self._find(token)))

    def next_due(self) -> datetime | None:
        """Return when the next timer is due; None without one."""
        return self._index.next_due()

    def snapshot(self) -> bytes:
        """Return the serialized run."""
        return self._saved

    # Changes

    def complete(self, token: str, results: Mapping[str, Any], now: datetime) -> None:
        """Complete the open activity of `token`, with its `results` as process variables."""

        def act(machine: Machine) -> None:
            activity = self._working(token)
            activity.results = dict(results)
            machine.change_state(activity, TokenState.FINISHING)

        def blame(state: State, error: Exception) -> None:
            activity = state.tokens[int(token)]
            if isinstance(error, NotStorable):
                _stop(activity, TokenState.WORK, _reason(error), now)
                return
            activity.results = dict(results)
            _stop(activity, TokenState.FINISHING, _reason(error), now)

        self._change(act, now, blame)

    def fail(
        self,
        token: str,
        code: str | None,
        reason: str,
        now: datetime,
        *,
        task: str | None = None,
        only_named: bool = False,
    ) -> bool:
        """Continue at the event that catches the error `code` of an open activity, else raise an incident.

        The incident keeps the id of the failed `task`. Returns whether an event has caught the error. The
        variable `error` then has `activity`, `code` and `reason`. If `only_named`, an event has to name the
        code to catch it.
        """
        caught = False

        def act(machine: Machine) -> None:
            nonlocal caught
            activity = self._working(token)
            details = {"activity": activity.node, "reason": str(reason), "code": code}
            caught = throw_error(machine, activity, code, details, only_named=only_named)
            if not caught:
                machine.raise_incident(activity, reason, {"code": code, "task": task}, stage=TokenState.WORK)

        def blame(state: State, error: Exception) -> None:
            nonlocal caught
            caught = False
            _stop(state.tokens[int(token)], TokenState.WORK, _reason(error), now)

        self._change(act, now, blame)
        return caught

    def repeat(self, token: str, now: datetime) -> None:
        """Open an open activity again, as another visit; what waits for its events continues to wait."""
        self._change(lambda machine: open_work(machine, self._working(token)), now)

    def catches(self, token: str, code: str | None) -> bool:
        """Return whether an event catches the error `code` of an open activity."""
        return is_caught(self._machine(self._now), self._working(token), code)

    def refuse(self, token: str, reason: str, now: datetime) -> None:
        """Raise an incident at an open activity whose Task cannot be created."""
        self._change(
            lambda machine: machine.raise_incident(self._working(token), reason, stage=TokenState.WORK), now
        )

    def escalate(self, token: str, code: str | None, details: Mapping[str, Any], now: datetime) -> None:
        """Throw an escalation from an open activity, which continues unless the catching event interrupts."""
        self._change(
            lambda machine: throw_escalation(machine, self._working(token), code, dict(details)), now
        )

    def deliver(self, wait: int, variables: Mapping[str, Any], now: datetime) -> None:
        """Let the message or signal of a `Subscription` occur; one that nobody waits for is ignored."""
        if wait in self._state.waits:
            self._trigger(wait, dict(variables), now)

    def judge(self, wait: int, entity: str, variables: Mapping[str, Any] | None, now: datetime) -> bool:
        """Evaluate the condition of an `EntityWait` for an entity; if it becomes true, the event occurs.

        `variables` hold the entity, None if the filter no longer selects it. Returns whether the state of the
        process has changed. A condition occurs again for an entity only after it was false for it.
        """
        waiting = self._state.waits.get(wait)
        if waiting is None or waiting.stopped is not None:
            return False
        holds = variables is not None and holds_for(self._machine(now), waiting, variables)
        if holds == (entity in waiting.holding):
            return False

        def act(machine: Machine) -> None:
            judged = self._state.waits[wait]
            if not holds:
                judged.holding.remove(entity)
                return
            judged.holding.append(entity)
            trigger(machine, judged, dict(variables or {}))

        def blame(state: State, error: Exception) -> None:
            if isinstance(error, NotStorable):
                raise error
            state.waits[wait].holding.append(entity)
            _stop_wait(state, state.waits[wait], dict(variables or {}), _reason(error), now)

        self._change(act, now, blame)
        return True

    def advance(self, now: datetime) -> None:
        """Process the timers that are due at `now`, in the order of their moments."""
        for _ in range(MAX_STEPS):
            due = self._index.first_due(now)
            if due is None:
                return
            self._trigger(due, {}, now)

    def _trigger(self, wait: int, variables: dict[str, Any], now: datetime) -> None:
        """Let the event of a wait occur; if that fails, the wait stops, with an incident."""

        def blame(state: State, error: Exception) -> None:
            if isinstance(error, NotStorable) and variables:
                raise error
            _stop_wait(state, state.waits[wait], variables, _reason(error), now)

        self._change(lambda machine: trigger(machine, self._state.waits[wait], variables), now, blame)

    def set_variables(self, values: Mapping[str, Any], now: datetime, *, token: str | None = None) -> None:
        """Set variables of the process, or those that a token sees where the nearest scope has them."""

        def act(machine: Machine) -> None:
            position = None if token is None else self._token(token)
            frame = self._state.root if position is None else machine.frame_of(position)
            machine.set_variables(frame, values, token=position)

        self._change(act, now)

    def set_scope_variables(self, scope: str, values: Mapping[str, Any], now: datetime) -> str:
        """Set variables of an `InnerScope`, which only it sees; return the element that it is at.

        Raises `RunFailed` if there is no such scope.
        """
        element = ""

        def act(machine: Machine) -> None:
            nonlocal element
            element = token_acts.set_scope_variables(machine, scope, values)

        self._change(act, now)
        return element

    # What an engineer does

    def retry(self, token: str, now: datetime) -> None:
        """Let a token with an incident try again where it stopped."""
        self._change(lambda machine: token_acts.retry(machine, self._token(token)), now)

    def skip(self, token: str, results: Mapping[str, Any], now: datetime) -> None:
        """Let a token leave its node without doing what the node asks for; `results` become variables."""
        self._change(lambda machine: token_acts.skip(machine, self._token(token), results), now)

    def move(self, token: str, node: str, now: datetime) -> None:
        """Move a token to another node of its scope; what it does in its present node is cancelled."""
        self._change(lambda machine: token_acts.move(machine, self._token(token), node), now)

    def cancel_token(self, token: str, now: datetime) -> None:
        """End a token where it is; its scope or loop ends if it was the last one."""
        self._change(lambda machine: token_acts.cancel(machine, self._token(token)), now)

    def migrate(
        self, plan: Plan, mapping: Mapping[str, str], values: Mapping[str, Any], now: datetime
    ) -> list[Finding]:
        """Continue in another version of the definition, after the variables `values` are set.

        `mapping` names the elements that have another id in the new version. Returns what differs; if there
        is an obstacle, nothing has changed.
        """
        findings: list[Finding] = []

        def act(machine: Machine) -> None:
            machine.set_variables(self._state.root, values)
            findings.extend(Migration(machine, self.plan, plan, mapping).apply())
            self._state.touch_all()
            if any(finding.is_obstacle for finding in findings):
                raise _HasObstacles

        try:
            self._change(act, now)
        except _HasObstacles:
            return findings
        self.plan = plan
        return findings

    # Steps

    def _machine(self, now: datetime) -> Machine:
        self._now = now
        return Machine(self._state, self._library, now, self._identity)

    def _find(self, token: str) -> Token | None:
        return self._state.tokens.get(int(token)) if token.isdecimal() else None

    def _token(self, token: str) -> Token:
        position = self._find(token)
        if position is None:
            raise RunFailed.translated("process.no_such_token", 'there is no token "{token}"', token=token)
        return position

    def _working(self, token: str) -> Token:
        position = self._token(token)
        if position.state is not TokenState.WORK:
            raise RunFailed.translated(
                "process.token_not_open", 'nobody works on the activity of token "{token}"', token=token
            )
        return position

    def _change(
        self,
        act: Callable[[Machine], object],
        now: datetime,
        blame: Callable[[State, Exception], None] | None = None,
    ) -> None:
        """Apply `act`, advance and take a snapshot.

        After an unexpected failure the state before is restored, and `blame` raises an incident. Without
        `blame`, and if `act` itself is impossible, nothing changes and the failure is raised as `RunFailed`.
        """
        machine = self._machine(now)
        try:
            act(machine)
            settle(machine)
            self._saved = self._take_snapshot()
        except Exception as error:
            self._restore()
            if isinstance(error, RunFailed) and (blame is None or not isinstance(error, NotStorable)):
                raise
            if blame is None:
                raise RunFailed(_reason(error)) from error
            if not isinstance(error, RunFailed):
                log.exception("step of a process failed", definition=self.plan.definition.name)
            blame(self._state, error)
            self._saved = self._take_snapshot()
        else:
            self.effects += machine.effects

    def _take_snapshot(self) -> bytes:
        self._index.update()
        return self._state.snapshot()

    def _restore(self) -> None:
        before = self._index
        self._state = read_snapshot(self._saved, self._library)
        self._index = StateIndex(self._state)
        self._index.replace(before)


def _reason(error: Exception) -> str:
    if isinstance(error, RunFailed):
        return text_of(error)
    return message(
        "process.engine_failed", "the engine failed: {error}", error=f"{type(error).__name__}: {error}"
    )


def _stop(token: Token, stage: TokenState, reason: str, now: datetime) -> None:
    token.incident = Incident(stage, reason, now)
    token.state = TokenState.INCIDENT


def _stop_wait(state: State, wait: Wait, payload: dict[str, Any], reason: str, now: datetime) -> None:
    """Stop a wait whose event could not be processed, with an incident at its token or scope."""
    wait.stopped = payload
    frame = state.frames[wait.frame]
    owner = frame.host if wait.token is None else wait.token
    token = next(iter(frame.tokens.values())) if owner is None else state.tokens[owner]
    if token.incident is None:
        token.incident = Incident(token.state, reason, now)
