"""A process: which Tasks it hands out, what it believes, and how it ends. Steps are looked at, not sent."""

from datetime import timedelta

import pytest

from handover.errors import Problem
from handover_datamodels.entities import Task, TaskStatus
from handover_processes.process import interventions, task_troubles
from handover_processes.process.process import Process
from handover_processes.records.messages import MessageKind
from handover_processes.records.processes import Act, ActKind
from handover_processes.records.timers import TimerKind
from services.task_orchestrator.tests.unit.drawing import (
    NOW,
    ONE_STEP,
    activity,
    boundary,
    end,
    flow,
    gateway,
    path,
    start,
    timer,
)
from services.task_orchestrator.tests.unit.process_driver import (
    DEFINED_BY,
    ProcessDriver,
    alerts,
    created,
    processes,
    task_id,
)

TWO_STEPS = start() + activity("first") + activity("second") + end() + path("start", "first", "second", "end")


def test_a_task_is_posted_pending_with_all_that_is_asked() -> None:
    inner = (
        '<handover:involves expression="helper"/>'
        '<handover:happensAt location="Location:bin-1" function="source"/>'
        "<handover:happensAt expression=\"'Location:' + place\"/>"
        '<handover:parameter name="commandId" value="3"/>'
        '<handover:parameter name="where" expression="place"/>'
    )
    body = (
        start() + activity("work", inner, attributes='deadline="PT5M"') + end() + path("start", "work", "end")
    )
    driver = ProcessDriver(body, helper="urn:ngsi-ld:Person:demo:ann", place="table")
    posted = next(message.body for message in driver.step.messages if message.kind is MessageKind.CREATE)
    assert posted == {
        "id": task_id("work-1"),
        "type": "Task",
        "isDefinedBy": DEFINED_BY,
        "status": {"type": "Property", "value": "pending", "observedAt": "2026-05-04T08:00:00.000000Z"},
        "involves": {
            "type": "Property",
            "value": [
                {"type": "Relationship", "object": "urn:ngsi-ld:Device:demo:glove-1"},
                {"type": "Relationship", "object": "urn:ngsi-ld:Person:demo:ann"},
            ],
        },
        "workParameters": {"type": "Property", "value": {"commandId": 3, "where": "table"}},
        "deadline": {
            "type": "Property",
            "value": {"@type": "DateTime", "@value": "2026-05-04T08:05:00.000000Z"},
        },
        "happensAt": {
            "type": "Property",
            "value": [
                {
                    "type": "Relationship",
                    "object": "urn:ngsi-ld:Location:demo:bin-1",
                    "locationFunction": {"type": "Property", "value": "source"},
                },
                {"type": "Relationship", "object": "urn:ngsi-ld:Location:demo:table"},
            ],
        },
    }
    assert Task.from_ngsild(posted).status.value is TaskStatus.PENDING


def involved(driver: ProcessDriver) -> list[str]:
    """Return the names of what the only new Task involves."""
    (posted,) = (message.body for message in driver.step.messages if message.kind is MessageKind.CREATE)
    return [link["object"].rpartition("demo:")[2] for link in posted["involves"]["value"]]


def test_a_task_involves_the_materials_and_assets_that_it_uses_after_its_performer() -> None:
    inner = (
        '<handover:involves resource="Asset:hammer"/>'
        '<handover:material entity="Material:gear-1"/>'
        '<handover:material expression="parts"/>'
        '<handover:asset expression="carrier"/>'
    )
    driver = ProcessDriver(
        start() + activity("work", inner) + end() + path("start", "work", "end"),
        parts=["Material:gear-2", "Material:gear-1"],
        carrier={"id": "urn:ngsi-ld:Asset:demo:tray-4", "type": "Asset"},
    )
    assert involved(driver) == ["glove-1", "gear-1", "gear-2", "hammer", "tray-4"]
    assert driver.process.allocator.tasks_of("urn:ngsi-ld:Device:demo:glove-1") == [task_id("work-1")]


def test_a_task_of_a_role_uses_materials_too() -> None:
    task = '<handover:task definition="x"><handover:material entity="Material:gear-1"/></handover:task>'
    extended = f"<bpmn:extensionElements>{task}</bpmn:extensionElements>"
    body = f'<bpmn:userTask id="work">{extended}</bpmn:userTask>'
    driver = ProcessDriver(start() + body + end() + path("start", "work", "end"))
    assert involved(driver) == ["gear-1"]
    assert not driver.process.allocator.tasks_of("urn:ngsi-ld:Material:demo:gear-1")


def test_a_process_says_what_it_is_composed_of_and_how_it_ended() -> None:
    driver = ProcessDriver(TWO_STEPS, bin="bin-1")
    driver.receive("first-1", "completed", weight=3)
    assert created(driver.step) == [task_id("second-1")]
    reported = processes(driver.step)[-1]
    assert [link["object"] for link in reported["isComposedOf"]["value"]] == [
        task_id("first-1"),
        task_id("second-1"),
    ]
    driver.receive("second-1", "completed")
    reported = processes(driver.step)[-1]
    assert reported["status"]["value"] == "completed"
    assert reported["outputParameters"]["value"] == {"first": {"weight": 3}, "second": {}}
    assert reported["workParameters"]["value"] == {"bin": "bin-1"}
    assert driver.process.over


def test_an_observer_may_miss_steps_but_never_goes_back() -> None:
    driver = ProcessDriver(TWO_STEPS)
    driver.after(seconds=5)
    assert driver.receive("first-1", "inProgress")
    assert not driver.receive("first-1", "assigned", at=NOW + timedelta(seconds=6))
    assert not driver.receive("first-1", "pending", at=NOW + timedelta(seconds=9))
    assert not driver.step
    driver.after(seconds=1)
    assert driver.receive("first-1", "completed")


def test_a_performer_whose_clock_is_slow_is_believed_and_the_record_keeps_the_later_time() -> None:
    driver = ProcessDriver(TWO_STEPS)
    assert driver.receive("first-1", "inProgress", at=NOW - timedelta(seconds=30))
    assert driver.step.tasks[task_id("first-1")].observed_at == NOW
    assert driver.receive("first-1", "completed", at=NOW - timedelta(seconds=20))
    assert driver.open == ["second-1"]


def test_a_finished_task_never_reopens() -> None:
    driver = ProcessDriver(TWO_STEPS)
    assert driver.receive("first-1", "completed")
    driver.after(seconds=1)
    assert not driver.receive("first-1", "inProgress")
    assert not driver.receive("first-1", "failed")
    assert driver.open == ["second-1"]


def test_a_change_received_twice_is_applied_once() -> None:
    driver = ProcessDriver(TWO_STEPS)
    assert driver.receive("first-1", "completed")
    assert not driver.receive("first-1", "completed")
    assert driver.process.composed == [task_id("first-1"), task_id("second-1")]


def test_a_failed_task_is_an_incident_with_an_alert() -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.receive("work-1", "failed", reason="the part slipped", errorCode="E7")
    record = driver.process.record
    assert record.status is TaskStatus.IN_PROGRESS
    (incident,) = record.incidents
    assert (incident.element, incident.reason, incident.task, incident.code) == (
        "work",
        "the part slipped",
        task_id("work-1"),
        "E7",
    )
    (alert,) = alerts(driver.step)
    assert alert["sub_category"] == "processIncident"
    assert alert["source"] == "urn:ngsi-ld:Process:demo:p-1"


def test_a_failed_task_with_a_boundary_event_goes_on_without_an_alert() -> None:
    caught = (
        boundary("oops", "work", "<bpmn:errorEventDefinition/>")
        + activity("help")
        + path("oops", "help", "end")
    )
    driver = ProcessDriver(ONE_STEP + caught)
    driver.receive("work-1", "failed", reason="the part slipped", errorCode=7)
    assert driver.open == ["help-1"]
    assert alerts(driver.step) == []
    assert driver.process.record.variables["error"] == {
        "activity": "work",
        "reason": "the part slipped",
        "code": "7",
    }


FORK = (
    start()
    + gateway("fork", "parallel")
    + activity("a")
    + activity("b")
    + end()
    + end("oops", '<bpmn:errorEventDefinition errorRef="wrong"/>')
    + gateway("which", default="which_end")
    + path("start", "fork", "a", "which", "end")
    + path("fork", "b", "end")
    + flow("which", "oops", "a.bad")
)


def test_an_incident_leaves_the_other_branches_alone() -> None:
    driver = ProcessDriver(FORK, beside='<bpmn:error id="wrong"/>')
    driver.receive("a-1", "failed", reason="no")
    assert driver.open == ["b-1"]
    assert [message for message in driver.step.messages if message.kind is MessageKind.APPEND] == []
    driver.receive("b-1", "completed")
    assert driver.process.record.status is TaskStatus.IN_PROGRESS


def test_a_process_that_ends_by_an_error_calls_its_other_tasks_back() -> None:
    driver = ProcessDriver(FORK, beside='<bpmn:error id="wrong"/>')
    driver.receive("a-1", "completed", bad=True)
    assert driver.process.record.status is TaskStatus.FAILED
    assert "oops" in str(driver.process.record.reason)
    assert [alert["sub_category"] for alert in alerts(driver.step)] == ["processFailed"]
    (asked,) = [message for message in driver.step.messages if message.kind is MessageKind.APPEND]
    assert asked.subject == task_id("b-1")
    assert asked.body["requestedStatus"]["value"] == "cancelled"
    assert not driver.process.over
    driver.after(seconds=1)
    driver.receive("b-1", "failed", reason="cancelled")
    assert driver.process.over


def test_a_cancelled_process_ends_failed_and_calls_its_tasks_back() -> None:
    driver = ProcessDriver(ONE_STEP)
    interventions.cancel(driver.process, None, driver.next_step(), NOW)
    assert processes(driver.step)[-1]["status"]["value"] == "failed"
    assert processes(driver.step)[-1]["outputParameters"]["value"] == {"reason": "cancelled"}
    assert alerts(driver.step) == []
    with pytest.raises(Problem, match="ended"):
        interventions.cancel(driver.process, None, driver.next_step(), NOW)


def test_a_cancelled_task_nobody_took_up_is_closed_after_a_grace() -> None:
    driver = ProcessDriver(ONE_STEP)
    interventions.cancel(driver.process, None, driver.next_step(), NOW)
    assert [timer.kind for timer in driver.process.timers()] == [TimerKind.GRACE]
    driver.after(seconds=4)
    driver.tick()
    assert driver.open == ["work-1"]
    driver.after(seconds=1)
    driver.tick()
    closing = next(message.body for message in driver.step.messages if message.kind is MessageKind.APPEND)
    assert closing["status"]["value"] == "failed"
    assert closing["outputParameters"]["value"] == {"reason": "cancelled"}
    assert driver.process.over


def test_a_cancelled_task_that_was_taken_up_is_left_to_its_performer() -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.receive("work-1", "inProgress")
    interventions.cancel(driver.process, None, driver.next_step(), NOW)
    driver.after(hours=1)
    driver.tick()
    assert driver.open == ["work-1"]
    assert driver.process.timers() == ()


def test_a_task_taken_away_by_a_timer_is_called_back_and_its_late_end_changes_nothing() -> None:
    driver = ProcessDriver(
        ONE_STEP + boundary("late", "work", timer("PT1M")) + activity("other") + path("late", "other", "end")
    )
    driver.after(seconds=60)
    driver.tick()
    assert [m.subject for m in driver.step.messages if m.kind is MessageKind.APPEND] == [task_id("work-1")]
    assert driver.open == ["other-1", "work-1"]
    assert driver.receive("work-1", "completed")
    assert driver.open == ["other-1"]
    assert driver.process.run is not None


@pytest.mark.parametrize(("attributes", "raised"), [("", 0), ('deadline="PT2H"', 1)])
def test_a_task_of_people_waits_without_an_alert_unless_the_file_gives_a_deadline(
    attributes: str, raised: int
) -> None:
    task = f'<handover:task definition="work" {attributes}/>'
    body = f'<bpmn:userTask id="work"><bpmn:extensionElements>{task}</bpmn:extensionElements></bpmn:userTask>'
    driver = ProcessDriver(start() + body + end() + path("start", "work", "end"))
    driver.after(hours=3)
    driver.tick()
    found = [alert["description"] for alert in alerts(driver.step)]
    assert found == ['Nobody has claimed the Task "work" in time'] * raised


def test_a_task_nobody_takes_up_raises_one_alert_which_is_cleared_when_it_is() -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.after(seconds=299)
    driver.tick()
    assert alerts(driver.step) == []
    driver.after(seconds=1)
    driver.tick()
    (alert,) = alerts(driver.step)
    assert alert["sub_category"] == "taskNotAccepted"
    assert alert["description"] == 'No performer has accepted the Task "work" (glove-1)'
    driver.after(hours=1)
    driver.tick()
    assert alerts(driver.step) == []
    driver.receive("work-1", "assigned")
    cleared = [message.body["key"] for message in driver.step.messages if message.kind is MessageKind.CLEAR]
    assert cleared == [alert["key"]]
    driver.after(seconds=1)
    driver.receive("work-1", "inProgress")
    assert [message for message in driver.step.messages if message.kind is MessageKind.CLEAR] == []


def test_a_pending_task_the_broker_lost_is_posted_again() -> None:
    driver = ProcessDriver(ONE_STEP)
    before = next(message.body for message in driver.step.messages if message.kind is MessageKind.CREATE)
    task_troubles.missing(driver.process, task_id("work-1"), driver.next_step(), NOW)
    assert [message.body for message in driver.step.messages if message.kind is MessageKind.CREATE] == [
        before
    ]


def test_a_started_task_that_the_broker_lost_raises_one_alert_and_is_not_repeated() -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.receive("work-1", "inProgress")
    said = []
    for _ in range(4):
        task_troubles.missing(driver.process, task_id("work-1"), driver.next_step(), NOW)
        assert created(driver.step) == []
        said += alerts(driver.step)
    assert [alert["sub_category"] for alert in said] == ["taskLost"]
    driver.after(seconds=1)
    assert driver.receive("work-1", "completed")


def test_a_cancelled_task_the_broker_lost_counts_as_closed() -> None:
    driver = ProcessDriver(ONE_STEP)
    interventions.cancel(driver.process, None, driver.next_step(), NOW)
    task_troubles.missing(driver.process, task_id("work-1"), driver.next_step(), NOW)
    assert driver.process.over


def test_a_task_the_broker_refuses_counts_as_failed() -> None:
    driver = ProcessDriver(ONE_STEP)
    task_troubles.reject(driver.process, task_id("work-1"), "no such type", driver.next_step(), NOW)
    (incident,) = driver.process.record.incidents
    assert incident.reason == "the broker rejected the Task: no such type"


@pytest.mark.parametrize(
    ("inner", "reason"),
    [
        ('<handover:parameter name="x" expression="nothing"/>', 'no variable "nothing"'),
        ('<handover:involves expression="colour"/>', '"red" names no entity'),
        ('<handover:material expression="colour"/>', '"red" names no entity'),
        (
            "<handover:material expression=\"'Asset:hammer'\"/>",
            '"urn:ngsi-ld:Asset:demo:hammer" is no Material for "work"',
        ),
    ],
)
def test_an_invalid_activity_is_an_incident_that_names_the_reason(inner: str, reason: str) -> None:
    driver = ProcessDriver(
        start() + activity("work", inner) + end() + path("start", "work", "end"), colour="red"
    )
    (incident,) = driver.process.record.incidents
    assert incident.element == "work"
    assert reason in incident.reason
    assert created(driver.step) == []


@pytest.mark.parametrize("text", ["${absent}", "${1 +}"])
def test_candidates_that_cannot_be_evaluated_are_an_incident_and_no_task_for_everybody(text: str) -> None:
    names = f'xmlns:camunda="http://camunda.org/schema/1.0/bpmn" camunda:candidateGroups="{text}"'
    driver = ProcessDriver(
        start() + f'<bpmn:userTask id="work" {names}/>' + end() + path("start", "work", "end")
    )
    (incident,) = driver.process.record.incidents
    assert incident.reason.startswith("candidateGroups: ")
    assert created(driver.step) == []


def test_one_step_counts_as_one_revision_however_much_happens_in_it() -> None:
    driver = ProcessDriver(TWO_STEPS)
    assert driver.process.record.revision == 1
    step = driver.next_step()
    driver.process.receive(driver.seen("first-1", "assigned"), step, NOW)
    driver.process.receive(driver.seen("first-1", "completed"), step, NOW)
    assert driver.process.record.revision == 2
    assert step.processes["p-1"].revision == 2


HANDLED = (
    start()
    + activity("look", attributes='handlesOutcomes="true"')
    + gateway("good", default="good_repair")
    + activity("move")
    + activity("repair")
    + end()
    + path("start", "look", "good", "repair", "end")
    + flow("good", "move", "look.outcome == 'ok'")
    + path("move", "end")
)


def test_an_activity_that_handles_outcomes_says_so_to_its_performer_and_a_gateway_reads_the_outcome() -> None:
    for answered, follows in (
        ({"outcome": "notGood"}, "repair-1"),
        ({"outcome": "ok"}, "move-1"),
        ({}, "move-1"),
    ):
        driver = ProcessDriver(HANDLED)
        (posted,) = [message.body for message in driver.step.messages if message.kind is MessageKind.CREATE]
        assert posted["workParameters"]["value"] == {"handlesOutcomes": True}
        driver.receive("look-1", "completed", **answered)
        assert driver.open == [follows]


@pytest.mark.parametrize(("outcome", "said"), [("notGood", "not good"), ("problem", "problem")])
def test_a_completed_task_with_an_outcome_that_nobody_handles_counts_as_failed(
    outcome: str, said: str
) -> None:
    driver = ProcessDriver(TWO_STEPS)
    driver.receive("first-1", "completed", outcome=outcome, note="oil")
    (incident,) = driver.process.record.incidents
    assert incident.reason == f'answered "{said}": oil'
    assert incident.task == task_id("first-1")
    assert created(driver.step) == []


@pytest.mark.parametrize("outcome", [["dented", "wet"], {"grade": 3}, 3])
def test_an_outcome_of_any_type_that_nobody_handles_counts_as_failed(outcome: object) -> None:
    driver = ProcessDriver(TWO_STEPS)
    driver.receive("first-1", "completed", outcome=outcome)
    assert [incident.task for incident in driver.process.record.incidents] == [task_id("first-1")]
    assert created(driver.step) == []


def test_an_error_boundary_catches_an_outcome_by_its_name() -> None:
    caught = '<bpmn:errorEventDefinition errorRef="no"/>'
    body = (
        start()
        + activity("look")
        + boundary("refused", "look", caught)
        + activity("move")
        + activity("repair")
        + end()
        + path("start", "look", "move", "end")
        + path("refused", "repair", "end")
    )
    beside = '<bpmn:error id="no" errorCode="notGood"/>'
    driver = ProcessDriver(body, beside=beside)
    driver.receive("look-1", "failed", outcome="notGood", reason="notGood", errorCode="notGood")
    assert driver.open == ["repair-1"]
    driver = ProcessDriver(body, beside=beside)
    driver.receive("look-1", "failed", outcome="problem", reason="problem", errorCode="problem")
    assert [incident.code for incident in driver.process.record.incidents] == ["problem"]


def test_a_paused_process_posts_nothing_until_it_is_resumed() -> None:
    driver = ProcessDriver(TWO_STEPS)
    interventions.pause(driver.process, Act(NOW, ActKind.PAUSE, "Ann"), driver.next_step(), NOW)
    (request,) = [message for message in driver.step.messages if message.kind is MessageKind.APPEND]
    assert (request.subject, request.body["requestedStatus"]["value"]) == (task_id("first-1"), "paused")
    assert processes(driver.step)[-1]["status"]["value"] == "paused"
    driver.receive("first-1", "completed")
    assert driver.open == []
    assert driver.process.record.status is TaskStatus.PAUSED
    interventions.resume_work(driver.process, Act(NOW, ActKind.RESUME, "Ann"), driver.next_step(), NOW)
    assert driver.open == ["second-1"]
    assert driver.process.record.status is TaskStatus.IN_PROGRESS
    assert [act.act for act in driver.process.record.acts] == [ActKind.PAUSE, ActKind.RESUME]


def test_timers_wait_while_a_process_is_paused() -> None:
    late = boundary("late", "work", timer("PT1M")) + activity("other") + path("late", "other", "end")
    driver = ProcessDriver(ONE_STEP + late)
    interventions.pause(driver.process, Act(NOW, ActKind.PAUSE, "Ann"), driver.next_step(), NOW)
    driver.after(minutes=10)
    driver.tick()
    assert driver.process.timers() == ()
    assert driver.open == ["work-1"]
    interventions.resume_work(
        driver.process, Act(driver.now, ActKind.RESUME, "Ann"), driver.next_step(), driver.now
    )
    assert "other-1" in driver.open


def test_a_paused_process_that_was_loaded_again_is_still_paused() -> None:
    driver = ProcessDriver(TWO_STEPS)
    interventions.pause(driver.process, Act(NOW, ActKind.PAUSE, "Ann"), driver.next_step(), NOW)
    before, tasks = driver.process, list(driver.process.tasks.values())
    driver.process = Process.resume(before.settings, before.plan, before.record, tasks, before.library)
    driver.receive("first-1", "completed")
    assert driver.open == []


MANY = (
    "<bpmn:multiInstanceLoopCharacteristics><bpmn:loopCardinality>200</bpmn:loopCardinality>"
    "</bpmn:multiInstanceLoopCharacteristics>"
)


def test_many_parallel_instances_are_posted_once_and_each_ends_alone() -> None:
    late = boundary("late", "work", timer("PT1H")) + activity("other") + path("late", "other", "end")
    work = activity("work").replace("</bpmn:userTask>", f"{MANY}</bpmn:userTask>")
    driver = ProcessDriver(start() + work + end() + path("start", "work", "end") + late)
    names = [f"work-{visit}" for visit in range(1, 201)]
    assert created(driver.step) == [task_id(name) for name in names]
    for left, name in enumerate(names[:150]):
        driver.receive(name, "completed")
        assert not created(driver.step)
        assert list(driver.step.tasks) == [task_id(name)]
        assert len(driver.process.tasks) == 199 - left
    before, tasks = driver.process, list(driver.process.tasks.values())
    driver.process = Process.resume(before.settings, before.plan, before.record, tasks, before.library)
    driver.receive("work-151", "completed")
    assert not created(driver.step)
    driver.after(hours=1)
    driver.tick()
    assert created(driver.step) == [task_id("other-1")]
    cancelled = {message.subject for message in driver.step.messages if message.kind is MessageKind.APPEND}
    assert cancelled == {task_id(name) for name in names[151:]}


def test_the_entity_of_a_long_process_lists_its_last_tasks_and_is_written_in_groups() -> None:
    driver = ProcessDriver(
        start()
        + gateway("again")
        + activity("work")
        + gateway("which", default="which_end")
        + end()
        + path("start", "again", "work", "which")
        + flow("which", "again", "not work.stop")
        + flow("which", "end")
    )
    written: dict[int, list[str]] = {}
    for number in range(1, 231):
        driver.receive(f"work-{number}", "completed", stop=False)
        for entity in processes(driver.step):
            written[number] = [link["object"] for link in entity["isComposedOf"]["value"]]
    assert [len(listed) for listed in written.values()] == [*range(2, 201), 200, 200, 200]
    assert list(written)[-3:] == [209, 219, 229]
    assert written[229] == [task_id(f"work-{number}") for number in range(31, 231)]


def test_a_timer_may_repeat_at_once_a_limited_number_of_times() -> None:
    repeated = timer("R3/PT0S").replace("timeDuration", "timeCycle")
    body = start() + activity("work") + boundary("again", "work", repeated, interrupting=False) + end()
    body += activity("remind") + path("start", "work", "end") + path("again", "remind")
    driver = ProcessDriver(body)
    driver.tick()
    assert driver.open == ["remind-1", "remind-2", "remind-3", "work-1"]
    driver.tick()
    assert len(driver.open) == 4
