"""Run: the execution of one process, as its callers see it.

Every change happens at a moment that the caller gives. A step that fails unexpectedly has no effect but an
incident at the token that caused it: the state before the step is restored from its snapshot.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from handover.messages import message, text_of
from handover.telemetry import get_logger
from services.task_orchestrator.execution.activities import (
    cancel_instance,
    finish,
    leave,
    no_plain_start,
    open_work,
    set_results,
)
from services.task_orchestrator.execution.compensation import continue_compensation
from services.task_orchestrator.execution.events import enter, trigger
from services.task_orchestrator.execution.graph import Plan
from services.task_orchestrator.execution.machine import ACTIVE, MAX_STEPS, Effect, Machine
from services.task_orchestrator.execution.migration import Finding, Migration
from services.task_orchestrator.execution.navigation import arrive, check_joins, find_stalled
from services.task_orchestrator.execution.propagation import (
    is_caught,
    register_event_subprocesses,
    throw_error,
    throw_escalation,
)
from services.task_orchestrator.execution.state import (
    Frame,
    Incident,
    Library,
    NotStorable,
    RunFailed,
    State,
    Token,
    TokenState,
    Wait,
    WaitType,
    read_snapshot,
)
from services.task_orchestrator.execution.state_index import StateIndex, WorkChanges
from services.task_orchestrator.execution.waits import conditions_that_became_true, event_of, holds_for
from services.task_orchestrator.languages.base import ExpressionError
from services.task_orchestrator.model import Activity, EntityFilter, Kind, SpanKind, entity_filter
from services.task_orchestrator.spans import SpanUnion, spans_at

log = get_logger(__name__)

STEP_FAILURES = (RunFailed, ExpressionError)


class _HasObstacles(RunFailed):
    """The run cannot be migrated."""


_NEVER = datetime.min.replace(tzinfo=UTC)
"""The moment of a machine that only reads."""


@dataclass(frozen=True, slots=True)
class OpenActivity:
    """An activity that a performer works on: `visit` counts from 1, `variables` are those it sees."""

    token: str
    element: str
    """The id of the element; within a called process after those of the call activities."""
    visit: int
    activity: Activity
    variables: Mapping[str, Any] = field(repr=False)
    data: Mapping[str, Any] = field(default_factory=dict, repr=False)
    """The data objects that are inputs of the activity, by parameter."""


@dataclass(frozen=True, slots=True)
class OpenIncident:
    """A token that cannot continue."""

    token: str
    element: str
    name: str
    reason: str
    since: datetime
    stage: TokenState
    details: Mapping[str, Any]
    visit: int
    """The visit of its activity, as in the Task; 0 if it has none."""


@dataclass(frozen=True, slots=True)
class Subscription:
    """A message or signal that the process waits for; without `key`, whatever the correlation is."""

    wait: int
    type: WaitType
    name: str
    key: Any
    element: str
    business_key: str | None = None
    """The key of the called process that waits; None: that of the process itself."""


@dataclass(frozen=True, slots=True)
class EntityWait:
    """An event that the process waits for and that is the creation or change of an entity.

    `key` is that of a message that declares a correlation of its own.
    """

    wait: int
    type: WaitType
    name: str
    key: Any
    on: EntityFilter
    element: str
    holding: tuple[str, ...]
    """The entities for which the condition was true when it was last evaluated."""


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


class Run:
    """The execution of one process. Not thread-safe."""

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

    def open(self) -> tuple[OpenActivity, ...]:
        """Return the activities that performers work on, in the order in which they were reached."""
        machine = self._machine(self._now)
        return tuple(_open_activity(machine, self._state.tokens[token]) for token in self._index.working)

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
        return _open_activity(self._machine(now or self._now), self._working(token))

    def visit(self, token: str) -> int | None:
        """Return the visit of the activity of `token` that a performer works on; None if there is none."""
        found = self._find(token)
        return found.visit if found is not None and found.state is TokenState.WORK else None

    def activity(self, token: str) -> Activity:
        """Return the activity of an open `token`; raise `RunFailed` if it is not open."""
        found = self._working(token)
        activity = self._state.frames[found.frame].graph.nodes[found.node].activity
        assert activity is not None  # noqa: S101 - only such a token is open
        return activity

    def element(self, token: str) -> str | None:
        """Return the id of the element at which `token` is; None if there is no such token."""
        found = self._find(token)
        return None if found is None else self._state.frames[found.frame].prefix + found.node

    def incidents(self) -> tuple[OpenIncident, ...]:
        """Return the tokens that cannot continue."""
        machine = self._machine(self._now)
        return tuple(
            OpenIncident(
                str(token.id),
                machine.element(token),
                machine.node(token).name,
                token.incident.reason,
                token.incident.since,
                token.incident.stage,
                token.incident.details,
                token.visit,
            )
            for token in map(self._state.tokens.__getitem__, self._index.incidents)
            if token.incident is not None
        )

    def waiting(self) -> tuple[str, ...]:
        """Return the ids of the elements at which tokens are, and of the events that are waited for."""
        return self._index.waiting()

    def subscriptions(self) -> tuple[Subscription, ...]:
        """Return the messages and signals that the process waits for."""
        machine = self._machine(self._now)
        return tuple(
            Subscription(
                wait.id,
                wait.type,
                wait.text or "",
                wait.key,
                self._state.frames[wait.frame].prefix + wait.node,
                machine.business_key(self._state.frames[wait.frame]),
            )
            for wait in map(self._state.waits.__getitem__, self._index.subscribed)
            if wait.type in {WaitType.MESSAGE, WaitType.SIGNAL}
        )

    def entity_waits(self) -> tuple[EntityWait, ...]:
        """Return the events with a filter of entities that the process waits for."""
        machine, found = self._machine(self._now), []
        for wait in map(self._state.waits.__getitem__, self._index.subscribed):
            on = entity_filter(event_of(machine, wait))
            if on is not None:
                element = self._state.frames[wait.frame].prefix + wait.node
                found.append(
                    EntityWait(
                        wait.id, wait.type, wait.text or "", wait.key, on, element, tuple(wait.holding)
                    )
                )
        return tuple(found)

    @property
    def has_spans(self) -> bool:
        """Return whether resources may be reserved for what runs."""
        return self.plan.may_reserve and any(frame.graph.unions for frame in self._state.frames.values())

    def active_spans(self) -> tuple[ActiveSpan, ...]:
        """Return the spans in which tokens are, those of calling processes first."""
        found = []
        for frame in self._state.frames.values():
            if not frame.graph.unions:
                continue
            nodes = {token.node for token in frame.tokens.values()}
            for union in frame.graph.unions:
                if not union.held.isdisjoint(nodes):
                    host = None if frame.host is None else self._state.tokens[frame.host]
                    found.append(
                        ActiveSpan(
                            _span_key(frame, union),
                            frame.prefix + union.id,
                            union,
                            not union.entry.isdisjoint(nodes),
                            tuple(place.key for place in self._places(host) if place.is_member),
                        )
                    )
        return tuple(found)

    def span_variables(self, key: str) -> Mapping[str, Any]:
        """Return the variables that the scope of an `ActiveSpan` sees; the mapping must not be changed."""
        frame = self._state.frames[int(key.partition(".")[0])]
        return self._machine(self._now).frame_variables(frame)

    def places(self, token: str) -> tuple[SpanPlace, ...]:
        """Return the spans within which a token is, the innermost first."""
        return tuple(self._places(self._find(token)))

    def _places(self, token: Token | None) -> Iterator[SpanPlace]:
        names: dict[str, None] = {}
        while token is not None:
            frame = self._state.frames[token.frame]
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
            token = None if outer is None else self._state.tokens[outer]

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
            found = None if token is None else self._token(token)
            frame = self._state.root if found is None else machine.frame_of(found)
            machine.set_variables(frame, values, token=found)

        self._change(act, now)

    # What an engineer does

    def retry(self, token: str, now: datetime) -> None:
        """Let a token with an incident try again where it stopped."""

        def act(machine: Machine) -> None:
            found = self._token(token)
            incident = found.incident
            if incident is None:
                raise RunFailed(f"the token {token} has no incident")
            found.incident = None
            if found.state is TokenState.JOINED:
                arrive(machine, found, machine.node(found))
            elif found.state is not TokenState.INCIDENT:
                self._retry_events(machine, found)
            elif incident.stage is TokenState.WORK:
                open_work(machine, found)
            else:
                machine.change_state(found, incident.stage)

        self._change(act, now)

    def _retry_events(self, machine: Machine, token: Token) -> None:
        """Process the failed events of a token again, or wait again for those of its event subprocesses."""
        owners: list[Token | Frame] = [token, machine.frame_of(token)]
        child = None if token.child is None else self._state.frames[token.child]
        if child is not None:
            owners.append(child)
        stopped = [
            wait
            for owner in owners
            for wait in (self._state.waits[wait] for wait in owner.waits)
            if wait.stopped is not None
        ]
        if not stopped and child is not None:
            self._state.clear_waits(child)
            with machine.failures(token):
                register_event_subprocesses(machine, child)
        for wait in stopped:
            if wait.id in self._state.waits:
                payload, wait.stopped = wait.stopped or {}, None
                trigger(machine, wait, payload)

    def skip(self, token: str, results: Mapping[str, Any], now: datetime) -> None:
        """Let a token leave its node without doing what the node asks for; `results` become variables."""

        def act(machine: Machine) -> None:
            found = self._token(token)
            node = machine.node(found)
            if node.kind is Kind.EVENT_BASED:
                raise machine.failure(found, "an event-based gateway cannot be skipped, only moved")
            machine.undo_entry(found)
            found.results = None
            set_results(machine, found, node, results)
            machine.change_state(found, TokenState.LEAVING)

        self._change(act, now)

    def move(self, token: str, node: str, now: datetime) -> None:
        """Move a token to another node of its scope; what it does in its present node is cancelled."""

        def act(machine: Machine) -> None:
            found = self._token(token)
            while found.body is not None:
                found = self._state.tokens[found.body]
            frame = machine.frame_of(found)
            target = frame.graph.nodes.get(node)
            if target is None or target.kind is Kind.BOUNDARY_EVENT or target.triggered_by_event:
                raise RunFailed(
                    message(
                        "process.cannot_move",
                        '"{node}" is no element of "{scope}" at which a token can be',
                        node=node,
                        scope=frame.scope,
                    )
                )
            machine.add_token(frame, node)
            machine.remove(found)

        self._change(act, now)

    def cancel_token(self, token: str, now: datetime) -> None:
        """End a token where it is; its scope or loop ends if it was the last one."""

        def act(machine: Machine) -> None:
            found = self._token(token)
            if found.body is None:
                machine.remove(found)
            else:
                cancel_instance(machine, found)

        self._change(act, now)

    def migrate(
        self, plan: Plan, mapping: Mapping[str, str], values: Mapping[str, Any], now: datetime
    ) -> list[Finding]:
        """Continue in another version of the definition, after the variables `values` are set.

        `mapping` names the elements that have another id in the new version. Returns what differs; if there
        is an obstacle, nothing has changed.
        """
        found: list[Finding] = []

        def act(machine: Machine) -> None:
            machine.set_variables(self._state.root, values)
            found.extend(Migration(machine, self.plan, plan, mapping).apply())
            self._state.touch_all()
            if any(each.is_obstacle for each in found):
                raise _HasObstacles

        try:
            self._change(act, now)
        except _HasObstacles:
            return found
        self.plan = plan
        return found

    # Steps

    def _machine(self, now: datetime) -> Machine:
        self._now = now
        return Machine(self._state, self._library, now, self._identity)

    def _find(self, token: str) -> Token | None:
        return self._state.tokens.get(int(token)) if token.isdecimal() else None

    def _token(self, token: str) -> Token:
        found = self._find(token)
        if found is None:
            raise RunFailed(message("process.no_such_token", 'there is no token "{token}"', token=token))
        return found

    def _working(self, token: str) -> Token:
        found = self._token(token)
        if found.state is not TokenState.WORK:
            raise RunFailed(
                message(
                    "process.token_not_open", 'nobody works on the activity of token "{token}"', token=token
                )
            )
        return found

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
            self._settle(machine)
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

    def _settle(self, machine: Machine) -> None:
        """Advance every token as far as possible."""
        while True:
            while machine.queue:
                self._process_token(machine, machine.queue.popleft())
            if check_joins(machine):
                continue
            if not machine.variables_changed:
                break
            machine.variables_changed = False
            for wait in conditions_that_became_true(machine):
                if wait.id in self._state.waits:
                    trigger(machine, wait, {})
        if not self._state.completed:
            find_stalled(machine)

    def _process_token(self, machine: Machine, token_id: int) -> None:
        token = self._state.tokens.get(token_id)
        if token is None:
            return
        if token.state is TokenState.COMPENSATING:
            continue_compensation(machine, token)
            return
        if token.state not in ACTIVE:
            return
        stage = token.state
        node = machine.node(token)
        try:
            if stage is TokenState.READY:
                machine.steps += 1
                machine.check_steps(token)
                enter(machine, token, node)
                if token.state is not TokenState.FINISHING:
                    return
                stage = TokenState.FINISHING
            if stage is TokenState.FINISHING:
                finish(machine, token, node)
            else:
                leave(machine, token, node)
        except STEP_FAILURES as failure:
            if token.state is TokenState.LEAVING:
                stage = TokenState.LEAVING
            machine.raise_incident(token, text_of(failure), stage=stage)


def _span_key(frame: Frame, union: SpanUnion) -> str:
    return f"{frame.id}.{union.id}"


def _open_activity(machine: Machine, token: Token) -> OpenActivity:
    node = machine.node(token)
    assert node.activity is not None  # noqa: S101 - only such a token works
    frame = machine.frame_of(token)
    data = {
        each.name or each.data: machine.data_owner(frame, each.data).get(each.data)
        for each in node.data_inputs
    }
    variables = machine.copy_variables(token)
    return OpenActivity(str(token.id), machine.element(token), token.visit, node.activity, variables, data)


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
