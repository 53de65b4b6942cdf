"""jBPM: data associations, human tasks, work items, Java expressions, scripts, durations, references."""

import pytest

from handover_bpmn.model import Definition, MultiInstance, SignalEvent, TimerEvent
from handover_bpmn.notation.faults import BadBpmn
from handover_bpmn.notation.file import BpmnFile, read_bpmn
from services.task_orchestrator.tests.unit.bpmn.notation.reading import between
from services.task_orchestrator.tests.unit.drawing import end, flow, gateway, path, start

_DROOLS = "http://www.jboss.org/drools"


def _file(body: str) -> BpmnFile:
    return read_bpmn(
        f'<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:tns="{_DROOLS}" '
        f'expressionLanguage="http://www.mvel.org/2.0"><bpmn:process id="p" tns:packageName="com.example" '
        f'isExecutable="true"><bpmn:property id="list"/><bpmn:property id="found"/><bpmn:property id="x"/>'
        f"{body}</bpmn:process></bpmn:definitions>".encode()
    )


def _read(body: str) -> Definition:
    return _file(body).definitions[0]


def _data(inputs: dict[str, str], outputs: dict[str, str] | None = None) -> str:
    """Return data inputs and outputs; a text in quotes is assigned, any other names a variable."""
    declared, associations = "", ""
    for name, source in inputs.items():
        declared += f'<bpmn:dataInput id="in_{name}" name="{name}"/>'
        given = (
            f"<bpmn:targetRef>in_{name}</bpmn:targetRef><bpmn:assignment><bpmn:from>{source[1:-1]}</bpmn:from>"
            f"<bpmn:to>in_{name}</bpmn:to></bpmn:assignment>"
            if source.startswith("'")
            else f"<bpmn:sourceRef>{source}</bpmn:sourceRef><bpmn:targetRef>in_{name}</bpmn:targetRef>"
        )
        associations += f"<bpmn:dataInputAssociation>{given}</bpmn:dataInputAssociation>"
    for name, target in (outputs or {}).items():
        declared += f'<bpmn:dataOutput id="out_{name}" name="{name}"/>'
        associations += (
            f"<bpmn:dataOutputAssociation><bpmn:sourceRef>out_{name}</bpmn:sourceRef>"
            f"<bpmn:targetRef>{target}</bpmn:targetRef></bpmn:dataOutputAssociation>"
        )
    return f"<bpmn:ioSpecification>{declared}</bpmn:ioSpecification>{associations}"


def _owner(name: str) -> str:
    return (
        "<bpmn:potentialOwner><bpmn:resourceAssignmentExpression><bpmn:formalExpression>"
        f"{name}</bpmn:formalExpression></bpmn:resourceAssignmentExpression></bpmn:potentialOwner>"
    )


def test_a_human_task_gets_data_and_returns_it() -> None:
    data = _data({"part": "x", "Comment": "'Look at #{x}'", "GroupId": "'HR,#{list}'"}, {"answer": "found"})
    definition = _read(between(f'<bpmn:userTask id="x1">{data}{_owner("john")}</bpmn:userTask>', "x1"))
    work = definition.scope.nodes["x1"].activity
    assert work is not None
    assert {name: value.value({"x": "p1", "list": "IT"}) for name, value in work.parameters.items()} == {
        "part": "p1",
        "Comment": "Look at p1",
        "GroupId": "HR,IT",
    }
    assert work.outputs == {"answer": "found"}
    assert work.variable == ""
    assert work.hints == {"candidateGroups": "HR,#{list}", "candidateUsers": "john"}
    assert definition.warnings == ()


def test_a_multi_instance_activity_runs_over_the_associated_variable() -> None:
    loop = (
        "<bpmn:multiInstanceLoopCharacteristics><bpmn:loopDataInputRef>in_IN_COLLECTION</bpmn:loopDataInputRef>"
        "<bpmn:loopDataOutputRef>out_OUT_COLLECTION</bpmn:loopDataOutputRef>"
        '<bpmn:inputDataItem id="item"/><bpmn:outputDataItem id="result"/>'
        "</bpmn:multiInstanceLoopCharacteristics>"
    )
    data = _data({"IN_COLLECTION": "list", "part": "item"}, {"OUT_COLLECTION": "found", "answer": "result"})
    task = f'<bpmn:userTask id="x1">{data}{loop}</bpmn:userTask>'
    node = _read(between(task, "x1")).scope.nodes["x1"]
    assert isinstance(node.loop, MultiInstance)
    assert node.loop.collection is not None
    assert node.loop.collection.value({"list": [1, 2]}) == [1, 2]
    assert node.loop.output_collection == "found"
    assert node.activity is not None
    assert set(node.activity.parameters) == {"part"}
    assert node.activity.outputs == {"answer": "result"}


def test_work_items_services_and_rules_name_their_operation() -> None:
    items = {
        "a": '<bpmn:task id="a" tns:taskName="Email"/>',
        "b": '<bpmn:businessRuleTask id="b" tns:ruleFlowGroup="prices"/>',
        "c": '<bpmn:serviceTask id="c" tns:serviceoperation="hello"/>',
    }
    body = start() + "".join(items.values()) + end() + path("start", "a", "b", "c", "end")
    nodes = _read(body).scope.nodes
    found = {}
    for name in items:
        work = nodes[name].activity
        assert work is not None
        found[name] = (work.parameters["operation"].literal, work.hints["topic"])
    assert found == {"a": ("Email", "Email"), "b": ("prices", "prices"), "c": ("hello", "hello")}


@pytest.mark.parametrize(
    ("condition", "is_met"),
    [
        ("return x != null &amp;&amp; x > 3;", True),
        ('kcontext.getVariable("x") == 4', True),
        ("#{x} == 5", False),
        ("$x == 4", True),
    ],
)
def test_conditions_of_java_and_mvel_are_read_as_juel(condition: str, is_met: bool) -> None:
    language = 'language="http://www.java.com/java"' if condition.startswith("return") else ""
    conditional = f"<bpmn:conditionExpression {language}>{condition}</bpmn:conditionExpression>"
    body = (
        start()
        + gateway("g")
        + end("end")
        + end("other")
        + flow("start", "g")
        + f'<bpmn:sequenceFlow id="f" sourceRef="g" targetRef="end">{conditional}</bpmn:sequenceFlow>'
        + flow("g", "other")
    )
    found = _read(body).scope.flows["f"].condition
    assert found is not None
    assert bool(found.value({"x": 4, "execution": {}})) is is_met


def test_a_condition_that_is_a_program_is_refused_by_its_language() -> None:
    condition = (
        '<bpmn:conditionExpression language="http://www.java.com/java">int y = x; return y > 1;'
        "</bpmn:conditionExpression>"
    )
    body = (
        start()
        + gateway("g")
        + end("end")
        + end("other")
        + flow("start", "g")
        + f'<bpmn:sequenceFlow id="f" sourceRef="g" targetRef="end">{condition}</bpmn:sequenceFlow>'
        + flow("g", "other")
    )
    with pytest.raises(BadBpmn, match=r"a condition in http://www\.java\.com/java is not supported"):
        _file(body)


def test_scripts_that_set_variables_are_run_and_others_become_tasks() -> None:
    sets = 'System.out.println("x is " + x); kcontext.setVariable("x", x + 1);'
    works = "for (Object each : list) { call(each); }"
    body = (
        start()
        + f'<bpmn:scriptTask id="a" scriptFormat="java"><bpmn:script>{sets}</bpmn:script></bpmn:scriptTask>'
        + f'<bpmn:scriptTask id="b"><bpmn:script>{works}</bpmn:script></bpmn:scriptTask>'
        + end()
        + path("start", "a", "b", "end")
    )
    nodes = _read(body).scope.nodes
    (assignment,) = nodes["a"].script or ()
    assert (assignment.target, assignment.value.value({"x": 2})) == ("x", 3)
    work = nodes["b"].activity
    assert work is not None
    assert work.parameters["script"].literal == works


def test_scripts_at_entry_set_variables() -> None:
    script = (
        "<bpmn:extensionElements><tns:onEntry-script><tns:script>kcontext.setVariable('x', 5);</tns:script>"
        "</tns:onEntry-script><tns:metaData name='elementname'/></bpmn:extensionElements>"
    )
    definition = _read(between(f'<bpmn:userTask id="x1">{script}</bpmn:userTask>', "x1"))
    assert [node.script is not None for node in definition.scope.nodes.values()].count(True) == 1
    assert definition.warnings == ()


def test_a_call_passes_the_associated_variables_only() -> None:
    called = f'<bpmn:callActivity id="x1" calledElement="q">{_data({"subX": "x"}, {"subY": "found"})}'
    call = _read(between(called + "</bpmn:callActivity>", "x1")).scope.nodes["x1"].call
    assert call is not None
    assert not call.all_inputs
    assert [(each.target, each.value.value({"x": 7})) for each in call.inputs] == [("subX", 7)]
    assert [(each.target, each.value.value({"subY": 8})) for each in call.outputs] == [("found", 8)]


@pytest.mark.parametrize(
    ("given", "expected"),
    [("5m", "P0DT0H5M0.000S"), ("1d2h", "P1DT2H0M0.000S"), ("500ms", "P0DT0H0M0.500S"), ("PT2S", "PT2S")],
)
def test_durations_may_be_written_without_iso_8601(given: str, expected: str) -> None:
    timer = (
        '<bpmn:intermediateCatchEvent id="x1"><bpmn:timerEventDefinition><bpmn:timeDuration>'
        f"{given}</bpmn:timeDuration></bpmn:timerEventDefinition></bpmn:intermediateCatchEvent>"
    )
    event = _read(between(timer, "x1")).scope.nodes["x1"].event
    assert isinstance(event, TimerEvent)
    assert event.value.literal == expected


def test_a_reference_to_no_signal_is_the_name_of_one() -> None:
    event = (
        '<bpmn:intermediateCatchEvent id="x1"><bpmn:signalEventDefinition signalRef="Halt"/>'
        "</bpmn:intermediateCatchEvent>"
    )
    file = _file(between(event, "x1"))
    found = file.definitions[0].scope.nodes["x1"].event
    assert isinstance(found, SignalEvent)
    assert found.name.literal == "Halt"
    assert [warning.message for warning in file.warnings] == [
        'signalRef "Halt" names no bpmn:signal of this file; it is read as its name'
    ]


def test_a_process_may_be_called_by_its_name() -> None:
    found = _read(between('<bpmn:callActivity id="x" tns:calledElementByName="other"/>')).scope.nodes["x"]
    assert found.call is not None
    assert found.call.process.literal == "other"


def test_an_item_that_an_instance_does_not_set_is_null() -> None:
    loop = (
        "<bpmn:multiInstanceLoopCharacteristics><bpmn:loopDataInputRef>list</bpmn:loopDataInputRef>"
        '<bpmn:loopDataOutputRef>found</bpmn:loopDataOutputRef><bpmn:outputDataItem id="made"/>'
        "</bpmn:multiInstanceLoopCharacteristics>"
    )
    found = _read(between(f'<bpmn:userTask id="x">{loop}</bpmn:userTask>')).scope.nodes["x"].loop
    assert isinstance(found, MultiInstance)
    assert found.output_item is not None
    assert found.output_item.value({}) is None
    assert found.output_item.value({"made": 3}) == 3


@pytest.mark.parametrize(
    ("element", "reason"),
    [
        (
            '<bpmn:businessRuleTask id="x" implementation="http://www.jboss.org/drools/dmn"/>',
            "businessRuleTask with a DMN decision is not supported yet",
        ),
        (
            '<bpmn:intermediateCatchEvent id="x"><bpmn:conditionalEventDefinition>'
            '<bpmn:condition language="http://www.jboss.org/drools/rule">Person(age > 3)</bpmn:condition>'
            "</bpmn:conditionalEventDefinition></bpmn:intermediateCatchEvent>",
            "a condition in http://www.jboss.org/drools/rule is not supported yet",
        ),
    ],
)
def test_decisions_and_rules_are_refused_by_name(element: str, reason: str) -> None:
    with pytest.raises(BadBpmn) as bad:
        _read(between(element))
    assert len(bad.value.faults) == 1
    assert reason in str(bad.value.faults[0])


def test_an_assignment_of_a_data_output_is_a_warning() -> None:
    body = between(f'<bpmn:userTask id="x">{_data({}, {"result": "found"})}</bpmn:userTask>').replace(
        "<bpmn:targetRef>found</bpmn:targetRef>",
        "<bpmn:targetRef>found</bpmn:targetRef><bpmn:assignment><bpmn:from>#{result.part}</bpmn:from>"
        "<bpmn:to>found</bpmn:to></bpmn:assignment>",
    )
    assert "the assignment of a data output has no effect" in str(_file(body).warnings[0])
