"""Which dialect a file has, and which language its conditions."""

import pytest

from handover_bpmn.model import Kind, MessageEvent, MultiInstance
from handover_bpmn.notation.dialects.camunda7 import Camunda7
from handover_bpmn.notation.dialects.choice import Dialects
from handover_bpmn.notation.dialects.handover import Handover
from handover_bpmn.notation.dialects.jbpm import Jbpm
from handover_bpmn.notation.dialects.zeebe import Zeebe
from handover_bpmn.notation.document import parse
from handover_bpmn.notation.faults import BadBpmn
from handover_bpmn.notation.file import read_bpmn
from services.task_orchestrator.tests.unit.bpmn.notation.reading import (
    between,
    extended,
    faults,
    file,
    read,
    warnings,
)
from services.task_orchestrator.tests.unit.drawing import activity, end, flow, gateway, path, start

MODELER = 'xmlns:modeler="http://camunda.org/schema/modeler/1.0" modeler:executionPlatform'


@pytest.mark.parametrize(
    ("element", "platform", "dialect"),
    [
        ('<bpmn:task id="x"/>', None, Handover),
        (activity("x"), None, Handover),
        ('<bpmn:task id="x" camunda:asyncBefore="true"/>', None, Camunda7),
        (extended("task", "<zeebe:userTask/>", attributes='camunda:x="1"'), None, Zeebe),
        ('<bpmn:task id="x" camunda:diagramRelationId="1"/>', "Camunda Cloud", Zeebe),
        ('<bpmn:task id="x"/>', "Camunda Platform", Camunda7),
    ],
)
def test_the_dialect_is_that_of_the_platform_or_of_the_namespaces_in_use(
    element: str, platform: str | None, dialect: type
) -> None:
    xml = file(between(element))
    if platform is not None:
        xml = xml.replace(b"<bpmn:definitions ", f'<bpmn:definitions {MODELER}="{platform}" '.encode())
    assert isinstance(Dialects(parse(xml)).main, dialect)


@pytest.mark.parametrize(
    ("language", "condition"),
    [
        ("", "n &gt; 1"),
        ("handover", "n &gt; 1"),
        ("juel", "${n gt 1}"),
        ("feel", "= n &gt; 1"),
        ("http://www.w3.org/1999/XPath", "n &gt; 1"),
    ],
)
def test_a_condition_may_name_its_language(language: str, condition: str) -> None:
    assert read(choice(language, condition)).scope.flows["f"].condition is not None


def test_a_condition_in_another_language_is_refused_by_name() -> None:
    assert "a condition in python is not supported yet" in faults(choice("python", "n"))[0]


def test_a_simple_condition_of_javascript_is_read_as_juel_with_a_warning() -> None:
    body = choice("javascript", "n === 1 &amp;&amp; !late;")
    condition = read(body).scope.flows["f"].condition
    assert condition is not None
    assert condition.value({"n": 1, "late": False}) is True
    assert "the condition in javascript is read as JUEL" in warnings(body)[0]
    assert "a condition in groovy is not" in faults(choice("groovy", "list.any { it > 1 }"))[0]


def choice(language: str, condition: str) -> str:
    expression = f'<bpmn:conditionExpression language="{language}">{condition}</bpmn:conditionExpression>'
    body = start() + gateway("g", default="g_end") + end() + end("o") + path("start", "g", "end")
    return body + f'<bpmn:sequenceFlow id="f" sourceRef="g" targetRef="o">{expression}</bpmn:sequenceFlow>'


def _declaring(body: str, declarations: str) -> bytes:
    """Return a file of no dialect that declares namespaces or languages, and uses none of them."""
    return (
        f'<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL" {declarations}>'
        f'<bpmn:process id="p">{body}</bpmn:process></bpmn:definitions>'
    ).encode()


@pytest.mark.parametrize(
    ("declarations", "dialect"),
    [
        ('xmlns:activiti="http://activiti.org/bpmn"', Camunda7),
        ('xmlns:z="http://camunda.org/schema/zeebe/1.0"', Zeebe),
        ('expressionLanguage="http://www.mvel.org/2.0"', Jbpm),
        ('xmlns:tns="http://www.jboss.org/drools" typeLanguage="http://www.java.com/javaTypes"', Jbpm),
        ('xmlns:tns="http://www.jboss.org/drools"', Handover),
        ('xmlns:c="http://activiti.org/bpmn" xmlns:z="http://camunda.org/schema/zeebe/1.0"', Handover),
        ('xmlns:c="http://activiti.org/bpmn" xmlns:h="urn:handover:bpmn"', Handover),
    ],
)
def test_a_file_that_uses_no_extension_has_the_dialect_that_it_declares(
    declarations: str, dialect: type
) -> None:
    assert isinstance(Dialects(parse(_declaring("", declarations))).main, dialect)


@pytest.mark.parametrize(
    ("declarations", "names"),
    [
        ('xmlns:activiti="http://activiti.org/bpmn"', ["p", "q"]),
        ('expressionLanguage="http://www.mvel.org/2.0"', ["p", "q"]),
    ],
)
def test_processes_of_activiti_and_jbpm_need_not_be_executable(declarations: str, names: list[str]) -> None:
    other = '</bpmn:process><bpmn:process id="q"><bpmn:task id="y"/>'
    refused = '</bpmn:process><bpmn:process id="r" isExecutable="false"><bpmn:task id="z"/>'
    xml = _declaring('<bpmn:task id="x"/>' + other + refused, declarations)
    assert [each.name for each in read_bpmn(xml).definitions] == names


@pytest.mark.parametrize(
    "condition", ["n &gt; 1", "n &gt; 1 &amp;&amp; !off", 'n = 2 and word = "a"', "n == 2 and not off"]
)
def test_conditions_of_a_file_of_no_dialect_may_be_those_of_several_languages(condition: str) -> None:
    body = start() + gateway("g", default="g_e") + end("e") + end("f") + path("start", "g", "e")
    (found,) = read_bpmn(_declaring(body + flow("g", "f", condition), "")).definitions
    read_condition = found.scope.flows["g_f"].condition
    assert read_condition is not None
    assert read_condition.value({"n": 2, "off": False, "word": "a"}) is True


def test_a_script_of_a_file_of_no_dialect_is_work_if_it_is_not_in_our_language() -> None:
    body = between(
        '<bpmn:scriptTask id="a"><bpmn:script>x = 1</bpmn:script></bpmn:scriptTask>'
        '<bpmn:scriptTask id="b"><bpmn:script>import os</bpmn:script></bpmn:scriptTask>'
        '<bpmn:scriptTask id="c"/>',
        "a",
    )
    found = read_bpmn(_declaring(body + path("a", "b", "c", "end"), ""))
    nodes = found.definitions[0].scope.nodes
    assert nodes["a"].script is not None
    assert nodes["b"].activity is not None
    assert nodes["b"].activity.parameters["script"].literal == "import os"
    assert nodes["c"].activity is not None
    assert ["script is not run here" in str(each) for each in found.warnings].count(True) == 1


def test_a_process_with_a_long_or_foreign_id_has_a_derived_name() -> None:
    called = '<bpmn:callActivity id="x" calledElement="Prüfung"/>'
    for id_, name in (("Prüfung", "Prufung-"), ("P" * 80, "P" * 40 + "-"), ("请假", "process-")):
        xml = _declaring(between(called), "").replace(b'process id="p"', f'process id="{id_}"'.encode())
        (found,) = read_bpmn(xml).definitions
        assert found.name.startswith(name)
        assert len(found.name) <= 64
        assert (found.title, found.scope.id) == (id_, found.name)
        call = found.scope.nodes["x"].call
        assert call is not None
        assert str(call.process.literal).startswith("Prufung-")


def test_a_condition_in_a_uri_of_feel_is_feel() -> None:
    uri = "https://www.omg.org/spec/DMN/20191111/FEEL/"
    body = start() + gateway("g", default="g_e") + end("e") + end("f") + path("start", "g", "e")
    condition = flow("g", "f", 'word = "a"').replace(
        "<bpmn:conditionExpression>", f'<bpmn:conditionExpression language="{uri}">'
    )
    found = read(body + condition).scope.flows["g_f"].condition
    assert found is not None
    assert found.value({"word": "a"}) is True


def test_ids_of_a_file_of_no_dialect_may_be_those_of_drawing_tools() -> None:
    ids = ("1-start", "0b6c1b9e-8a4b-4c33-9d8a-1a2b3c4d5e6f", "{A4-1}")
    body = "".join(f'<bpmn:task id="{id_}"/>' for id_ in ids) + path(*ids)
    (found,) = read_bpmn(_declaring(body, "")).definitions
    assert set(found.scope.nodes) == set(ids)
    with pytest.raises(BadBpmn, match="an id of letters, digits"):
        read_bpmn(_declaring('<bpmn:task id="a b"/>', ""))
    with pytest.raises(BadBpmn, match='"Check": task needs an id'):
        read_bpmn(_declaring('<bpmn:task name="Check"/>', ""))


def test_a_receive_task_that_starts_a_process_is_a_start_event() -> None:
    receive = '<bpmn:receiveTask id="x" name="Order" instantiate="true"/>'
    (found,) = read_bpmn(_declaring(receive + end() + path("x", "end"), "")).definitions
    started = found.scope.nodes["x"]
    assert started.kind is Kind.START_EVENT
    assert isinstance(started.event, MessageEvent)
    assert started.event.name.literal == "Order"


def test_an_item_whose_name_is_no_variable_is_called_like_its_id() -> None:
    loop = (
        "<bpmn:multiInstanceLoopCharacteristics><bpmn:loopDataInputRef>list</bpmn:loopDataInputRef>"
        '<bpmn:inputDataItem id="item_1" name="the item"/></bpmn:multiInstanceLoopCharacteristics>'
    )
    found = read(between(f'<bpmn:task id="x">{loop}</bpmn:task>')).scope.nodes["x"].loop
    assert isinstance(found, MultiInstance)
    assert found.item_variable == "item_1"


def test_sequence_flows_of_other_tools_may_have_one_id() -> None:
    body = '<bpmn:task id="x"/><bpmn:task id="y"/><bpmn:task id="z"/>' + path("x", "y", "z")
    xml = _declaring(body.replace('id="x_y"', 'id="f"').replace('id="y_z"', 'id="f"'), "")
    found = read_bpmn(xml)
    flows = found.definitions[0].scope.flows
    assert {each.id: each.target for each in flows.values()} == {"f": "y", "f_2": "z"}
    assert [str(each) for each in found.warnings if "used twice" in str(each)] == [
        'line 1, "f": the id "f" is used twice; this sequence flow is called "f_2" here'
    ]


def test_processes_of_one_file_may_use_the_same_ids() -> None:
    other = '</bpmn:process><bpmn:process id="q"><bpmn:task id="x"/>'
    found = read_bpmn(_declaring('<bpmn:task id="x"/>' + other, 'xmlns:a="http://activiti.org/bpmn"'))
    assert [list(each.scope.nodes) for each in found.definitions] == [["x"], ["x"]]


def test_a_loop_of_other_tools_without_an_end_is_done_once() -> None:
    loop = '<bpmn:task id="x"><bpmn:standardLoopCharacteristics/></bpmn:task>'
    found = read_bpmn(_declaring(loop, ""))
    assert found.definitions[0].scope.nodes["x"].loop is None
    assert "a loop without loopCondition and loopMaximum has no effect" in str(found.warnings[0])
