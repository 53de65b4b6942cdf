"""Camunda 8: job types, mappings, assignments, forms, calls, loops, messages and FEEL."""

import pytest

from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.run import Run
from handover_bpmn.model import (
    FormBinding,
    FormReference,
    MessageEvent,
    MultiInstance,
    TimerEvent,
)
from services.task_orchestrator.tests.unit.bpmn.notation.reading import (
    between,
    extended,
    faults,
    node,
    read,
    warnings,
)
from services.task_orchestrator.tests.unit.drawing import NOW, end, flow, gateway, path, start
from services.task_orchestrator.tests.unit.process_driver import OneDefinition


def test_a_job_is_a_task_with_its_type_headers_and_inputs() -> None:
    found = node(
        extended(
            "serviceTask",
            '<zeebe:taskDefinition type="pick" retries="3"/>'
            '<zeebe:taskHeaders><zeebe:header key="speed" value="slow"/></zeebe:taskHeaders>'
            '<zeebe:ioMapping><zeebe:input source="=order.part" target="part"/>'
            '<zeebe:input source="fixed" target="mode"/>'
            '<zeebe:output source="=place + 1" target="next"/></zeebe:ioMapping>',
        )
    )
    work = found.activity
    assert work is not None
    assert work.spreads_outputs
    assert work.hints == {"jobType": "pick", "retries": "3"}
    variables = {"order": {"part": "p1"}}
    assert {name: value.value(variables) for name, value in work.parameters.items()} == {
        "headers": {"speed": "slow"},
        "operation": "pick",
        "part": "p1",
        "mode": "fixed",
    }
    assert [(each.target, each.value.value(variables)) for each in found.inputs] == [
        ("part", "p1"),
        ("mode", "fixed"),
    ]
    assert [(each.target, each.value.value({"place": 1})) for each in found.outputs] == [("next", 2)]


def test_a_target_with_dots_is_an_object() -> None:
    mapping = (
        '<zeebe:ioMapping><zeebe:input source="=x" target="a.b"/><zeebe:input source="=y" target="a.c.d"/>'
        '<zeebe:input source="1" target="e"/></zeebe:ioMapping>'
    )
    found = node(extended("serviceTask", mapping)).inputs
    assert [each.target for each in found] == ["a", "e"]
    assert found[0].value.value({"x": 1, "y": 2}) == {"b": 1, "c": {"d": 2}}


def test_a_user_task_has_assignment_form_schedule_and_priority() -> None:
    work = node(
        extended(
            "userTask",
            "<zeebe:userTask/>"
            '<zeebe:assignmentDefinition assignee="ann" candidateGroups="cell, night" candidateUsers="bob"/>'
            '<zeebe:formDefinition formId="check"/><zeebe:taskSchedule dueDate="=now()"/>'
            '<zeebe:priorityDefinition priority="50"/>',
        )
    ).activity
    assert work is not None
    assert work.hints == {
        "assignee": "ann",
        "candidateGroups": "cell, night",
        "candidateUsers": "bob",
        "formId": "check",
        "dueDate": "=now()",
        "priority": "50",
    }


def test_a_call_activity_binds_a_process() -> None:
    called = (
        '<zeebe:calledElement processId="pack" propagateAllChildVariables="false" '
        'propagateAllParentVariables="false" bindingType="versionTag" versionTag="v2"/>'
        '<zeebe:ioMapping><zeebe:input source="=part" target="item"/>'
        '<zeebe:output source="=box" target="packed"/></zeebe:ioMapping>'
    )
    call = node(extended("callActivity", called)).call
    assert call is not None
    assert call.process.value({}) == "pack"
    assert call.tag is not None
    assert call.tag.value({}) == "v2"
    assert [(each.target, each.value.value({"part": 1})) for each in call.inputs] == [("item", 1)]
    assert [(each.target, each.value.value({"box": 2})) for each in call.outputs] == [("packed", 2)]
    assert not call.all_inputs
    assert not call.all_outputs


def test_a_call_activity_passes_all_variables_by_default() -> None:
    call = node(extended("callActivity", '<zeebe:calledElement processId="=name"/>')).call
    assert call is not None
    assert call.process.value({"name": "pack"}) == "pack"
    assert call.all_inputs
    assert call.all_outputs


def test_a_loop_runs_over_a_collection_and_collects() -> None:
    inner = (
        "<bpmn:multiInstanceLoopCharacteristics><bpmn:extensionElements>"
        '<zeebe:loopCharacteristics inputCollection="=parts" inputElement="part" '
        'outputCollection="results" outputElement="=weight * 2"/></bpmn:extensionElements>'
        "<bpmn:completionCondition>= numberOfCompletedInstances > 1</bpmn:completionCondition>"
        "</bpmn:multiInstanceLoopCharacteristics>"
    )
    loop = node(f'<bpmn:task id="x">{inner}</bpmn:task>').loop
    assert isinstance(loop, MultiInstance)
    assert loop.collection is not None
    assert loop.collection.value({"parts": [1]}) == [1]
    assert (loop.item_variable, loop.output_collection) == ("part", "results")
    assert loop.output_item is not None
    assert loop.output_item.value({"weight": 2}) == 4
    assert loop.completion is not None
    assert loop.completion.value({"numberOfCompletedInstances": 2}) is True


def test_a_message_has_a_correlation_key() -> None:
    declared = (
        '<bpmn:message id="m" name="=&quot;order-&quot; + kind"><bpmn:extensionElements>'
        '<zeebe:subscription correlationKey="=orderId"/></bpmn:extensionElements></bpmn:message>'
    )
    event = node('<bpmn:receiveTask id="x" messageRef="m"/>', beside=declared).event
    assert isinstance(event, MessageEvent)
    assert event.name.value({"kind": "a"}) == "order-a"
    assert event.correlation is not None
    assert event.correlation.value({"orderId": 7}) == 7


def test_a_message_throw_event_with_a_job_is_a_task() -> None:
    definition = "<bpmn:messageEventDefinition/>"
    body = start() + extended("endEvent", '<zeebe:taskDefinition type="mail"/>', inner=definition)
    work = read(body + path("start", "x")).activities()["x"]
    assert work.hints == {"jobType": "mail"}


def test_a_script_sets_its_result_variable() -> None:
    script = node(extended("scriptTask", '<zeebe:script expression="=a + 1" resultVariable="b"/>')).script
    assert script is not None
    assert [(each.target, each.value.value({"a": 1})) for each in script] == [("b", 2)]


def test_a_script_with_a_job_is_a_task() -> None:
    work = node(extended("scriptTask", '<zeebe:taskDefinition type="script"/>')).activity
    assert work is not None
    assert work.hints == {"jobType": "script"}
    assert set(work.parameters) == {"operation"}


def test_conditions_and_timers_are_feel() -> None:
    wait = (
        '<bpmn:intermediateCatchEvent id="t"><bpmn:timerEventDefinition><bpmn:timeDuration>=patience'
        "</bpmn:timeDuration></bpmn:timerEventDefinition></bpmn:intermediateCatchEvent>"
    )
    body = start() + extended("task", '<zeebe:taskDefinition type="a"/>') + gateway("g") + wait + end()
    body += path("start", "x", "g") + flow("g", "t", "=amount > 3 and not(late)") + path("g", "end")
    definition = read(body + path("t", "end"))
    condition = definition.scope.flows["g_t"].condition
    assert condition is not None
    assert condition.value({"amount": 4, "late": False}) is True
    assert definition.scope.nodes["g"].default == "g_end"
    event = definition.scope.nodes["t"].event
    assert isinstance(event, TimerEvent)
    assert event.value.value({"patience": "PT1M"}) == "PT1M"


def test_the_version_tag_is_the_label() -> None:
    body = '<bpmn:extensionElements><zeebe:versionTag value="2.1"/></bpmn:extensionElements>'
    assert read(body + between('<bpmn:task id="x"/>')).label == "2.1"


def test_listeners_are_warnings() -> None:
    listeners = (
        '<zeebe:executionListeners><zeebe:executionListener eventType="start" type="a"/>'
        "</zeebe:executionListeners>"
    )
    assert warnings(between(extended("task", listeners))) == [
        'line 1, "x": zeebe:executionListeners has no effect on the execution'
    ]


@pytest.mark.parametrize(
    ("element", "reason"),
    [
        (
            extended("businessRuleTask", '<zeebe:calledDecision decisionId="d" resultVariable="r"/>'),
            "businessRuleTask with calledDecision (a DMN decision) is not supported yet; let a Task decide",
        ),
        (extended("callActivity", "<zeebe:calledElement/>"), "the call activity names no process"),
        (
            extended("task", '<zeebe:ioMapping><zeebe:input source="=1" target="a b"/></zeebe:ioMapping>'),
            'target="a b" cannot be the name of a variable',
        ),
        (
            extended(
                "task",
                f'<zeebe:ioMapping><zeebe:input source="=1" target="{".".join("a" * 9999)}"/>'
                "</zeebe:ioMapping>",
            ),
            "cannot be the name of a variable",
        ),
        (
            extended("task", '<zeebe:ioMapping><zeebe:input source="=1 +" target="a"/></zeebe:ioMapping>'),
            "1 +",
        ),
    ],
)
def test_a_wrong_extension_is_one_fault(element: str, reason: str) -> None:
    found = faults(between(element))
    assert len(found) == 1, found
    assert reason in found[0]


FORM = '{"components": [{"type": "textfield", "key": "serial"}]}'


def test_a_user_task_names_a_deployed_form() -> None:
    latest = node(extended("userTask", '<zeebe:formDefinition formId="check"/>')).activity
    bound = '<zeebe:formDefinition formId="check" bindingType="deployment"/>'
    deployed = node(extended("userTask", bound)).activity
    assert latest is not None
    assert deployed is not None
    assert latest.form == FormReference("check")
    assert deployed.form == FormReference("check", FormBinding.DEPLOYMENT)


def test_a_form_may_stand_in_the_process() -> None:
    key = '<zeebe:formDefinition formKey="camunda-forms:bpmn:userTaskForm_1"/>'
    task = between(extended("userTask", key))
    written = '<zeebe:userTaskForm id="userTaskForm_1">{}</zeebe:userTaskForm>'
    body = f"<bpmn:extensionElements>{written.format(FORM)}</bpmn:extensionElements>{task}"
    work = read(body).scope.nodes["x"].activity
    assert work is not None
    assert work.parameters["form"].literal == {"components": [{"type": "textfield", "key": "serial"}]}
    broken = f"<bpmn:extensionElements>{written.format('no')}</bpmn:extensionElements>{task}"
    assert any("the form is no JSON" in fault for fault in faults(broken))


@pytest.mark.parametrize(
    "condition", ["$.total &gt;= 5 &amp;&amp; approved == true", "total &gt;= 5 || !approved"]
)
def test_a_condition_of_an_old_release_is_read(condition: str) -> None:
    body = start() + gateway("g", default="g_e") + end("e") + end("f") + path("start", "g", "e")
    body += extended("task", "<zeebe:userTask/>") + flow("g", "x", condition)
    found = read(body + path("x", "f")).scope.flows["g_x"].condition
    assert found is not None
    assert found.value({"total": 5, "approved": True}) is True


def test_a_mapping_may_use_words_that_our_language_reserves() -> None:
    mapping = (
        '<zeebe:taskDefinition type="mail"/><zeebe:ioMapping><zeebe:input source="=a" target="from.class"/>'
        '<zeebe:input source="=a" target="to-address"/></zeebe:ioMapping>'
    )
    found = node(extended("serviceTask", mapping)).inputs
    assert {each.target: each.value.value({"a": 1}) for each in found} == {
        "from": {"class": 1},
        "to-address": 1,
    }


MAPPINGS = {
    "none": ("", "=r", {"results": [10, 20]}),
    "the result itself": ('<zeebe:output source="=r" target="r"/>', "=r", {"results": [10, 20]}),
    "of another result": (
        '<zeebe:output source="=q" target="other"/>',
        "=r",
        {"results": [10, 20], "other": 2},
    ),
    "renamed": ('<zeebe:output source="=r" target="got"/>', "=got", {"results": [10, 20]}),
    "nested": ('<zeebe:output source="=r" target="a.b"/>', "=a.b + q", {"results": [11, 22]}),
    "in order": (
        '<zeebe:output source="=q" target="a"/><zeebe:output source="=a + 1" target="b"/>',
        "={b: b, at: loopCounter, item: item}",
        {"results": [{"b": 2, "at": 1, "item": "x"}, {"b": 3, "at": 2, "item": "y"}], "a": 2},
    ),
}


@pytest.mark.parametrize("sequential", ["true", "false"])
@pytest.mark.parametrize("name", MAPPINGS)
@pytest.mark.parametrize("kind", ["serviceTask", "subProcess", "callActivity"])
def test_a_loop_collects_its_output_with_any_mapping(kind: str, name: str, sequential: str) -> None:
    mapping, output, expected = MAPPINGS[name]
    characteristics = (
        f'<bpmn:multiInstanceLoopCharacteristics isSequential="{sequential}"><bpmn:extensionElements>'
        '<zeebe:loopCharacteristics inputCollection="=items" inputElement="item" '
        f'outputCollection="results" outputElement="{output}"/>'
        "</bpmn:extensionElements></bpmn:multiInstanceLoopCharacteristics>"
    )
    job = extended("serviceTask", '<zeebe:taskDefinition type="pick"/>', name="job")
    inner = start("first") + job + path("first", "job") if kind == "subProcess" else ""
    extensions = {
        "serviceTask": '<zeebe:taskDefinition type="pick"/>',
        "subProcess": "",
        "callActivity": '<zeebe:calledElement processId="called" propagateAllChildVariables="true"/>',
    }[kind]
    mapped = f"<zeebe:ioMapping>{mapping}</zeebe:ioMapping>" if mapping else ""
    plan = Plan(read(between(extended(kind, extensions + mapped, inner=characteristics + inner))))
    called = Plan(read(between(job, "job")))
    run = Run.start(plan, {"items": ["x", "y"]}, NOW, OneDefinition(called))
    for count in (1, 2):
        token = min(run.open_visits(), key=int)
        run.complete(token, {"r": 10 * count, "q": count}, NOW)
    assert run.completed
    assert run.variables() == {"items": ["x", "y"], **expected}
