"""Files: several processes and pools, message flows, and what is listed of very many faults."""

import pytest

from handover_bpmn.model import MessageEvent
from handover_bpmn.notation.faults import MAX_FAULTS_LISTED, BadBpmn
from handover_bpmn.notation.file import MAX_PROCESSES, BpmnFile, read_bpmn
from handover_bpmn.notation.rules import MAX_NODES
from services.task_orchestrator.tests.unit.bpmn.notation.reading import NAMESPACES, between, file
from services.task_orchestrator.tests.unit.drawing import end, path, start


def pools(*bodies: str, flows: str = "", beside: str = "", attributes: str = 'isExecutable="true"') -> bytes:
    """Return a file with one process for each body, `p0`, `p1`, …, each in a pool."""
    processes = "".join(
        f'<bpmn:process id="p{nth}" {attributes}>{body}</bpmn:process>' for nth, body in enumerate(bodies)
    )
    participants = "".join(
        f'<bpmn:participant id="pool{nth}" name="Pool {nth}" processRef="p{nth}"/>'
        for nth in range(len(bodies))
    )
    collaboration = (
        f'<bpmn:collaboration id="c">{participants}<bpmn:participant id="outside" name="Customer"/>{flows}'
        "</bpmn:collaboration>"
    )
    return f"<bpmn:definitions {NAMESPACES}>{beside}{collaboration}{processes}</bpmn:definitions>".encode()


def body(nth: int, element: str) -> str:
    return start(f"s{nth}") + element + end(f"e{nth}") + path(f"s{nth}", f"x{nth}", f"e{nth}")


def throw(nth: int, reference: str = "") -> str:
    return body(
        nth,
        f'<bpmn:intermediateThrowEvent id="x{nth}"><bpmn:messageEventDefinition {reference}/>'
        "</bpmn:intermediateThrowEvent>",
    )


def catch(nth: int, reference: str = "") -> str:
    return throw(nth, reference).replace("Throw", "Catch")


def name_of(found: BpmnFile, nth: int) -> str:
    event = found.definitions[nth].scope.nodes[f"x{nth}"].event
    assert isinstance(event, MessageEvent)
    return str(event.name.value({}))


FLOW = '<bpmn:messageFlow id="flow" sourceRef="x0" targetRef="x1"/>'
DECLARED = '<bpmn:message id="m" name="order"/><bpmn:message id="n" name="bill"/>'


def test_every_executable_process_of_a_file_is_a_definition() -> None:
    found = read_bpmn(pools(throw(0), catch(1), flows=FLOW))
    assert [(each.name, each.title) for each in found.definitions] == [("p0", "Pool 0"), ("p1", "Pool 1")]
    assert not found.warnings


@pytest.mark.parametrize(
    ("first", "second", "flow", "name"),
    [
        ("", "", FLOW, "flow"),
        ('messageRef="m"', "", FLOW, "order"),
        ("", 'messageRef="m"', FLOW, "order"),
        ("", "", FLOW.replace("/>", ' messageRef="n"/>'), "bill"),
    ],
)
def test_both_ends_of_a_message_flow_have_one_message(first: str, second: str, flow: str, name: str) -> None:
    found = read_bpmn(pools(throw(0, first), catch(1, second), flows=flow, beside=DECLARED))
    assert [name_of(found, nth) for nth in range(2)] == [name, name]


def test_message_flows_from_one_event_to_two_have_one_message() -> None:
    flows = FLOW + '<bpmn:messageFlow id="other" sourceRef="x0" targetRef="x2"/>'
    found = read_bpmn(pools(throw(0), catch(1), catch(2, 'messageRef="m"'), flows=flows, beside=DECLARED))
    assert {name_of(found, nth) for nth in range(3)} == {"order"}


def test_different_messages_at_the_ends_of_a_message_flow_are_a_warning() -> None:
    xml = pools(throw(0, 'messageRef="m"'), catch(1, 'messageRef="n"'), flows=FLOW, beside=DECLARED)
    found = read_bpmn(xml)
    assert [name_of(found, nth) for nth in range(2)] == ["order", "bill"]
    assert "its ends have different messages (bill, order)" in found.warnings[0].message


def test_tasks_send_and_receive_along_message_flows_too() -> None:
    found = read_bpmn(
        pools(body(0, '<bpmn:sendTask id="x0"/>'), body(1, '<bpmn:receiveTask id="x1"/>'), flows=FLOW)
    )
    assert [name_of(found, nth) for nth in range(2)] == ["flow", "flow"]


def test_a_message_flow_to_a_pool_that_is_not_run_is_a_warning() -> None:
    flows = '<bpmn:messageFlow id="f" name="Bill" sourceRef="x0" targetRef="outside"/>'
    found = read_bpmn(pools(throw(0), flows=flows))
    assert name_of(found, 0) == "f"
    assert [str(each) for each in found.warnings] == [
        'line 1, "f" ("Bill"): the message flow has no effect, since one of its ends is not run here'
    ]


def test_a_process_that_is_not_executable_is_left_out_with_a_warning() -> None:
    xml = pools(throw(0), catch(1), flows=FLOW).replace(
        b'"p1" isExecutable="true"', b'"p1" isExecutable="false"'
    )
    found = read_bpmn(xml)
    assert [each.name for each in found.definitions] == ["p0"]
    assert len(found.warnings) == 2


def test_the_only_process_need_not_say_that_it_is_executable() -> None:
    assert read_bpmn(file(between('<bpmn:task id="x"/>'), attributes="")).definitions[0].name == "p"


@pytest.mark.parametrize(
    "xml",
    [
        file(between('<bpmn:task id="x"/>'), attributes='isExecutable="false"'),
        pools(throw(0), catch(1), attributes=""),
        f"<bpmn:definitions {NAMESPACES}/>".encode(),
    ],
)
def test_a_file_without_executable_process_is_refused_with_the_way_out(xml: bytes) -> None:
    with pytest.raises(BadBpmn, match='set isExecutable="true" at the one to run'):
        read_bpmn(xml)


def test_an_id_is_used_once_in_a_file() -> None:
    with pytest.raises(BadBpmn, match='the id "s0" is used twice'):
        read_bpmn(pools(throw(0), throw(1).replace("s1", "s0")))


def test_a_definition_has_the_warnings_of_its_process_and_of_the_file() -> None:
    first = throw(0) + '<bpmn:dataStoreReference id="a"/>'
    second = catch(1) + '<bpmn:dataStoreReference id="b"/>'
    found = read_bpmn(pools(first, second, flows=FLOW, beside='<bpmn:category id="r"/>'))
    assert [[each.element for each in definition.warnings] for definition in found.definitions] == [
        ["r", "a"],
        ["r", "b"],
    ]
    assert {each.element for each in found.warnings} == {"r", "a", "b"}


def test_of_very_many_faults_the_answer_lists_the_first() -> None:
    with pytest.raises(BadBpmn) as bad:
        read_bpmn(
            file(
                '<bpmn:complexGateway id="c"/>'
                + "".join(f'<bpmn:transaction id="t{nth}"/>' for nth in range(500))
            )
        )
    assert len(bad.value.faults) == 501
    body_ = bad.value.body()
    assert len(body_["faults"]) == MAX_FAULTS_LISTED
    assert body_["warnings"] == []


def test_the_answer_names_the_element_as_it_is_drawn() -> None:
    with pytest.raises(BadBpmn) as bad:
        read_bpmn(file('\n<bpmn:complexGateway id="c" name="Any two"/><bpmn:dataStoreReference id="d"/>'))
    answer = bad.value.body()
    assert {name: answer["faults"][0][name] for name in ("element", "name", "line")} == {
        "element": "c",
        "name": "Any two",
        "line": 2,
    }
    assert answer["faults"][0]["messageCode"] == "bpmn.not_supported"
    assert answer["warnings"][0]["element"] == "d"


def test_a_process_of_the_greatest_size_is_read() -> None:
    steps = [f"a{nth}" for nth in range(MAX_NODES - 2)]
    tasks = "".join(f'<bpmn:task id="{step}"/>' for step in steps)
    definition = read_bpmn(file(start() + tasks + end() + path("start", *steps, "end"))).definitions[0]
    assert len(definition.activities()) == MAX_NODES - 2


def test_a_file_with_too_many_processes_is_refused() -> None:
    def xml(count: int) -> bytes:
        listed = "".join(
            f'<bpmn:process id="p{n}" isExecutable="true"><bpmn:task id="x{n}"/></bpmn:process>'
            for n in range(count)
        )
        return f"<bpmn:definitions {NAMESPACES}>{listed}</bpmn:definitions>".encode()

    assert len(read_bpmn(xml(MAX_PROCESSES)).definitions) == MAX_PROCESSES
    with pytest.raises(BadBpmn, match="at most 100 executable processes, not 101; split it") as bad:
        read_bpmn(xml(MAX_PROCESSES + 1))
    assert [fault.element for fault in bad.value.faults] == ["p100"]
