"""Priorities, due dates and escalations of Tasks."""

from datetime import timedelta
from typing import Any

from handover_datamodels.times import iso
from handover_processes.people_acts import offer_of
from handover_processes.process import interventions
from handover_processes.records.messages import MessageKind
from handover_processes.records.processes import Act, ActKind
from handover_processes.records.step import Step
from services.task_orchestrator.tests.unit.drawing import NOW, activity, boundary, end, path, start
from services.task_orchestrator.tests.unit.process_driver import ProcessDriver, alerts, task_id

LATE = '<bpmn:escalation id="late" escalationCode="late"/>'


def scheduled(attributes: str, *levels: str, of: str = "Device:glove-1") -> str:
    task = activity("work", attributes=attributes)
    if not of:
        task = task.replace('<handover:involves resource="Device:glove-1"/>', "")
    task = task.replace("<bpmn:extensionElements>", f"<bpmn:extensionElements>{''.join(levels)}")
    return start() + task + end() + path("start", "work", "end")


def posted(step: Step) -> Any:
    (message,) = [each for each in step.messages if each.kind is MessageKind.CREATE]
    return message.body


def wait(driver: ProcessDriver, **time: float) -> None:
    driver.after(**time)
    driver.tick()


def changes(step: Step) -> list[Any]:
    return [each.body for each in step.messages if each.kind is MessageKind.APPEND]


def cleared(step: Step) -> list[str]:
    return [message.body["key"] for message in step.messages if message.kind is MessageKind.CLEAR]


def test_a_task_has_priority_due_date_and_follow_up_date() -> None:
    due = iso(NOW + timedelta(hours=2))
    driver = ProcessDriver(scheduled(f'priority="80" dueDate="{due}" followUpDate="PT1H"'))
    entity = posted(driver.step)
    assert entity["priority"]["value"] == 80
    assert entity["dueDate"]["value"] == {"@type": "DateTime", "@value": due}
    assert entity["followUpDate"]["value"]["@value"] == iso(NOW + timedelta(hours=1))
    assert not {"priority", "dueDate", "followUpDate"} & posted(ProcessDriver(scheduled("")).step).keys()


def test_an_expression_gives_the_due_date_from_the_present_time() -> None:
    driver = ProcessDriver(
        scheduled('priority="${urgent ? 90 : 10}" dueDate="${wanted}"'), urgent=True, wanted="PT5M"
    )
    entity = posted(driver.step)
    assert entity["priority"]["value"] == 90
    assert entity["dueDate"]["value"]["@value"] == iso(NOW + timedelta(minutes=5))


def test_an_expression_of_a_task_reads_the_time_of_its_posting() -> None:
    driver = ProcessDriver(scheduled('dueDate="${now()}"'))
    assert posted(driver.step)["dueDate"]["value"]["@value"] == iso(NOW)


def test_a_task_past_its_due_date_raises_an_alert_until_it_ends() -> None:
    driver = ProcessDriver(scheduled('dueDate="PT10M" deadline="P1D"'))
    assert driver.process.next_due() == NOW + timedelta(minutes=10)
    driver.receive("work-1", "inProgress")
    wait(driver, minutes=10)
    (alert,) = alerts(driver.step)
    assert alert["sub_category"] == "taskPastDue"
    assert driver.process.next_due() is None
    driver.receive("work-1", "completed")
    assert cleared(driver.step) == [alert["key"]]


def test_levels_follow_the_due_date_and_add_groups_to_a_task_for_people() -> None:
    levels = (
        '<handover:escalation after="PT30M" group="managers"/>',
        '<handover:escalation after="PT5M" group="leads"/>',
    )
    driver = ProcessDriver(scheduled('dueDate="PT10M" deadline="P1D" candidateGroups="team"', *levels, of=""))
    wait(driver, minutes=10)
    assert len(alerts(driver.step)) == 1
    wait(driver, minutes=5)
    (change,) = changes(driver.step)
    assert change["workParameters"]["value"]["candidates"]["groups"] == ["team", "leads"]
    (known,) = driver.process.tasks.values()
    assert offer_of(known).groups == ("team", "leads")
    wait(driver, minutes=25)
    (change,) = changes(driver.step)
    assert change["workParameters"]["value"]["candidates"]["groups"] == ["team", "leads", "managers"]
    driver.receive("work-1", "completed")
    assert len(cleared(driver.step)) == 3


def test_an_escalation_without_a_due_date_counts_from_the_posting_and_is_caught() -> None:
    caught = boundary(
        "caught", "work", '<bpmn:escalationEventDefinition escalationRef="late"/>', interrupting=False
    )
    body = scheduled('deadline="P1D"', '<handover:escalation after="PT5M" code="late"/>')
    body += caught + activity("help") + path("caught", "help", "end")
    driver = ProcessDriver(body, beside=LATE)
    wait(driver, minutes=5)
    assert driver.open == ["help-1", "work-1"]
    assert len(alerts(driver.step)) == 1


def test_an_interrupting_escalation_cancels_the_task() -> None:
    caught = boundary("caught", "work", '<bpmn:escalationEventDefinition escalationRef="late"/>')
    body = scheduled('deadline="P1D"', '<handover:escalation after="PT5M" code="late"/>')
    driver = ProcessDriver(body + caught + path("caught", "end"), beside=LATE)
    wait(driver, minutes=5)
    assert driver.process.tasks[task_id("work-1")].cancelled_at is not None
    assert driver.process.run is None


def test_a_task_of_a_robot_is_escalated_by_alerts_only() -> None:
    driver = ProcessDriver(scheduled('deadline="P1D"', '<handover:escalation after="PT5M" group="leads"/>'))
    wait(driver, minutes=5)
    assert changes(driver.step) == []
    (alert,) = alerts(driver.step)
    assert "leads" in alert["description"]


def test_nothing_escalates_while_the_process_is_paused_or_after_the_end() -> None:
    driver = ProcessDriver(scheduled('dueDate="PT10M" deadline="P1D"'))
    interventions.pause(driver.process, Act(driver.now, ActKind.PAUSE, "Ann"), driver.next_step(), driver.now)
    wait(driver, hours=1)
    assert alerts(driver.step) == []
    interventions.resume_work(
        driver.process, Act(driver.now, ActKind.RESUME, "Ann"), driver.next_step(), driver.now
    )
    wait(driver, seconds=0)
    assert len(alerts(driver.step)) == 1
    ended = ProcessDriver(scheduled('dueDate="PT10M"'))
    ended.receive("work-1", "completed")
    assert ended.process.next_due() is None
