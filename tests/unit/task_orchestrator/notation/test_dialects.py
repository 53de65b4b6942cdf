"""Which dialect a file has, and which language its conditions."""

import pytest

from services.task_orchestrator.notation.dialects.camunda7 import Camunda7
from services.task_orchestrator.notation.dialects.choice import Dialects
from services.task_orchestrator.notation.dialects.handover import Handover
from services.task_orchestrator.notation.dialects.zeebe import Zeebe
from services.task_orchestrator.notation.document import parse
from tests.unit.task_orchestrator.drawing import activity, end, gateway, path, start
from tests.unit.task_orchestrator.notation.reading import between, extended, faults, file, read, warnings

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
