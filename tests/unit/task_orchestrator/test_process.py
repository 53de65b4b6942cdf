"""A process: which Tasks it hands out, what it believes, and how it ends. Steps are looked at, not sent."""

from datetime import timedelta

import pytest

from datamodels.entities import Task, TaskStatus
from handover.errors import Problem
from services.task_orchestrator.records import Saying, TimerKind
from tests.unit.task_orchestrator.drawing import (
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
from tests.unit.task_orchestrator.shop_floor import DEFINED_BY, Floor, alerts, created, processes, task_id

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
    floor = Floor(body, helper="urn:ngsi-ld:Person:demo:ann", place="table")
    posted = next(message.body for message in floor.step.messages if message.saying is Saying.CREATE)
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


def test_a_process_says_what_it_is_composed_of_and_how_it_ended() -> None:
    floor = Floor(TWO_STEPS, bin="bin-1")
    floor.hear("first-1", "completed", weight=3)
    assert created(floor.step) == [task_id("second-1")]
    told = processes(floor.step)[-1]
    assert [link["object"] for link in told["isComposedOf"]["value"]] == [
        task_id("first-1"),
        task_id("second-1"),
    ]
    floor.hear("second-1", "completed")
    told = processes(floor.step)[-1]
    assert told["status"]["value"] == "completed"
    assert told["outputParameters"]["value"] == {"first": {"weight": 3}, "second": {}}
    assert told["workParameters"]["value"] == {"bin": "bin-1"}
    assert floor.process.over


def test_an_observer_may_miss_steps_but_never_goes_back() -> None:
    floor = Floor(TWO_STEPS)
    floor.after(seconds=5)
    assert floor.hear("first-1", "inProgress")
    assert not floor.hear("first-1", "assigned", at=NOW + timedelta(seconds=4))
    assert not floor.hear("first-1", "pending", at=NOW + timedelta(seconds=9))
    assert not floor.hear("first-1", "completed", at=NOW)
    assert not floor.step
    floor.after(seconds=1)
    assert floor.hear("first-1", "completed")


def test_a_finished_task_never_reopens() -> None:
    floor = Floor(TWO_STEPS)
    assert floor.hear("first-1", "completed")
    floor.after(seconds=1)
    assert not floor.hear("first-1", "inProgress")
    assert not floor.hear("first-1", "failed")
    assert floor.open == ["second-1"]


def test_news_heard_twice_moves_the_process_once() -> None:
    floor = Floor(TWO_STEPS)
    assert floor.hear("first-1", "completed")
    assert not floor.hear("first-1", "completed")
    assert floor.process.composed == [task_id("first-1"), task_id("second-1")]


def test_a_failed_task_fails_the_process_with_an_alert() -> None:
    floor = Floor(ONE_STEP)
    floor.hear("work-1", "failed", reason="the part slipped")
    assert floor.process.record.status is TaskStatus.FAILED
    assert floor.process.record.reason == '"work" failed: the part slipped'
    (alert,) = alerts(floor.step)
    assert alert["category"] == "processFailed"
    assert alert["source"] == "urn:ngsi-ld:Process:demo:p-1"
    assert processes(floor.step)[-1]["outputParameters"]["value"] == {
        "reason": '"work" failed: the part slipped',
        "reasonCode": "process.task_failed",
        "reasonParameters": {"task": "work", "reason": "the part slipped"},
    }


def test_a_failed_task_with_a_boundary_event_goes_on_without_an_alert() -> None:
    caught = (
        boundary("oops", "work", "<bpmn:errorEventDefinition/>")
        + activity("help")
        + path("oops", "help", "end")
    )
    floor = Floor(ONE_STEP + caught)
    floor.hear("work-1", "failed", reason="the part slipped", errorCode=7)
    assert floor.open == ["help-1"]
    assert alerts(floor.step) == []
    assert floor.process.record.variables["error"] == {
        "activity": "work",
        "reason": "the part slipped",
        "code": "7",
    }


def test_a_process_that_fails_calls_its_other_tasks_back() -> None:
    body = start() + gateway("fork", "parallel") + activity("a") + activity("b") + end()
    body += (
        flow("start", "fork") + flow("fork", "a") + flow("fork", "b") + flow("a", "end") + flow("b", "end")
    )
    floor = Floor(body)
    floor.hear("a-1", "failed", reason="no")
    (asked,) = [message for message in floor.step.messages if message.saying is Saying.APPEND]
    assert asked.subject == task_id("b-1")
    assert asked.body["requestedStatus"]["value"] == "cancelled"
    assert not floor.process.over
    floor.after(seconds=1)
    floor.hear("b-1", "failed", reason="cancelled")
    assert floor.process.over


def test_a_cancelled_process_ends_failed_and_calls_its_tasks_back() -> None:
    floor = Floor(ONE_STEP)
    floor.process.cancel(None, floor.next_step(), NOW)
    assert processes(floor.step)[-1]["status"]["value"] == "failed"
    assert processes(floor.step)[-1]["outputParameters"]["value"] == {"reason": "cancelled"}
    assert alerts(floor.step) == []
    with pytest.raises(Problem, match="ended"):
        floor.process.cancel(None, floor.next_step(), NOW)


def test_a_cancelled_task_nobody_took_up_is_closed_after_a_grace() -> None:
    floor = Floor(ONE_STEP)
    floor.process.cancel(None, floor.next_step(), NOW)
    assert [timer.kind for timer in floor.process.timers()] == [TimerKind.GRACE]
    floor.after(seconds=4)
    floor.tick()
    assert floor.open == ["work-1"]
    floor.after(seconds=1)
    floor.tick()
    closing = next(message.body for message in floor.step.messages if message.saying is Saying.APPEND)
    assert closing["status"]["value"] == "failed"
    assert closing["outputParameters"]["value"] == {"reason": "cancelled"}
    assert floor.process.over


def test_a_cancelled_task_that_was_taken_up_is_left_to_its_performer() -> None:
    floor = Floor(ONE_STEP)
    floor.hear("work-1", "inProgress")
    floor.process.cancel(None, floor.next_step(), NOW)
    floor.after(hours=1)
    floor.tick()
    assert floor.open == ["work-1"]
    assert floor.process.timers() == ()


def test_a_task_taken_away_by_a_timer_is_called_back_and_its_late_end_changes_nothing() -> None:
    floor = Floor(
        ONE_STEP + boundary("late", "work", timer("PT1M")) + activity("other") + path("late", "other", "end")
    )
    floor.after(seconds=60)
    floor.tick()
    assert [m.subject for m in floor.step.messages if m.saying is Saying.APPEND] == [task_id("work-1")]
    assert floor.open == ["other-1", "work-1"]
    assert floor.hear("work-1", "completed")
    assert floor.open == ["other-1"]
    assert floor.process.run is not None


def test_a_task_nobody_takes_up_raises_one_alert_which_is_cleared_when_it_is() -> None:
    floor = Floor(ONE_STEP)
    floor.after(seconds=299)
    floor.tick()
    assert alerts(floor.step) == []
    floor.after(seconds=1)
    floor.tick()
    (alert,) = alerts(floor.step)
    assert alert["sub_category"] == "notTakenUp"
    assert "Device:demo:glove-1" in alert["description"]
    floor.after(hours=1)
    floor.tick()
    assert alerts(floor.step) == []
    floor.hear("work-1", "assigned")
    cleared = [message.body["key"] for message in floor.step.messages if message.saying is Saying.CLEAR]
    assert cleared == [alert["key"]]
    floor.after(seconds=1)
    floor.hear("work-1", "inProgress")
    assert [message for message in floor.step.messages if message.saying is Saying.CLEAR] == []


def test_a_pending_task_the_broker_lost_is_posted_again() -> None:
    floor = Floor(ONE_STEP)
    before = next(message.body for message in floor.step.messages if message.saying is Saying.CREATE)
    floor.process.missing(task_id("work-1"), floor.next_step(), NOW)
    assert [message.body for message in floor.step.messages if message.saying is Saying.CREATE] == [before]


def test_a_begun_task_the_broker_lost_is_not_done_twice_but_told_once() -> None:
    floor = Floor(ONE_STEP)
    floor.hear("work-1", "inProgress")
    said = []
    for _ in range(4):
        floor.process.missing(task_id("work-1"), floor.next_step(), NOW)
        assert created(floor.step) == []
        said += alerts(floor.step)
    assert [alert["category"] for alert in said] == ["taskLost"]
    floor.after(seconds=1)
    assert floor.hear("work-1", "completed")


def test_a_cancelled_task_the_broker_lost_counts_as_closed() -> None:
    floor = Floor(ONE_STEP)
    floor.process.cancel(None, floor.next_step(), NOW)
    floor.process.missing(task_id("work-1"), floor.next_step(), NOW)
    assert floor.process.over


def test_a_task_the_broker_refuses_counts_as_failed() -> None:
    floor = Floor(ONE_STEP)
    floor.process.refused(task_id("work-1"), "no such type", floor.next_step(), NOW)
    assert floor.process.record.reason == '"work" failed: the broker refused the Task: no such type'


@pytest.mark.parametrize(
    ("inner", "reason"),
    [
        ('<handover:parameter name="x" expression="nothing"/>', 'no variable "nothing"'),
        ('<handover:involves expression="colour"/>', '"red" names no entity'),
    ],
)
def test_what_cannot_be_asked_fails_the_process_by_name(inner: str, reason: str) -> None:
    floor = Floor(start() + activity("work", inner) + end() + path("start", "work", "end"), colour="red")
    assert floor.process.record.status is TaskStatus.FAILED
    assert reason in str(floor.process.record.reason)
    assert created(floor.step) == []


def test_one_step_counts_as_one_revision_however_much_happens_in_it() -> None:
    floor = Floor(TWO_STEPS)
    assert floor.process.record.revision == 1
    step = floor.next_step()
    floor.process.hear(floor.seen("first-1", "assigned"), step, NOW)
    floor.process.hear(floor.seen("first-1", "completed"), step, NOW)
    assert floor.process.record.revision == 2
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
        floor = Floor(HANDLED)
        (posted,) = [message.body for message in floor.step.messages if message.saying is Saying.CREATE]
        assert posted["workParameters"]["value"] == {"handlesOutcomes": True}
        floor.hear("look-1", "completed", **answered)
        assert floor.open == [follows]


@pytest.mark.parametrize(("outcome", "said"), [("notGood", "not good"), ("problem", "problem")])
def test_a_completed_task_with_an_outcome_that_nobody_handles_counts_as_failed(
    outcome: str, said: str
) -> None:
    floor = Floor(TWO_STEPS)
    floor.hear("first-1", "completed", outcome=outcome, note="oil")
    assert floor.process.over
    assert floor.process.record.reason == f'"first" failed: answered "{said}": oil'
    assert floor.process.record.failed_by == task_id("first-1")
    assert created(floor.step) == []


@pytest.mark.parametrize("outcome", [["dented", "wet"], {"grade": 3}, 3])
def test_an_outcome_of_any_type_that_nobody_handles_counts_as_failed(outcome: object) -> None:
    floor = Floor(TWO_STEPS)
    floor.hear("first-1", "completed", outcome=outcome)
    assert floor.process.record.failed_by == task_id("first-1")
    assert created(floor.step) == []


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
    floor = Floor(body, beside=beside)
    floor.hear("look-1", "failed", outcome="notGood", reason="notGood", errorCode="notGood")
    assert floor.open == ["repair-1"]
    floor = Floor(body, beside=beside)
    floor.hear("look-1", "failed", outcome="problem", reason="problem", errorCode="problem")
    assert floor.process.over


def test_no_said_to_a_task_that_was_called_back_does_not_count_as_done_when_it_is_retried() -> None:
    body = (
        start()
        + gateway("fork", "parallel")
        + activity("a")
        + activity("look")
        + gateway("join", "parallel")
        + end()
        + path("start", "fork", "a", "join", "end")
        + path("fork", "look", "join")
    )
    floor = Floor(body)
    floor.hear("a-1", "failed", reason="the part slipped")
    floor.hear("look-1", "completed", outcome="notGood")
    floor.process.retry(task_id("a-1"), "Ann", floor.next_step(), floor.now)
    assert floor.open == ["a-2", "look-2"]
