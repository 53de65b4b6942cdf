"""Adapters for SpiffWorkflow: our expressions replace Python, and the time of the run replaces its clock."""

from datetime import datetime
from typing import Any

from SpiffWorkflow.bpmn.parser.BpmnParser import BpmnParser
from SpiffWorkflow.bpmn.parser.task_parsers import ConditionalGatewayParser, GatewayParser
from SpiffWorkflow.bpmn.parser.TaskParser import TaskParser
from SpiffWorkflow.bpmn.script_engine import PythonScriptEngine
from SpiffWorkflow.bpmn.script_engine.python_environment import BasePythonScriptEngineEnvironment
from SpiffWorkflow.bpmn.specs.defaults import UserTask
from SpiffWorkflow.bpmn.specs.event_definitions.timer import TimerEventDefinition
from SpiffWorkflow.task import Task as Token

from services.task_orchestrator.definition import HANDED_OVER, Kind
from services.task_orchestrator.joins import InclusiveJoin, ParallelJoin
from services.task_orchestrator.languages.base import within_limits
from services.task_orchestrator.languages.native import ExpressionError, read, read_script
from services.task_orchestrator.timers import due_at, is_time
from services.task_orchestrator.xml_names import qualified


class _Environment(BasePythonScriptEngineEnvironment):  # type: ignore[misc]
    """Evaluates our expressions where SpiffWorkflow would evaluate Python."""

    def evaluate(self, expression: str, context: Any, external_context: Any = None) -> Any:
        del external_context
        return read(expression).value(context)

    def execute(self, script: str, context: Any, external_context: Any = None) -> bool:
        del external_context
        for name, expression in read_script(script):
            context[name] = within_limits(expression.value(context))
        return True


class Scripts(PythonScriptEngine):  # type: ignore[misc]
    """The script engine of one run, with the time of the run."""

    def __init__(self, now: datetime) -> None:
        super().__init__(_Environment())
        self.now = now

    def evaluate(self, task: Token, expression: str, external_context: Any = None) -> Any:
        """Return the value of `expression` with the variables of the token `task`."""
        return self.environment.evaluate(expression, task.data, external_context)

    def execute(self, task: Token, script: str, external_context: Any = None) -> Any:
        """Execute `script` on the variables of the token `task`."""
        return self.environment.execute(script, task.data, external_context)


class Timer(TimerEventDefinition):  # type: ignore[misc]
    """A timer that uses the time of the run, so that it can be tested and survives a restart."""

    def has_fired(self, my_task: Token) -> bool:
        """Return whether it is due; the first call computes the due time."""
        scripts = my_task.workflow.script_engine
        moment = my_task.internal_data.get("due")
        if moment is None:
            text = self.expression.strip()
            if not is_time(text):
                text = scripts.evaluate(my_task, text)
            if not isinstance(text, str):
                raise ExpressionError(f"`{self.expression}` yields no duration or moment")
            moment = due_at(text, scripts.now).isoformat()
            my_task.internal_data["due"] = moment
        if datetime.fromisoformat(moment) <= scripts.now:
            my_task.internal_data["event_fired"] = True
        return bool(my_task.internal_data.get("event_fired", False))

    def reset(self, my_task: Token) -> None:
        """Delete the due time; the next call of `has_fired` computes it again."""
        my_task.internal_data.pop("due", None)
        super().reset(my_task)


class Parser(BpmnParser):  # type: ignore[misc]
    """Reads all kinds of activities alike: each waits for its result."""

    OVERRIDE_PARSER_CLASSES = {  # noqa: RUF012
        **{qualified(kind.value): (TaskParser, UserTask) for kind in HANDED_OVER},
        qualified(Kind.PARALLEL.value): (GatewayParser, ParallelJoin),
        qualified(Kind.INCLUSIVE.value): (ConditionalGatewayParser, InclusiveJoin),
    }
