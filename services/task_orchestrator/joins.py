"""Joins: gateways that merge parallel tokens, also inside loops.

SpiffWorkflow counts and merges tokens of earlier iterations of a loop as well; these gateways consume every
token once. A merged variable has the value of the branch that changed it, of the last token if several did.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from SpiffWorkflow.bpmn.exceptions import WorkflowTaskException
from SpiffWorkflow.bpmn.specs.defaults import InclusiveGateway, ParallelGateway
from SpiffWorkflow.bpmn.specs.mixins.unstructured_join import UnstructuredJoin
from SpiffWorkflow.task import Task as Token
from SpiffWorkflow.util.task import TaskState

_TAKEN = "taken"
_LIVE = TaskState.READY | TaskState.WAITING | TaskState.STARTED


def merge_variables(tokens: Iterable[Token]) -> dict[str, Any]:
    """Return the merged variables of `tokens`, which are in the order of arrival."""
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


class _Join(UnstructuredJoin):  # type: ignore[misc]
    """The common part of both gateways: it consumes each token once."""

    def _update_hook(self, my_task: Token) -> bool:
        my_task.data = dict(my_task.parent.data)
        for other in self._here(my_task):
            if other is not my_task and other.state == TaskState.WAITING:
                other.cancel()  # the newest token waits for all; earlier ones still count as arrived
        if self._check_threshold_unstructured(my_task):
            return True
        my_task._set_state(TaskState.WAITING)
        return False

    def _here(self, my_task: Token) -> list[Token]:
        """Return the tokens at this gateway that were not consumed yet, the newest last."""
        found = [
            token
            for token in my_task.workflow.get_tasks(spec_name=self.name)
            if token.parent.state == TaskState.COMPLETED
            and _TAKEN not in token.internal_data
            and not my_task.is_descendant_of(token)
        ]
        return sorted(found, key=lambda token: (token is my_task, token.last_state_change))

    def _take(self, my_task: Token) -> None:
        """Consume one token of each flow and merge their variables."""
        first: dict[Any, Token] = {}
        for token in self._here(my_task):
            first.setdefault(token.parent.task_spec, token)
        first[my_task.parent.task_spec] = my_task
        for token in first.values():
            token.internal_data[_TAKEN] = True
        my_task.data = merge_variables(token.parent for token in first.values())


class ParallelJoin(_Join, ParallelGateway):  # type: ignore[misc]
    """Continues when a token has arrived on every flow."""

    def _check_threshold_unstructured(self, my_task: Token) -> bool:
        arrived = {token.parent.task_spec for token in self._here(my_task)}
        return all(source in arrived for source in self.inputs)

    def _run_hook(self, my_task: Token) -> bool:
        self._take(my_task)
        return True


class InclusiveJoin(_Join, InclusiveGateway):  # type: ignore[misc]
    """Continues when no active token can arrive on a flow on which none has arrived.

    A token that could also arrive on a flow with an arrived token is not awaited (BPMN 2.0, 13.3.4).
    """

    def _check_threshold_unstructured(self, my_task: Token) -> bool:
        arrived = {token.parent.task_spec for token in self._here(my_task)}
        awaited = self._leading_to(source for source in self.inputs if source not in arrived)
        awaited -= self._leading_to(arrived)
        return not any(token.task_spec in awaited for token in my_task.workflow.get_tasks(state=_LIVE))

    def _leading_to(self, sources: Iterable[Any]) -> set[Any]:
        """Return the elements from which a token can reach `sources` without passing this gateway."""
        leading: set[Any] = set()
        stack = list(sources)
        while stack:
            spec = stack.pop()
            if spec is not self and spec not in leading:
                leading.add(spec)
                stack += spec.inputs
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
    """Return the ancestors of `token` and itself, the oldest first."""
    path = [token]
    while path[-1].parent is not None:
        path.append(path[-1].parent)
    return path[::-1]
