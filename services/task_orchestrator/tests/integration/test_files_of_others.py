"""Files as the engines of others have them: deployed over REST, and done by a person in the tasklist."""

from dataclasses import dataclass, field
from typing import Any

import httpx
import pytest

from services.task_orchestrator.tests.integration.cell import Cell, eventually

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("files-of-others")]

HEAD = '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" {} targetNamespace="urn:t">'


@dataclass(frozen=True)
class Case:
    """A file: what it declares, its process, what a person answers, and the end."""

    declares: str
    body: str
    answers: dict[str, dict[str, Any]]
    """The Tasks in their order by element, and their results."""
    parameters: dict[str, Any] = field(default_factory=dict)
    result: dict[str, Any] = field(default_factory=dict)
    """Variables at the end."""


def flows(*ends: str) -> str:
    """Return sequence flows; of `a>b?condition` with a condition."""
    found = ""
    for number, each in enumerate(ends):
        source, _, rest = each.partition(">")
        target, _, condition = rest.partition("?")
        asked = f"<conditionExpression><![CDATA[{condition}]]></conditionExpression>" if condition else ""
        found += (
            f'<sequenceFlow id="f{number}" sourceRef="{source}" targetRef="{target}">{asked}</sequenceFlow>'
        )
    return found


CASES = {
    "jbpm": Case(
        'typeLanguage="http://www.java.com/javaTypes" expressionLanguage="http://www.mvel.org/2.0"',
        '<property id="result"/><startEvent id="s"/><userTask id="inspect">'
        '<ioSpecification><dataOutput id="o" name="result"/></ioSpecification>'
        "<dataOutputAssociation><sourceRef>o</sourceRef><targetRef>result</targetRef></dataOutputAssociation>"
        '</userTask><exclusiveGateway id="g"/><scriptTask id="count" scriptFormat="java"><script>'
        'System.out.println("ok: " + result); kcontext.setVariable("note", "part " + result + 1);'
        '</script></scriptTask><userTask id="scrap"/><endEvent id="e"><terminateEventDefinition/></endEvent>'
        + flows(
            "s>inspect",
            "inspect>g",
            'g>count?return KieFunctions.equalsTo(result, "good");',
            "g>scrap",
            "count>e",
            "scrap>e",
        ),
        {"inspect": {"result": "good"}},
        result={"note": "part good1"},
    ),
    "flowable": Case(
        'xmlns:flowable="http://flowable.org/bpmn"',
        '<dataObject id="d" name="limit" itemSubjectRef="xsd:int"><extensionElements><flowable:value>2'
        '</flowable:value></extensionElements></dataObject><startEvent id="s"/><userTask id="review">'
        '<multiInstanceLoopCharacteristics isSequential="true"><extensionElements>'
        '<flowable:variableAggregation target="reviews"><variable source="good"/>'
        "</flowable:variableAggregation></extensionElements><loopCardinality>${limit}</loopCardinality>"
        '</multiInstanceLoopCharacteristics></userTask><exclusiveGateway id="g"/>'
        '<serviceTask id="mark" flowable:expression="${execution.setVariable(\'mark\', limit * 2)}"/>'
        '<userTask id="no"/><endEvent id="e"/>'
        + flows("s>review", "review>g", "g>mark?${vars:gte(limit, 2)}", "g>no", "mark>e", "no>e"),
        {"review": {"good": True}},
        result={"mark": 4, "reviews": [{"good": True}, {"good": True}]},
    ),
    "zeebe": Case(
        'xmlns:zeebe="http://camunda.org/schema/zeebe/1.0"',
        '<startEvent id="s"/><userTask id="pick"><extensionElements><zeebe:ioMapping>'
        '<zeebe:input source="= order.lines" target="from.lines"/>'
        '<zeebe:output source="= from.lines[1]" target="first"/></zeebe:ioMapping></extensionElements>'
        '<multiInstanceLoopCharacteristics isSequential="true"><extensionElements>'
        '<zeebe:loopCharacteristics inputCollection="= order.lines" inputElement="line"/>'
        "</extensionElements><completionCondition>= numberOfCompletedInstances = 2</completionCondition>"
        '</multiInstanceLoopCharacteristics></userTask><scriptTask id="sum"><extensionElements>'
        '<zeebe:script expression="= median([1, 2, 9])" resultVariable="middle"/></extensionElements>'
        '</scriptTask><endEvent id="e"/>' + flows("s>pick", "pick>sum", "sum>e"),
        {"pick": {}},
        {"order": {"lines": ["a", "b", "c"]}},
        {"first": "a", "middle": 2},
    ),
    "plain": Case(
        "",
        '<startEvent id="1-start"/><userTask id="0b6c1b9e-8a4b" name="Check"/><exclusiveGateway id="g"/>'
        '<scriptTask id="free"><script>write a note</script></scriptTask><endEvent id="e"/>'
        '<userTask id="other"/>'
        + flows("1-start>0b6c1b9e-8a4b", "0b6c1b9e-8a4b>g", "g>free?n > 1 && !off", "g>other", "free>e"),
        {"0b6c1b9e-8a4b": {}, "free": {}},
        {"n": 2, "off": False},
    ),
}


@pytest.mark.nightly
@pytest.mark.parametrize("name", CASES)
def test_a_file_of_another_engine_is_done_by_a_person(running: Cell, name: str) -> None:
    case = CASES[name]
    process = f'<process id="Prüfung-{name}" isExecutable="true">{case.body}</process></definitions>'
    xml = HEAD.format(case.declares) + process
    answer = running.api.post(
        "/definitions", content=xml.encode(), headers={"Content-Type": "application/xml"}
    )
    assert answer.status_code == 201, answer.text
    (definition,) = answer.json()["definitions"]
    started = running.start(definition["name"], **case.parameters)
    done: list[str] = []
    while (seen := eventually(lambda: _open_or_ended(running, started), f"{name} continues"))["status"] in {
        "pending",
        "inProgress",
    }:
        (task,) = [each for each in seen["tasks"] if each["status"] not in {"completed", "failed"}]
        done.append(task["element"])
        act(running, task["id"], "claim", by="ann")
        act(running, task["id"], "complete", by="ann", outputs=case.answers[task["element"]])
    assert seen["status"] == "completed", seen
    assert seen["incidents"] == []
    assert list(dict.fromkeys(done)) == list(case.answers)
    assert case.result.items() <= seen["variables"].items()


def act(running: Cell, task: str, name: str, **body: Any) -> httpx.Response:
    return running.api.post(f"/tasks/{task}/{name}", json=body).raise_for_status()


def _open_or_ended(running: Cell, process: str) -> dict[str, Any] | None:
    seen = running.look(process)
    is_over = seen["status"] in {"completed", "failed"} or seen["incidents"]
    has_task = any(each["status"] not in {"completed", "failed"} for each in seen["tasks"])
    return seen if is_over or has_task else None
