"""Reading BPMN: what a file says, and every way in which it can be wrong."""

from pathlib import Path
from typing import Any

import pytest

import handover_processes
from handover_bpmn.model import Definition
from handover_bpmn.notation.faults import MAX_FAULTS_LISTED, BadBpmn
from handover_bpmn.notation.file import read_bpmn
from handover_gloves.recognition.gestures import DEFAULT_COMMANDS
from handover_processes.records.entities import definition_entities
from handover_processes.settings import OrchestratorSettings
from services.task_orchestrator.tests.unit.drawing import (
    ONE_STEP,
    activity,
    boundary,
    drawing,
    end,
    flow,
    gateway,
    parameters,
    path,
    start,
    timer,
)
from services.task_orchestrator.tests.unit.process_driver import only_process

SHIPPED = sorted((Path(handover_processes.__file__).parent / "processes").glob("*.bpmn"))


def faults(body: str, **more: str) -> list[str]:
    with pytest.raises(BadBpmn) as bad:
        read_bpmn(drawing(body, **more))
    assert bad.value.status == 422
    listed = bad.value.body()["faults"]
    code = {"messageCode", "messageParameters"}
    for error in listed:
        assert set(error) - (code if code <= set(error) else set()) == {"element", "name", "line", "message"}
    return [str(fault) for fault in bad.value.faults]


def test_an_activity_has_the_attributes_of_its_task() -> None:
    inner = (
        '<handover:involves expression="operator"/>'
        '<handover:happensAt location="Location:bin-1" function="source"/>'
        '<handover:parameter name="commandId" value="3"/>'
        '<handover:parameter name="gesture" value="Thumbs up"/>'
        '<handover:parameter name="target" expression="scan.pose"/>'
        '<handover:output name="partFound" from="found"/>'
    )
    body = (
        start() + activity("work", inner, attributes='deadline="PT5M"') + end() + path("start", "work", "end")
    )
    work = only_process(drawing(body)).activities()["work"]
    assert work.definition == "work"
    assert [given.value({"operator": "Device:x"}) for given in work.involves] == [
        "Device:glove-1",
        "Device:x",
    ]
    assert work.happens_at[0].function == "source"
    assert {name: given.literal for name, given in work.parameters.items()} == {
        "commandId": 3,
        "gesture": "Thumbs up",
        "target": None,
    }
    assert work.parameters["target"].value({"scan": {"pose": [1]}}) == [1]
    assert work.results({"found": True, "other": 1}) == {"partFound": True}
    assert work.deadline is not None
    assert work.deadline.nominal_s == 300


def test_without_named_outputs_all_of_them_go_to_a_variable_named_after_the_element() -> None:
    body = start() + activity("scan-the.bin") + end() + path("start", "scan-the.bin", "end")
    work = only_process(drawing(body)).activities()["scan-the.bin"]
    assert work.results({"found": True}) == {"scan_the_bin": {"found": True}}


def test_a_process_declares_its_parameters_with_defaults() -> None:
    definition = only_process(drawing(parameters(tries="3", bin="bin-1") + ONE_STEP))
    assert definition.label == "7"
    assert definition.arguments({"bin": "bin-2"}) == {"tries": 3, "bin": "bin-2"}


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_the_shipped_processes_can_be_deployed(file: Path) -> None:
    assert only_process(file.read_bytes()).activities()


def bin_picking() -> Definition:
    return only_process(next(file for file in SHIPPED if file.stem == "bin_picking").read_bytes())


def test_bin_picking_asks_for_six_gestures_each_under_the_number_of_the_command_map() -> None:
    asked = {
        activity.parameters["commandId"].literal: activity.parameters["gesture"].literal
        for activity in bin_picking().activities().values()
        if activity.lane == "Operator" and activity.id != "adjust_view"  # that is done on the screen
    }
    assert len(asked) == 6
    assert asked == {command: DEFAULT_COMMANDS[command] for command in asked}


def test_bin_picking_can_be_drawn() -> None:
    definition = bin_picking()
    text = definition.xml.decode()
    for node in definition.nodes():
        assert f'bpmnElement="{node.id}"' in text
    assert text.count("<bpmn:sequenceFlow ") == text.count("<bpmndi:BPMNEdge ")


WORK = activity("work")

WRONG = {
    "hostile condition": (
        start()
        + gateway("g", default="g_end")
        + end()
        + end("o")
        + path("start", "g", "end")
        + flow("g", "o", "open('x')"),
        "only these functions can be called",
    ),
    "no reference": (
        start()
        + activity("work", '<handover:involves resource="glove one"/>')
        + end()
        + path("start", "work", "end"),
        'resource="glove one" names no entity',
    ),
    "bad deadline": (
        start() + activity("work", attributes='deadline="soon"') + end() + path("start", "work", "end"),
        "no ISO 8601 duration",
    ),
    "bad parameter": (
        start()
        + activity("work", '<handover:parameter name="x" expression="1 +"/>')
        + end()
        + path("start", "work", "end"),
        "is not an expression",
    ),
    "parameter twice": (
        start()
        + activity("work", '<handover:parameter name="x" value="1"/><handover:parameter name="x" value="2"/>')
        + end()
        + path("start", "work", "end"),
        'the parameter "x" is given twice',
    ),
    "unknown extension": (
        start() + activity("work", '<handover:lane name="x"/>') + end() + path("start", "work", "end"),
        "lane is unknown here",
    ),
    "unknown attribute": (
        start() + activity("work", attributes='robot="x"') + end() + path("start", "work", "end"),
        'has no attribute "robot"',
    ),
    "call activity": (ONE_STEP + '<bpmn:callActivity id="c"/>', "the call activity names no process"),
    "sub-process": (ONE_STEP + '<bpmn:subProcess id="s"/>', "the subprocess is empty"),
    "unknown element": (ONE_STEP + '<bpmn:teleport id="t"/>', "teleport is not supported yet"),
    "loop marker": (
        start()
        + WORK.replace("</bpmn:userTask>", "<bpmn:standardLoopCharacteristics/></bpmn:userTask>")
        + end()
        + path("start", "work", "end"),
        "a loop needs a loopCondition or loopMaximum",
    ),
    "bad timer": (
        start()
        + f'<bpmn:intermediateCatchEvent id="t">{timer("P5X")}</bpmn:intermediateCatchEvent>'
        + end()
        + path("start", "t", "end"),
        "no ISO 8601 duration",
    ),
    "error that goes on": (
        ONE_STEP
        + boundary("oops", "work", "<bpmn:errorEventDefinition/>", interrupting=False)
        + flow("oops", "end"),
        "an error boundary event interrupts",
    ),
    "same error twice": (
        ONE_STEP
        + boundary("oops", "work", "<bpmn:errorEventDefinition/>")
        + boundary("again", "work", "<bpmn:errorEventDefinition/>")
        + flow("oops", "end")
        + flow("again", "end"),
        "catches the same error",
    ),
    "unknown error": (
        ONE_STEP
        + boundary("oops", "work", '<bpmn:errorEventDefinition errorRef="no"/>')
        + flow("oops", "end"),
        'errorRef "no" names no bpmn:error',
    ),
    "script of Python": (
        start()
        + '<bpmn:scriptTask id="s"><bpmn:script>import os</bpmn:script></bpmn:scriptTask>'
        + end()
        + path("start", "s", "end"),
        "a script has lines like",
    ),
    "empty script": (
        start() + '<bpmn:scriptTask id="s"/>' + end() + path("start", "s", "end"),
        "a scriptTask needs a script",
    ),
}


@pytest.mark.parametrize("wrong", WRONG, ids=str)
def test_an_invalid_model_is_refused_with_element_line_and_rule(wrong: str) -> None:
    body, reason = WRONG[wrong]
    assert any(reason in fault for fault in faults(body)), faults(body)


def test_all_faults_are_said_at_once_with_their_lines() -> None:
    body = (
        "\n" + start() + "\n" + activity("a", attributes='deadline="x"') + "\n<bpmn:callActivity id='c'/>\n"
    )
    said = faults(body)
    assert len(said) == 2
    assert any(fault.startswith('line 3, "a"') for fault in said)
    assert any(fault.startswith('line 4, "c"') for fault in said)


@pytest.mark.parametrize(
    ("xml", "reason"),
    [
        (b"", "not well-formed"),
        (b"this is no XML", "not well-formed"),
        (b"\xff\xfe\x00", "not well-formed"),
        (b"<a/>", "the root must be bpmn:definitions"),
        (drawing(ONE_STEP)[:-20], "not well-formed"),
        (b" " * 5_000_000, "at most 4194304 bytes"),
        (
            drawing("").replace(b'isExecutable="true"', b'isExecutable="false"'),
            "no process of the 1 in the file is executable",
        ),
        (drawing(ONE_STEP, beside='<bpmn:process id="q" isExecutable="true"/>'), "no start event"),
        (drawing(ONE_STEP, name="a b"), "needs an id"),
    ],
)
def test_what_is_no_bpmn_file_is_refused(xml: bytes, reason: str) -> None:
    with pytest.raises(BadBpmn, match=reason):
        read_bpmn(xml)


def test_an_xml_bomb_is_refused_at_once() -> None:
    laughs = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 10))
    bomb = f'<!DOCTYPE bomb [<!ENTITY l0 "ha">{laughs}]>'.encode() + drawing(ONE_STEP.replace("work", "&l9;"))
    with pytest.raises(BadBpmn):
        read_bpmn(bomb)


def test_an_external_entity_is_never_read(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("the secret")
    doctype = f'<!DOCTYPE x [<!ENTITY secret SYSTEM "file://{secret}">]>'.encode()
    with pytest.raises(BadBpmn, match="DOCTYPE") as bad:
        read_bpmn(doctype + drawing(start() + "&secret;"))
    assert "the secret" not in str(bad.value.body())


def test_handles_outcomes_is_true_or_false_and_goes_into_the_task_definition() -> None:
    def definition(attributes: str) -> dict[str, Any]:
        body = start() + activity("work", attributes=attributes) + end() + path("start", "work", "end")
        read = only_process(drawing(body))
        return definition_entities(OrchestratorSettings(_env_file=None), read, 1, "http://here/bpmn")[1]

    assert definition('handlesOutcomes="true"')["handlesOutcomes"] == {"type": "Property", "value": True}
    assert "handlesOutcomes" not in definition('handlesOutcomes="false"')
    body = (
        start() + activity("work", attributes='handlesOutcomes="yes"') + end() + path("start", "work", "end")
    )
    assert faults(body) == ['line 1, "work": handlesOutcomes="yes" is neither true nor false']


def test_a_task_that_requires_a_pin_says_so_in_its_definition() -> None:
    def definition(*attributes: str) -> dict[str, Any]:
        works = [activity(f"w{number}", attributes=one) for number, one in enumerate(attributes)]
        same = "".join(works).replace('definition="w1"', 'definition="w0"')
        body = start() + same + end() + path("start", *(f"w{n}" for n in range(len(works))), "end")
        read = only_process(drawing(body))
        return definition_entities(OrchestratorSettings(_env_file=None), read, 1, "http://here/bpmn")[1]

    assert definition('requirePin="true"')["requirePin"] == {"type": "Property", "value": True}
    assert definition("", 'requirePin="true"')["requirePin"]["value"], "one activity that demands it decides"
    assert "requirePin" not in definition('requirePin="false"')
    body = start() + activity("work", attributes='requirePin="1"') + end() + path("start", "work", "end")
    assert faults(body) == ['line 1, "work": requirePin="1" is neither true nor false']


def test_bin_picking_has_a_way_for_every_answer_to_what_allows_the_robot_to_move() -> None:
    read = bin_picking()
    allow = ["confirm_clear", "check_view", "confirm_pick", "confirm_grip", "confirm_placed"]
    assert [one.id for one in read.activities().values() if one.handles_outcomes] == allow


def test_a_file_of_very_many_elements_is_refused_by_its_size() -> None:
    many = start() + activity("work", '<handover:parameter name="p" value="1"/>' * 100_000)
    with pytest.raises(BadBpmn, match="elements"):
        read_bpmn(drawing(many + end() + path("start", "work", "end")))


def test_of_very_many_faults_the_answer_lists_the_first() -> None:
    wrong = "".join(f'<bpmn:callActivity id="c{n}"/>' for n in range(200))
    with pytest.raises(BadBpmn) as bad:
        read_bpmn(drawing(ONE_STEP + wrong))
    assert len(bad.value.faults) >= 200
    assert len(bad.value.body()["faults"]) == MAX_FAULTS_LISTED
