"""Our dialect: the Task of an activity, the parameters of a process, and entities as events."""

from dataclasses import replace
from pathlib import Path

import pytest
from lxml import etree

import handover_processes
from handover_bpmn.model import (
    ConditionalEvent,
    EntityFilter,
    FormBinding,
    FormReference,
    MessageEvent,
    SignalEvent,
)
from handover_bpmn.notation.dialects.handover_elements import (
    ATTRIBUTES,
    EVALUATED,
    NAMESPACE,
    check_attributes,
)
from handover_bpmn.notation.faults import Findings
from handover_bpmn.notation.file import read_bpmn
from services.task_orchestrator.tests.unit.bpmn.notation.reading import (
    between,
    extended,
    faults,
    node,
    read,
    warnings,
)
from services.task_orchestrator.tests.unit.drawing import activity, end, parameters, path, start, timer
from services.task_orchestrator.tests.unit.process_driver import ProcessDriver

SHIPPED = sorted((Path(handover_processes.__file__).parent / "processes").glob("*.bpmn"))


@pytest.mark.parametrize("shipped", SHIPPED, ids=lambda shipped: shipped.stem)
def test_the_shipped_processes_are_read_without_warnings(shipped: Path) -> None:
    found = read_bpmn(shipped.read_bytes())
    assert not found.warnings
    assert all(definition.activities() for definition in found.definitions)


def test_an_activity_has_the_attributes_of_its_task() -> None:
    inner = (
        '<handover:involves expression="operator"/>'
        '<handover:happensAt location="Location:bin-1" function="source"/>'
        '<handover:parameter name="commandId" value="3"/>'
        '<handover:parameter name="gesture" value="Thumbs up"/>'
        '<handover:parameter name="target" expression="scan.pose"/>'
        '<handover:output name="partFound" from="found"/>'
    )
    work = node(activity("x", inner, attributes='deadline="PT5M" handlesOutcomes="true"')).activity
    assert work is not None
    assert work.definition == "x"
    assert work.handles_outcomes
    assert [value.value({"operator": "Device:x"}) for value in work.involves] == [
        "Device:glove-1",
        "Device:x",
    ]
    assert work.happens_at[0].function == "source"
    assert {name: value.literal for name, value in work.parameters.items()} == {
        "commandId": 3,
        "gesture": "Thumbs up",
        "target": None,
    }
    assert work.parameters["target"].value({"scan": {"pose": [1]}}) == [1]
    assert work.results({"found": True, "other": 1}) == {"partFound": True}
    assert work.deadline is not None
    assert work.deadline.nominal_s == 300


def test_without_named_outputs_they_go_to_a_variable_named_like_the_element() -> None:
    work = node(activity("scan-the.bin"), "scan-the.bin").activity
    assert work is not None
    assert work.results({"found": True}) == {"scan_the_bin": {"found": True}}


def test_ids_that_differ_in_a_dash_never_share_a_variable() -> None:
    body = start() + activity("a-b") + activity("a.b") + activity("a_b") + end()
    body += path("start", "a-b", "a.b", "a_b", "end")
    activities = read(body).activities()
    assert [each.variable for each in activities.values()] == ["a_b", "a_b_2", "a_b_3"]
    assert warnings(body)[0] == (
        'line 1, "a.b": its results are in the variable "a_b_2", since "a_b" has those of "a-b"'
    )


def test_a_process_declares_its_parameters_with_defaults() -> None:
    definition = read(parameters(tries="3", bin="bin-1") + between(activity("x")))
    assert definition.label == "7"
    assert definition.arguments({"bin": "bin-2"}) == {"tries": 3, "bin": "bin-2"}


def test_an_activity_without_extension_elements_is_a_task_for_somebody() -> None:
    work = node('<bpmn:userTask id="x" name="Check the part"/>').activity
    assert work is not None
    assert (work.definition, work.name, work.involves, work.variable) == ("x", "Check the part", (), "x")
    assert not work.hints


@pytest.mark.parametrize(
    ("id_", "name", "definition"),
    [
        ("Activity_0k2pzw1", "Pièce (à gauche)", "piece-a-gauche"),
        ("UserTask_1", "Approve", "approve"),
        ("sid-3A5B6C7D-1234-4567-89AB-0123456789AB", "Approve it", "approve-it"),
        ("Activity_0k2pzw1", "", "Activity_0k2pzw1"),
        ("Activity_0k2pzw1", "部品", "Activity_0k2pzw1"),
        ("pick_part", "Pick the part", "pick_part"),
    ],
)
def test_the_definition_is_called_like_the_id_or_the_name_if_the_id_was_generated(
    id_: str, name: str, definition: str
) -> None:
    work = node(f'<bpmn:userTask id="{id_}" name="{name}"/>', id_).activity
    assert work is not None
    assert work.definition == definition


def test_the_lane_is_the_innermost() -> None:
    lanes = (
        '<bpmn:laneSet id="l"><bpmn:lane id="cell" name="Cell"><bpmn:flowNodeRef>x</bpmn:flowNodeRef>'
        '<bpmn:childLaneSet id="c"><bpmn:lane id="robot" name="Robot">'
        "<bpmn:flowNodeRef> x </bpmn:flowNodeRef></bpmn:lane></bpmn:childLaneSet></bpmn:lane></bpmn:laneSet>"
    )
    work = read(lanes + between('<bpmn:task id="x"/>')).activities()["x"]
    assert work.lane == "Robot"


def event(kind: str, definition: str, on: str) -> str:
    return extended(kind, on, inner=f"<bpmn:{definition}EventDefinition/>")


def test_an_entity_is_a_message_a_signal_or_a_condition() -> None:
    on = (
        '<handover:on type="Alert" idPattern=".*:cell-1:.*" q=\'severity=="high"\' variable="alert" '
        'correlation="alert.source"/>'
    )
    message = node(event("intermediateCatchEvent", "message", on)).event
    assert isinstance(message, MessageEvent)
    assert message.correlation is None
    assert message.on is not None
    assert message.on.correlated({"source": "x"}) == "x"
    unconditional = replace(message.on, correlation=None)
    assert unconditional == EntityFilter("Alert", ".*:cell-1:.*", 'severity=="high"', "alert")
    assert unconditional.correlated({"source": "x"}) is None
    signal = node(event("intermediateCatchEvent", "signal", '<handover:on type="Task"/>')).event
    assert isinstance(signal, SignalEvent)
    assert signal.on == EntityFilter("Task")
    condition = node(event("intermediateCatchEvent", "conditional", '<handover:on type="Device"/>')).event
    assert isinstance(condition, ConditionalEvent)
    assert condition.condition.value({}) is True
    assert condition.on == EntityFilter("Device")


@pytest.mark.parametrize(
    ("element", "reason"),
    [
        (event("intermediateCatchEvent", "message", '<handover:on type="a b"/>'), "names no entity type"),
        (event("intermediateCatchEvent", "message", '<handover:on type="A" idPattern="("/>'), "regular expr"),
        (event("intermediateCatchEvent", "message", '<handover:on type="A" variable="1"/>'), "cannot be the"),
        (
            event("intermediateCatchEvent", "message", '<handover:on type="A" correlation="1+"/>'),
            "not an",
        ),
        (
            event("intermediateCatchEvent", "message", '<handover:on type="A" correlation="a.id"/>'),
            'reads only "entity"',
        ),
        (event("intermediateCatchEvent", "message", '<handover:on type="A" x="1"/>'), 'no attribute "x"'),
        (event("intermediateCatchEvent", "timer", '<handover:on type="A"/>'), "handover:on stands in"),
        (extended("task", '<handover:on type="A"/>'), "handover:on is unknown here"),
        (activity("x", '<handover:involves resource="glove one"/>'), 'resource="glove one" names no entity'),
        (activity("x", '<handover:material entity="Asset:tray"/>'), '"Asset:tray" is no Material'),
        (activity("x", '<handover:asset entity="a tray"/>'), 'entity="a tray" names no entity'),
        (activity("x", attributes='deadline="soon"'), "no ISO 8601 duration"),
        (activity("x", attributes='robot="x"'), 'has no attribute "robot"'),
        (activity("x", attributes='handlesOutcomes="yes"'), "neither true nor false"),
        (activity("x", '<handover:parameter name="x" expression="1 +"/>'), "is not an expression"),
        (activity("x", '<handover:parameter name="x" value="1"/>' * 2), 'the parameter "x" is given twice'),
        (activity("x", '<handover:parameter name="x"/>'), "either value or expression"),
        (
            activity("x", '<handover:parameter name="x" value="${torque}"/>'),
            'value="${torque}" is an expression where a literal stands; write expression="torque" instead',
        ),
        (activity("x", '<handover:parameter name="x" value="=torque"/>'), 'write expression="torque"'),
        (
            activity("x", '<handover:parameter name="x" value="${a}: it\'s ${b.c}"/>'),
            """write expression="a + ': it\\'s ' + b.c" instead""",
        ),
        (
            activity("x", '<handover:parameter name="x" value=\'{"a": "Turn ${n}"}\'/>'),
            "is an expression where a literal stands",
        ),
        (
            activity("x", '<handover:happensAt location="Location:a" function="#{f}"/>'),
            'function="#{f}" is an expression',
        ),
        (activity("x", '<handover:output name="a b"/>'), '"a b" cannot be the name of a variable'),
        (activity("x", '<handover:lane name="x"/>'), "lane is unknown here"),
        (extended("task", '<handover:task definition="a b"/>'), "is not a name"),
        (extended("task", '<handover:task definition="a"/>' * 2), "one handover:task is enough"),
        ('<bpmn:scriptTask id="x"><bpmn:script>import os</bpmn:script></bpmn:scriptTask>', "has lines like"),
        ('<bpmn:scriptTask id="x"/>', "a scriptTask needs a script"),
    ],
)
def test_a_wrong_extension_is_one_fault_at_its_element(element: str, reason: str) -> None:
    found = faults(between(element).replace("<bpmn:timerEventDefinition/>", timer("PT1M")))
    assert len(found) == 1, found
    assert found[0].startswith('line 1, "x"')
    assert reason in found[0]


def test_a_variable_that_would_be_a_word_of_the_language_gets_another_name() -> None:
    work = node(activity("not"), "not").activity
    assert work is not None
    assert work.variable == "not_"


def test_an_unknown_attribute_of_ours_is_a_warning() -> None:
    assert warnings(between('<bpmn:task id="x" handover:robot="a"/>')) == [
        'line 1, "x": handover:robot has no effect on the execution'
    ]


def test_a_script_assigns_variables() -> None:
    script = node(
        '<bpmn:scriptTask id="x"><bpmn:script>a = 1\nb = a + 1</bpmn:script></bpmn:scriptTask>'
    ).script
    assert script is not None
    assert [(each.target, each.value.value({"a": 1})) for each in script] == [("a", 1), ("b", 2)]


def handover_task(inner: str, attributes: str = "") -> str:
    return extended("userTask", f'<handover:task definition="check" {attributes}>{inner}</handover:task>')


def test_a_task_of_people_has_a_form_dates_and_candidates() -> None:
    schema = '{"type": "object", "properties": {"mm": {"type": "number"}}}'
    attributes = 'candidateGroups="quality" dueDate="PT2H" followUpDate="PT1H" priority="80"'
    inner = f"<handover:form>{schema}</handover:form><handover:inputSchema>{schema}</handover:inputSchema>"
    work = node(handover_task(inner, attributes)).activity
    assert work is not None
    assert work.parameters["form"].literal == work.inputs_schema
    assert work.hints == {
        "candidateGroups": "quality",
        "dueDate": "PT2H",
        "followUpDate": "PT1H",
        "priority": "80",
    }
    named = node(handover_task('<handover:form ref="check" version="3"/>')).activity
    assert named is not None
    assert named.form == FormReference("check", FormBinding.VERSION, 3)


@pytest.mark.parametrize(
    "form",
    ["no JSON", '{"type": "nothing"}', '{"components": [{"type": "textfield"}]}', "[]"],
)
def test_a_wrong_form_is_a_fault(form: str) -> None:
    assert faults(between(handover_task(f"<handover:form>{form}</handover:form>")))


def test_every_attribute_that_is_not_evaluated_refuses_an_expression() -> None:
    for element, attributes in ATTRIBUTES.items():
        for name in attributes - EVALUATED.get(element, frozenset()) - {"expression"}:
            extension = etree.Element(f"{{{NAMESPACE}}}{element}", {name: "${x}"})
            found = Findings()
            check_attributes(extension, found)
            assert [f'{name}="${{x}}" is an expression' in each.message for each in found.faults] == [True]
            deployed = Findings(is_deployed=True)  # it was accepted by an earlier release
            check_attributes(extension, deployed)
            assert (deployed.faults, len(deployed.warnings)) == ([], 1)


def test_a_default_of_a_process_parameter_is_no_expression() -> None:
    (fault,) = faults(parameters(torque="${x}") + between(activity("x")))
    assert fault.endswith("value is not evaluated; write the value itself")


def test_a_called_process_may_be_named_by_an_expression() -> None:
    call = node('<bpmn:callActivity id="x" calledElement="${which}"/>' + activity("y")).call
    assert call is not None
    assert call.process.value({"which": "called"}) == "called"


def test_a_text_in_quotes_is_a_literal() -> None:
    work = node(activity("x", '<handover:parameter name="x" value=\'"${torque}"\'/>')).activity
    assert work is not None
    assert work.parameters["x"].literal == "${torque}"


@pytest.mark.parametrize(
    ("drawn", "shown"),
    [
        ("Weigh", "Weigh (1/2: bin-1)"),
        ("Weigh part ${loopCounter + 1}: ${item.name}", "Weigh part 1: bin-1"),
        ("Weigh ${missing}", "Weigh ${missing}"),
    ],
)
def test_the_name_of_a_task_is_evaluated_or_says_which_item_is_meant(drawn: str, shown: str) -> None:
    loop = (
        "<bpmn:multiInstanceLoopCharacteristics><bpmn:loopDataInputRef>items</bpmn:loopDataInputRef>"
        '<bpmn:inputDataItem name="item"/></bpmn:multiInstanceLoopCharacteristics>'
    )
    documentation = "<bpmn:documentation>Put ${item.name} on the scale</bpmn:documentation>"
    task = activity("work").replace('id="work">', f'id="work" name="{drawn}">{documentation}')
    body = between(task.replace("</bpmn:userTask>", loop + "</bpmn:userTask>"), "work")
    driver = ProcessDriver(body, items=[{"name": "bin-1"}, {"name": "bin-2"}])
    first = min(driver.process.tasks.values(), key=lambda each: each.visit)
    assert first.name == shown
    assert first.entity["workParameters"]["value"]["description"] == "Put bin-1 on the scale"


def test_a_task_within_instances_says_which_of_them_are_meant() -> None:
    loop = (
        "<bpmn:multiInstanceLoopCharacteristics><bpmn:loopCardinality>{}</bpmn:loopCardinality>"
        "</bpmn:multiInstanceLoopCharacteristics>"
    )
    described = '<handover:parameter name="description" value="Weigh it"/>'
    task = activity("work", described).replace("</bpmn:userTask>", loop.format(3) + "</bpmn:userTask>")
    inner = start("in") + task + path("in", "work") + loop.format(2)
    driver = ProcessDriver(between(f'<bpmn:subProcess id="x">{inner}</bpmn:subProcess>'))
    last = max(driver.process.tasks.values(), key=lambda each: each.visit)
    assert last.name == "work (2/2, 3/3)"
    assert last.entity["workParameters"]["value"]["description"] == "Weigh it (2/2, 3/3)"


def test_an_expression_in_a_name_that_cannot_be_read_is_a_warning() -> None:
    (warning,) = warnings(between(activity("x").replace('id="x">', 'id="x" name="Weigh ${1 +}">')))
    assert "its name is shown as it is drawn" in warning
