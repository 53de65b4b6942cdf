"""Joins: where tokens that go side by side come together, once a round, each with what it has changed.

SpiffWorkflow counts and merges what came in earlier rounds of a loop as well; these gateways take every token
once. A variable has the value of the branch that changed it, the last one to come if several did.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from SpiffWorkflow.bpmn.exceptions import WorkflowTaskException
from SpiffWorkflow.bpmn.specs.defaults import InclusiveGateway, ParallelGateway
from SpiffWorkflow.bpmn.specs.mixins.unstructured_join import UnstructuredJoin
from SpiffWorkflow.bpmn.workflow import BpmnWorkflow
from SpiffWorkflow.task import Task as Token
from SpiffWorkflow.util.task import TaskState

_TAKEN = "taken"
_LIVE = TaskState.READY | TaskState.WAITING | TaskState.STARTED


def together(tokens: Iterable[Token]) -> dict[str, Any]:
    """Return the variables that `tokens`, in the order they came, make of those they started out with."""
    branches = list(tokens)
    paths = [path_to(token) for token in branches]
    common = [same[0] for same in zip(*paths, strict=False) if all(token is same[0] for token in same)]
    before: Mapping[str, Any] = common[-1].data if common else {}
    merged = dict(before)
    for token in branches:
        brought = token.data.items()
        merged |= {name: value for name, value in brought if name not in before or before[name] != value}
        for name in before.keys() - token.data.keys():
            merged.pop(name, None)
    return merged


def tell_taken(workflow: BpmnWorkflow) -> None:
    """Mark the tokens that were taken in a run that the first release has kept: it did not."""
    for spec in workflow.spec.task_specs.values():
        if not isinstance(spec, _Once):
            continue
        here = workflow.get_tasks(spec_name=spec.name)
        gone_on = [token.last_state_change for token in here if token.state == TaskState.COMPLETED]
        newest = max(gone_on, default=0.0)
        for token in here:
            if token.has_state(TaskState.FINISHED_MASK) and token.last_state_change <= newest:
                token.internal_data[_TAKEN] = True


class _Once(UnstructuredJoin):  # type: ignore[misc]
    """What both gateways share."""

    def _update_hook(self, my_task: Token) -> bool:
        my_task.data = dict(my_task.parent.data)
        for other in self._here(my_task):
            if other is not my_task and other.state == TaskState.WAITING:
                other.cancel()  # the newest waits for all; those before it still count as arrived
        if self._check_threshold_unstructured(my_task):
            return True
        my_task._set_state(TaskState.WAITING)
        return False

    def _here(self, my_task: Token) -> list[Token]:
        """Return the tokens that have come to this gateway and were not taken yet, the newest last."""
        found = [
            token
            for token in my_task.workflow.get_tasks(spec_name=self.name)
            if token.parent.state == TaskState.COMPLETED
            and _TAKEN not in token.internal_data
            and not my_task.is_descendant_of(token)
        ]
        return sorted(found, key=lambda token: (token is my_task, token.last_state_change))

    def _take(self, my_task: Token) -> None:
        """Take one token from each flow, and what they bring."""
        first: dict[Any, Token] = {}
        for token in self._here(my_task):
            first.setdefault(token.parent.task_spec, token)
        first[my_task.parent.task_spec] = my_task
        for token in first.values():
            token.internal_data[_TAKEN] = True
        my_task.data = together(token.parent for token in first.values())


class ParallelJoin(_Once, ParallelGateway):  # type: ignore[misc]
    """Goes on when a token has come in on every flow."""

    def _check_threshold_unstructured(self, my_task: Token) -> bool:
        arrived = {token.parent.task_spec for token in self._here(my_task)}
        return all(source in arrived for source in self.inputs)

    def _run_hook(self, my_task: Token) -> bool:
        self._take(my_task)
        return True


class InclusiveJoin(_Once, InclusiveGateway):  # type: ignore[misc]
    """Goes on when no token that is still under way can come on a flow on which none has come.

    One that could as well come again on a flow on which one has come is not waited for (as BPMN 2.0 has it).
    """

    def _check_threshold_unstructured(self, my_task: Token) -> bool:
        arrived = {token.parent.task_spec for token in self._here(my_task)}
        awaited = self._leading_to(source for source in self.inputs if source not in arrived)
        awaited -= self._leading_to(arrived)
        return not any(token.task_spec in awaited for token in my_task.workflow.get_tasks(state=_LIVE))

    def _leading_to(self, sources: Iterable[Any]) -> set[Any]:
        """Return the elements from which a token can get to `sources` without having been here."""
        leading: set[Any] = set()
        ahead = list(sources)
        while ahead:
            spec = ahead.pop()
            if spec is not self and spec not in leading:
                leading.add(spec)
                ahead += spec.inputs
        return leading

    def _run_hook(self, my_task: Token) -> bool:
        self._take(my_task)
        matches, defaults = self._get_matching_outputs(my_task)
        chosen = matches or defaults
        if not chosen:
            raise WorkflowTaskException("No conditions satisfied on gateway", task=my_task)
        my_task._sync_children(chosen, TaskState.FUTURE)
        for child in my_task.children:
            child.task_spec._predict(child, mask=TaskState.FUTURE | TaskState.PREDICTED_MASK)
        return True


def path_to(token: Token) -> list[Token]:
    """Return the tokens that led to `token`, itself included, the first one first."""
    path = [token]
    while path[-1].parent is not None:
        path.append(path[-1].parent)
    return path[::-1]
