"""Advance: moves the tokens of a process as far as they get without a performer, timer or message."""

from handover.messages import text_of
from handover_bpmn.execution.activities import finish, leave
from handover_bpmn.execution.compensation import continue_compensation
from handover_bpmn.execution.events import enter, trigger
from handover_bpmn.execution.machine import ACTIVE, Machine
from handover_bpmn.execution.navigation import check_joins, find_stalled
from handover_bpmn.execution.state import RunFailed, TokenState
from handover_bpmn.execution.waits import conditions_that_became_true
from handover_bpmn.languages.base import ExpressionError

STEP_FAILURES = (RunFailed, ExpressionError)


def settle(machine: Machine) -> None:
    """Advance every token as far as possible."""
    while True:
        while machine.queue:
            _process_token(machine, machine.queue.popleft())
        if check_joins(machine):
            continue
        if not machine.variables_changed:
            break
        machine.variables_changed = False
        for wait in conditions_that_became_true(machine):
            if wait.id in machine.state.waits:
                trigger(machine, wait, {})
    if not machine.state.completed:
        find_stalled(machine)


def _process_token(machine: Machine, token_id: int) -> None:
    token = machine.state.tokens.get(token_id)
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
