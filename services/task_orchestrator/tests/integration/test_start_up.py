"""Start-up reads the files of the definitions that something outside can start or change, and no others."""

from pathlib import Path

from handover.broker import BrokerClient
from handover_processes.running.orchestrator import Orchestrator
from services.task_orchestrator.tests.integration.rest import settings_in
from services.task_orchestrator.tests.unit.drawing import ONE_STEP, activity, drawing, end, path

BY_MESSAGE = (
    '<bpmn:startEvent id="start"><bpmn:messageEventDefinition messageRef="go"/></bpmn:startEvent>'
    + activity("work")
    + end()
    + path("start", "work", "end")
)


async def test_a_definition_is_read_at_start_up_only_if_events_start_it(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    message = '<bpmn:message id="go" name="go"/>'
    async with BrokerClient(settings) as broker, Orchestrator(settings, broker) as first:
        await first.deployments.deploy(drawing(ONE_STEP, name="by-hand"))
        await first.deployments.deploy(drawing(BY_MESSAGE, beside=message, name="by-message"))
    async with BrokerClient(settings) as broker, Orchestrator(settings, broker) as second:
        assert {name for name, _ in second.state.registry._plans} == {"by-message"}
        outcome, process = await second.processes.publish("go", variables={})
        assert (outcome.value, str(process).startswith("by-message-")) == ("started", True)
        by_hand, _ = await second.processes.start("by-hand", {})
        assert by_hand in second.state.active_processes.processes
