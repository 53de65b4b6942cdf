"""Engine: executes a process, token by token. Only this module, `spiff.py` and `joins.py` use SpiffWorkflow.

A `Plan` is built from a definition once. Each `Run` of it gets the results of its activities and the time,
and returns the open activities. Python in a BPMN file is never evaluated: our expression language replaces
the script engine of SpiffWorkflow.
"""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any
from uuid import UUID

import orjson
from SpiffWorkflow.bpmn.specs.control import BoundaryEventSplit, _EndJoin
from SpiffWorkflow.bpmn.specs.defaults import BoundaryEvent, UserTask
from SpiffWorkflow.bpmn.specs.event_definitions import ErrorEventDefinition
from SpiffWorkflow.bpmn.specs.mixins.events.event_types import CatchingEvent
from SpiffWorkflow.bpmn.specs.mixins.unstructured_join import UnstructuredJoin
from SpiffWorkflow.bpmn.workflow import BpmnWorkflow
from SpiffWorkflow.exceptions import SpiffWorkflowException
from SpiffWorkflow.task import Task as Token
from SpiffWorkflow.util.deep_merge import DeepMerge
from SpiffWorkflow.util.task import TaskState

from handover.errors import HandoverError
from handover.messages import message, text_of
from services.task_orchestrator.bpmn import bare_process
from services.task_orchestrator.definition import Definition, Kind, Trigger
from services.task_orchestrator.joins import InclusiveJoin, merge_variables, path_to
from services.task_orchestrator.languages.native import ExpressionError
from services.task_orchestrator.spiff import Parser, Scripts, Timer

for _chatty in ("spiff.task", "spiff.workflow"):
    logging.getLogger(_chatty).setLevel(logging.WARNING)  # by default it lists every token for each log line

MAX_STEPS = 300
"""Gateways and scripts that a token may pass without waiting; more are an endless loop."""
MAX_BYTES = 4 * 1024 * 1024
"""Size of a serialized run; the variables are most of it."""
PRUNE_ABOVE = 60
SNAPSHOT_VERSION = 1


class RunFailed(HandoverError):
    """A process cannot continue; the text names the element and the reason."""


@dataclass(frozen=True, slots=True)
class Open:
    """An activity that a token has reached: `visit` counts from 1, `variables` are those of the token."""

    token: str
    element: str
    visit: int
    variables: Mapping[str, Any] = field(repr=False)


_OURS = "at."
"""Prefix of the ids of elements; it avoids collisions with SpiffWorkflow's own element "Start"."""


def _element(token: Token) -> str:
    """Return the id of the element of `token`; elements of SpiffWorkflow keep their names."""
    return str(token.task_spec.name).removeprefix(_OURS)


class Plan:
    """A definition that can be executed. Raises `RunFailed` if SpiffWorkflow cannot read it."""

    def __init__(self, definition: Definition) -> None:
        self.definition = definition
        parser = Parser()
        try:
            parser.add_bpmn_xml(bare_process(definition, _OURS))
            self.spec = parser.get_process_parser(definition.name).get_spec()
        except (SpiffWorkflowException, ValueError, TypeError, AttributeError, RecursionError) as error:
            raise RunFailed(
                message(
                    "process.not_executable",
                    "the engine cannot execute this model: {error}",
                    error=text_of(error),
                )
            ) from error
        for node in definition.nodes.values():
            if node.trigger is Trigger.TIMER:
                spec = self.spec.task_specs[_OURS + node.id]
                spec.event_definition = Timer(node.id, spec.event_definition.expression)

    def start(self, variables: Mapping[str, Any], now: datetime) -> "Run":
        """Return a new run with `variables`, advanced as far as possible at `now`."""
        workflow = BpmnWorkflow(self.spec, script_engine=Scripts(now))
        workflow.task_tree.data = dict(variables)
        run = Run(self, workflow, {}, {})
        run.advance(now)
        return run

    def resume(self, snapshot: bytes) -> "Run":
        """Return the run of a `snapshot`; raise `RunFailed` if another release has written it."""
        kept = orjson.loads(snapshot)
        if kept["version"] != SNAPSHOT_VERSION:
            raise RunFailed(
                message(
                    "process.unknown_state_version",
                    "this release cannot read a run of the format {version}",
                    version=kept["version"],
                )
            )
        scripts = Scripts(datetime.now(UTC))
        workflow = BpmnWorkflow(self.spec, deserializing=True, script_engine=scripts)
        for row in kept["tokens"]:
            _restore(workflow, row)
        workflow.task_tree = workflow.tasks[UUID(kept["tokens"][0]["id"])]
        workflow.last_task = workflow.tasks.get(UUID(kept["last"])) if kept["last"] else None
        workflow.completed, workflow.data = kept["completed"], kept["data"]
        return Run(
            self, workflow, kept["visits"], {token: tuple(open_) for token, open_ in kept["open"].items()}
        )


class Run:
    """The execution of one process. Not thread-safe."""

    def __init__(
        self, plan: Plan, workflow: BpmnWorkflow, visits: dict[str, int], seen: dict[str, tuple[str, int]]
    ) -> None:
        self.plan = plan
        self._workflow = workflow
        self._visits = visits
        self._seen = seen

    @property
    def completed(self) -> bool:
        """Return whether all tokens have ended."""
        return bool(self._workflow.is_completed())

    def variables(self) -> dict[str, Any]:
        """Return the process variables of the most advanced token; at the end, all of them."""
        if self.completed:
            return dict(self._workflow.data)
        return merge_variables(self._live())

    def open(self) -> tuple[Open, ...]:
        """Return the open activities, in the order in which they were reached."""
        return tuple(
            Open(token, element, visit, self._workflow.tasks[UUID(token)].data)
            for token, (element, visit) in self._seen.items()
        )

    def waiting(self) -> tuple[str, ...]:
        """Return the ids of the elements at which tokens wait, including timers."""
        names = {_element(token) for token in self._live()}
        return tuple(name for name in self.plan.definition.nodes if name in names)

    def next_due(self) -> datetime | None:
        """Return when the next timer is due; None without one."""
        moments = [
            token.internal_data.get("due") for token in self._live() if token.state == TaskState.WAITING
        ]
        return min((datetime.fromisoformat(moment) for moment in moments if moment), default=None)

    def complete(self, token: str, results: Mapping[str, Any], now: datetime) -> None:
        """Complete the activity of `token`, with its `results` as process variables."""
        activity = self._token(token)
        activity.data.update(results)
        with _failures(_element(activity)):
            activity.run()
        self.advance(now)

    def fail(self, token: str, error: Mapping[str, Any], now: datetime) -> bool:
        """Continue at the error boundary event that catches `error` (its `code` may be None).

        Returns False without a change when there is none. The process variable `error` holds the details.
        """
        activity = self._token(token)
        catcher = _catcher(activity, error.get("code"))
        if catcher is None:
            return False
        self._workflow.script_engine.now = now
        with _failures(_element(catcher)):
            catcher.internal_data["event_fired"] = True
            catcher.task_spec._update(catcher)
            catcher.data["error"] = dict(error)
        self.advance(now)
        return True

    def is_open(self, token: str) -> bool:
        """Return whether the activity of `token` is open."""
        return token in self._seen

    def visit_again(self, token: str) -> Open:
        """Count another visit of the activity of `token`, which is to be repeated."""
        element, _ = self._seen[token]
        self._visits[element] += 1
        self._seen[token] = (element, self._visits[element])
        return Open(token, element, self._visits[element], self._token(token).data)

    def restart_timers(self, now: datetime) -> None:
        """Restart the boundary timers of open activities at `now`, since the activities are repeated.

        Other timers have continued meanwhile. Raises `RunFailed` if one of them cannot be processed.
        """
        for token in self._live():
            if isinstance(token.task_spec, BoundaryEvent) and token.state == TaskState.WAITING:
                token.internal_data.pop("due", None)
        self.advance(now)

    def advance(self, now: datetime) -> None:
        """Advance every token as far as possible at `now`; raise `RunFailed` if one cannot continue."""
        self._workflow.script_engine.now = now
        self._prune()
        self._refresh_timers()
        steps = 0
        while ready := [t for t in self._workflow.get_tasks(state=TaskState.READY) if not t.task_spec.manual]:
            for token in ready:
                steps += 1
                if steps > MAX_STEPS:
                    raise RunFailed(
                        message(
                            "process.endless_loop",
                            'at "{element}": {limit} steps without waiting for anything',
                            element=_element(token),
                            limit=MAX_STEPS,
                        )
                    )
                if token.state == TaskState.READY:
                    self._step(token)
            self._refresh_timers()
            self._update_joins()
        self._record_open()

    def snapshot(self) -> bytes:
        """Return the serialized run; raise `RunFailed` if its variables are too large."""
        workflow = self._workflow
        content = {
            "version": SNAPSHOT_VERSION,
            "tokens": [_kept(token) for token in _under(workflow.tasks, workflow.task_tree)],
            "last": str(workflow.last_task.id) if workflow.last_task is not None else None,
            "completed": workflow.completed,
            "data": workflow.data,
            "visits": self._visits,
            "open": self._seen,
        }
        try:
            kept = orjson.dumps(content)
        except TypeError as error:
            raise RunFailed(
                message(
                    "process.variable_not_json",
                    "a process variable is no JSON: {error}",
                    error=text_of(error),
                )
            ) from error
        if len(kept) > MAX_BYTES:
            raise RunFailed(
                message(
                    "process.variables_too_large",
                    "the process variables take more than {limit} bytes",
                    limit=MAX_BYTES,
                )
            )
        return kept

    def _token(self, token: str) -> Token:
        return self._workflow.tasks[UUID(token)]

    def _step(self, token: Token) -> None:
        name = _element(token)
        node = self.plan.definition.nodes.get(name)
        with _failures(name):
            token.run()
        if node is not None and node.kind is Kind.END and node.trigger is Trigger.ERROR:
            raise RunFailed(
                message("process.error_end_event", 'the error end event "{node}" was reached', node=node.name)
            )

    def _refresh_timers(self) -> None:
        with _failures("a timer"):
            self._workflow.refresh_timers()

    def _update_joins(self) -> None:
        """Have inclusive gateways check again whether another token can arrive."""
        for token in self._workflow.get_tasks(state=TaskState.WAITING):
            if isinstance(token.task_spec, InclusiveJoin):
                with _failures(_element(token)):
                    token.task_spec._update(token)

    def _live(self) -> list[Token]:
        return [
            token
            for token in self._workflow.tasks.values()
            if token.has_state(TaskState.READY | TaskState.WAITING | TaskState.STARTED)
        ]

    def _record_open(self) -> None:
        ready = {
            str(token.id): _element(token)
            for token in self._workflow.get_tasks(state=TaskState.READY)
            if isinstance(token.task_spec, UserTask)
        }
        self._seen = {token: open_ for token, open_ in self._seen.items() if token in ready}
        for token, element in ready.items():
            if token not in self._seen:
                self._visits[element] = self._visits.get(element, 0) + 1
                self._seen[token] = (element, self._visits[element])

    def _prune(self) -> None:
        """Delete the steps that no active token refers to, so that the cost of a loop stays constant."""
        tasks, root, live = self._workflow.tasks, self._workflow.task_tree, self._live()
        if len(tasks) <= PRUNE_ABOVE or not live:
            return
        if any(isinstance(token.task_spec, UnstructuredJoin | _EndJoin) for token in live):
            return
        paths = [path_to(token) for token in live]
        common = [same[0] for same in zip(*paths, strict=False) if all(token is same[0] for token in same)]
        while common and (common[-1] in live or isinstance(common[-1].task_spec, BoundaryEventSplit)):
            common.pop()
        if len(common) < 3:
            return
        first = common[-1]
        first.parent = root
        root.children = [first]
        self._workflow.tasks = {token.id: token for token in _under(self._workflow.tasks, root)}
        if self._workflow.last_task.id not in self._workflow.tasks:
            self._workflow.last_task = first


@contextmanager
def _failures(element: str) -> Iterator[None]:
    """Convert any exception inside into a `RunFailed` that names the element."""
    try:
        yield
    except (SpiffWorkflowException, ExpressionError, ValueError) as error:
        raise RunFailed(
            message("process.failed_at", 'at "{element}": {why}', element=element, why=str(error).strip(" ."))
        ) from error


def _catcher(activity: Token, code: Any) -> Token | None:
    """Return the error boundary event of `activity` for `code`: one with that code, else one without."""
    if activity.parent is None or not isinstance(activity.parent.task_spec, BoundaryEventSplit):
        return None
    catchers = {
        sibling.task_spec.event_definition.code: sibling
        for sibling in activity.parent.children
        if isinstance(sibling.task_spec, BoundaryEvent)
        and isinstance(sibling.task_spec.event_definition, ErrorEventDefinition)
        and sibling.state == TaskState.WAITING
    }
    return catchers.get(code) or catchers.get(None)


def _under(tasks: Mapping[UUID, Token], first: Token) -> Iterator[Token]:
    """Yield the tokens, each after its parent."""
    stack = [first]
    while stack:
        token = stack.pop()
        yield token
        stack.extend(tasks[child] for child in reversed(token._children))


def _kept(token: Token) -> dict[str, Any]:
    before = token.parent.data if token.parent is not None else {}
    return {
        "id": str(token.id),
        "parent": str(token._parent) if token._parent is not None else None,
        "spec": token.task_spec.name,
        "state": token.state,
        "since": token.last_state_change,
        "internal": token.internal_data,
        "set": DeepMerge.get_updated_keys(before, token.data),
        "unset": DeepMerge.get_deleted_keys(before, token.data),
    }


def _restore(workflow: BpmnWorkflow, row: Mapping[str, Any]) -> None:
    parent = workflow.tasks[UUID(row["parent"])] if row["parent"] is not None else None
    token = Token(workflow, workflow.spec.task_specs[row["spec"]], parent, row["state"], UUID(row["id"]))
    token.last_state_change = row["since"]
    token.internal_data = row["internal"]
    token.data = {**(parent.data if parent is not None else {}), **row["set"]}
    for name in row["unset"]:
        del token.data[name]
    if parent is not None:
        token.thread_id = parent.thread_id
    if isinstance(token.task_spec, CatchingEvent) and token.has_state(TaskState.WAITING):
        workflow.event_manager.add_task(token)
