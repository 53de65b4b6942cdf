"""Run: the execution of one process, as its callers see it.

Every change happens at a moment that the caller gives. A step that fails unexpectedly has no effect but an
incident at the token that caused it: the state before the step is restored from its snapshot.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from handover.messages import message, text_of
from handover.telemetry import get_logger
from services.task_orchestrator.execution.activities import finish, open_work
from services.task_orchestrator.execution.events import enter, trigger
from services.task_orchestrator.execution.graph import Plan
from services.task_orchestrator.execution.machine import MAX_STEPS, Effect, Machine
from services.task_orchestrator.execution.navigation import check_joins, find_stalled
from services.task_orchestrator.execution.propagation import (
    register_event_subprocesses,
    throw_error,
    throw_escalation,
)
from services.task_orchestrator.execution.state import (
    Frame,
    Incident,
    Library,
    RunFailed,
    State,
    Token,
    TokenState,
    WaitType,
    read_snapshot,
)
from services.task_orchestrator.execution.waits import conditions_that_became_true
from services.task_orchestrator.languages.base import ExpressionError
from services.task_orchestrator.model import Activity, Kind, Node

log = get_logger(__name__)

STEP_FAILURES = (RunFailed, ExpressionError)


class _StepFailed(Exception):
    """A step that began without a token of its own has failed."""


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


@dataclass(frozen=True, slots=True)
class Subscription:
    """A message or signal that the process waits for; without `key`, whatever the correlation is."""

    wait: int
    type: WaitType
    name: str
    key: Any
    element: str


class Run:
    """The execution of one process. Not thread-safe."""

    def __init__(self, plan: Plan, state: State, library: Library) -> None:
        self.plan = plan
        self.effects: list[Effect] = []
        """Messages, signals and escalations that the process has thrown; the caller takes them away."""
        self._state = state
        self._library = library
        self._saved: bytes | None = None

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
    ) -> "Run":
        """Return a new run, advanced as far as possible.

        It starts at the none start event, or at the event `at` with the variables `results` that it brings.
        Raises `RunFailed` if the process has no such start.
        """
        run = cls(plan, State(), library)
        root = Frame(
            run._state.new_id(),
            plan.graph.scope.id,
            process=(plan.definition.name, plan.version),
            variables=dict(variables),
            graph=plan.graph,
        )
        run._state.frames[root.id] = root
        starts = plan.graph.starts if at is None else [plan.graph.nodes[at]]
        if not starts:
            raise RunFailed(
                message(
                    "process.no_plain_start",
                    '"{definition}" starts with an event, so it cannot be started without it',
                    definition=plan.definition.name,
                )
            )
        machine = run._machine(now)
        try:
            register_event_subprocesses(machine, root)
        except (ExpressionError, ValueError) as error:
            raise RunFailed(text_of(error)) from error
        for start in starts:
            state = TokenState.READY if at is None else TokenState.FINISHING
            machine.add_token(root, start.id, state=state, results=dict(results or {}) or None)
        run._settle(machine)
        return run

    @classmethod
    def resume(cls, plan: Plan, snapshot: bytes, library: Library) -> "Run":
        """Return the run of a `snapshot`; raise `RunFailed` if this release cannot read it."""
        run = cls(plan, read_snapshot(snapshot, library), library)
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
        machine = self._machine(datetime.min)  # noqa: DTZ901 - not used for reading
        working = (token for token in self._state.tokens.values() if token.state is TokenState.WORK)
        return tuple(_open_activity(machine, token) for token in working)

    def is_open(self, token: str) -> bool:
        """Return whether a performer works on the activity of `token`."""
        found = self._state.tokens.get(int(token))
        return found is not None and found.state is TokenState.WORK

    def incidents(self) -> tuple[OpenIncident, ...]:
        """Return the tokens that cannot continue."""
        machine = self._machine(datetime.min)  # noqa: DTZ901 - not used for reading
        return tuple(
            OpenIncident(
                str(token.id),
                machine.element(token),
                machine.node(token).name,
                token.incident.reason,
                token.incident.since,
                token.incident.stage,
                token.incident.details,
            )
            for token in self._state.tokens.values()
            if token.incident is not None
        )

    def waiting(self) -> tuple[str, ...]:
        """Return the ids of the elements at which tokens are, and of the events that are waited for."""
        names: dict[str, None] = {}
        for token in self._state.tokens.values():
            names[self._state.frames[token.frame].prefix + token.node] = None
        for wait in self._state.waits.values():
            names[self._state.frames[wait.frame].prefix + wait.node] = None
        return tuple(names)

    def subscriptions(self) -> tuple[Subscription, ...]:
        """Return the messages and signals that the process waits for."""
        return tuple(
            Subscription(
                wait.id,
                wait.type,
                wait.text or "",
                wait.key,
                self._state.frames[wait.frame].prefix + wait.node,
            )
            for wait in self._state.waits.values()
            if wait.type in {WaitType.MESSAGE, WaitType.SIGNAL}
        )

    def next_due(self) -> datetime | None:
        """Return when the next timer is due; None without one."""
        return min((wait.due for wait in self._state.waits.values() if wait.due is not None), default=None)

    def snapshot(self) -> bytes:
        """Return the serialized run; raise `RunFailed` if its variables are too large or no JSON."""
        self._saved = self._state.snapshot()
        return self._saved

    # Changes

    def complete(self, token: str, results: Mapping[str, Any], now: datetime) -> None:
        """Complete the activity of `token`, with its `results` as process variables."""

        def act(machine: Machine) -> None:
            activity = self._token(token)
            activity.results = dict(results)
            machine.change_state(activity, TokenState.FINISHING)

        def blame(state: State, reason: str) -> Token:
            activity = state.tokens[int(token)]
            activity.results = dict(results)
            return _stop(activity, TokenState.FINISHING, reason, now)

        self._change(act, now, blame)

    def fail(self, token: str, code: str | None, reason: str, now: datetime) -> bool:
        """Continue at the event that catches the error `code` of an activity, else raise an incident.

        Returns whether an event has caught it. The variable `error` then has `activity`, `code` and `reason`.
        """
        caught = False

        def act(machine: Machine) -> None:
            nonlocal caught
            activity = self._token(token)
            details = {"activity": activity.node, "reason": str(reason), "code": code}
            caught = throw_error(machine, activity, code, details)
            if not caught:
                machine.raise_incident(activity, reason, {"code": code}, stage=TokenState.WORK)

        self._change(act, now, lambda state, why: _stop(state.tokens[int(token)], TokenState.WORK, why, now))
        return caught

    def escalate(self, token: str, code: str | None, details: Mapping[str, Any], now: datetime) -> None:
        """Throw an escalation from an open activity, which continues unless the catching event interrupts."""
        self._change(
            lambda machine: throw_escalation(machine, self._token(token), code, dict(details)), now, None
        )

    def deliver(self, wait: int, variables: Mapping[str, Any], now: datetime) -> None:
        """Let the message or signal of a `Subscription` occur; one that nobody waits for is ignored."""
        if wait in self._state.waits:
            self._trigger(wait, dict(variables), now)

    def advance(self, now: datetime) -> None:
        """Process the timers that are due at `now`, in the order of their moments."""
        for _ in range(MAX_STEPS):
            due = [
                (wait.due, wait.id)
                for wait in self._state.waits.values()
                if wait.due is not None and wait.due <= now
            ]
            if not due:
                return
            self._trigger(min(due)[1], {}, now)

    def _trigger(self, wait: int, variables: dict[str, Any], now: datetime) -> None:
        """Let the event of a wait occur; if that fails, its token or scope gets an incident."""

        def blame(state: State, reason: str) -> Token:
            failed = state.waits.pop(wait)
            frame = state.frames[failed.frame]
            owner: Token | Frame = frame if failed.token is None else state.tokens[failed.token]
            owner.waits.remove(wait)
            token = next(iter(frame.tokens.values())) if failed.token is None else state.tokens[failed.token]
            return _stop(token, token.state if token.incident is None else token.incident.stage, reason, now)

        def act(machine: Machine) -> None:
            try:
                trigger(machine, self._state.waits[wait], variables)
            except (*STEP_FAILURES, ValueError) as failure:
                raise _StepFailed(text_of(failure)) from failure

        self._change(act, now, blame)

    def set_variables(self, values: Mapping[str, Any], now: datetime, *, token: str | None = None) -> None:
        """Set variables of the process, or those that a token sees where the nearest scope has them."""

        def act(machine: Machine) -> None:
            frame = self._state.root if token is None else machine.frame_of(self._token(token))
            machine.set_variables(frame, values)

        self._change(act, now, None)

    # What an engineer does

    def retry(self, token: str, now: datetime) -> None:
        """Let a token with an incident try again where it stopped."""

        def act(machine: Machine) -> None:
            found = self._token(token)
            if found.incident is None:
                raise RunFailed(f"the token {token} has no incident")
            stage, found.incident = found.incident.stage, None
            if stage is TokenState.WORK:
                open_work(machine, found)
            elif stage is TokenState.SCOPE and found.child is not None:
                found.state = stage
                frame = self._state.frames[found.child]
                machine.clear_waits(frame)
                with machine.failures(found):
                    register_event_subprocesses(machine, frame)
            else:
                machine.change_state(found, stage)

        self._change(act, now, None)

    def skip(self, token: str, results: Mapping[str, Any], now: datetime) -> None:
        """Let a token leave its node with `results`, without doing what the node asks for."""

        def act(machine: Machine) -> None:
            found = self._token(token)
            if found.state in {TokenState.READY, TokenState.FINISHING}:
                raise RunFailed(f"the token {token} is on its way")
            found.incident = None
            machine.undo_entry(found)
            found.results = dict(results) or None
            machine.change_state(found, TokenState.FINISHING)

        self._change(act, now, None)

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

        self._change(act, now, None)

    def cancel_token(self, token: str, now: datetime) -> None:
        """End a token where it is; its scope ends if it was the last one."""
        self._change(lambda machine: machine.remove(self._token(token)), now, None)

    # Steps

    def _machine(self, now: datetime) -> Machine:
        return Machine(self._state, self._library, now)

    def _token(self, token: str) -> Token:
        found = self._state.tokens.get(int(token)) if token.isdecimal() else None
        if found is None:
            raise RunFailed(message("process.no_such_token", 'there is no token "{token}"', token=token))
        return found

    def _change(
        self,
        act: Callable[[Machine], object],
        now: datetime,
        blame: Callable[[State, str], Token] | None,
    ) -> None:
        """Apply `act` and advance; after an unexpected failure restore the state, with an incident."""
        machine = self._machine(now)
        try:
            act(machine)
            self._settle(machine)
        except RunFailed:
            self._restore()
            raise
        except Exception as error:
            self._restore()
            reason = message(
                "process.engine_failed",
                "the engine failed: {error}",
                error=f"{type(error).__name__}: {error}",
            )
            if blame is None or self._saved is None:
                raise RunFailed(reason) from error
            log.exception("step of a process failed", definition=self.plan.definition.name)
            blame(self._state, reason)

    def _restore(self) -> None:
        if self._saved is not None:
            self._state = read_snapshot(self._saved, self._library)

    def _settle(self, machine: Machine) -> None:
        """Advance every token as far as possible."""
        self._process(machine)
        if not self._state.completed:
            find_stalled(machine)
        self.effects += machine.effects

    def _process(self, machine: Machine) -> None:
        while True:
            while machine.queue:
                self._process_token(machine, machine.queue.popleft())
            if check_joins(machine):
                continue
            if not machine.variables_changed:
                return
            machine.variables_changed = False
            for wait in conditions_that_became_true(machine):
                if wait.id in self._state.waits:
                    trigger(machine, wait, {})

    def _process_token(self, machine: Machine, token_id: int) -> None:
        token = self._state.tokens.get(token_id)
        if token is None or token.state not in {TokenState.READY, TokenState.FINISHING}:
            return
        stage = token.state
        node = machine.node(token)
        try:
            if stage is TokenState.FINISHING:
                finish(machine, token, node)
                return
            machine.steps += token.body is None  # the number of instances has a limit of its own
            if machine.steps > MAX_STEPS:
                raise _endless(machine, token, node)
            enter(machine, token, node)
        except STEP_FAILURES as failure:
            machine.raise_incident(token, text_of(failure), stage=stage)


def _open_activity(machine: Machine, token: Token) -> OpenActivity:
    node = machine.node(token)
    assert node.activity is not None  # noqa: S101 - only such a token works
    frame = machine.frame_of(token)
    data = {
        each.name or each.data: machine.data_owner(frame, each.data).get(each.data)
        for each in node.data_inputs
    }
    variables = machine.variables(token)
    return OpenActivity(str(token.id), machine.element(token), token.visit, node.activity, variables, data)


def _endless(machine: Machine, token: Token, node: Node) -> RunFailed:
    return RunFailed(
        message(
            "process.endless_loop",
            'at "{element}": {limit} steps without waiting for anything',
            element=node.name or machine.element(token),
            limit=MAX_STEPS,
        )
    )


def _stop(token: Token, stage: TokenState, reason: str, now: datetime) -> Token:
    token.incident = Incident(stage, reason, now)
    token.state = TokenState.INCIDENT
    return token
