"""The rules of sequence flows, gateways, events and scopes; each fault once, at its element."""

import pytest

from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.run import Run
from handover_bpmn.model import Kind
from handover_bpmn.notation.rules import MAX_FLOWS, MAX_NODES
from services.task_orchestrator.tests.unit.bpmn.notation.reading import (
    between,
    extended,
    faults,
    read,
    warnings,
)
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
from services.task_orchestrator.tests.unit.process_driver import OneDefinition

WORK = activity("work")
ERROR = "<bpmn:errorEventDefinition/>"


def sub(name: str, body: str, attributes: str = "") -> str:
    return f'<bpmn:subProcess id="{name}" {attributes}>{body}</bpmn:subProcess>'


def catch(name: str, event: str) -> str:
    return f'<bpmn:intermediateCatchEvent id="{name}">{event}</bpmn:intermediateCatchEvent>'


def throw(name: str, event: str) -> str:
    return f'<bpmn:intermediateThrowEvent id="{name}">{event}</bpmn:intermediateThrowEvent>'


def link(name: str) -> str:
    return f'<bpmn:linkEventDefinition name="{name}"/>'


WRONG = {
    "nothing to start with": (
        activity("a") + activity("b") + path("a", "b", "a"),
        '"p": it has no start event and no other node where it could start',
    ),
    "two start events": (
        start() + start("again") + WORK + end() + path("start", "work", "end") + flow("again", "work"),
        '"again": a process or subprocess has one start event without event definition',
    ),
    "dangling flow": (ONE_STEP + flow("work", "nowhere"), 'targetRef "nowhere" is no node'),
    "flow across a border": (
        start() + sub("s", start("in") + WORK + path("in", "work")) + path("start", "s") + flow("s", "work"),
        '"s_work": the sequence flow crosses the border of a subprocess: targetRef "work" is in another',
    ),
    "flow to a start event": (ONE_STEP + flow("work", "start"), "no sequence flow may lead to a startEvent"),
    "flow from an end event": (ONE_STEP + flow("end", "work"), "no sequence flow may leave an endEvent"),
    "gateway without a way out": (
        start() + gateway("g") + path("start", "g"),
        "no sequence flow leaves",
    ),
    "no condition": (
        start() + gateway("g") + end() + end("other") + path("start", "g", "end") + flow("g", "other", "x"),
        'its flow "g_end" to "end" has no condition',
    ),
    "wrong default": (
        start() + gateway("g", default="start_g") + end() + path("start", "g", "end"),
        'its default flow "start_g" does not leave it',
    ),
    "bad condition": (
        start()
        + gateway("g", default="g_end")
        + end()
        + end("o")
        + path("start", "g", "end")
        + flow("g", "o", "import os"),
        '"g_o": `import os` is not an expression',
    ),
    "condition in a foreign language": (
        start()
        + gateway("g", default="g_end")
        + end()
        + path("start", "g", "end")
        + '<bpmn:sequenceFlow id="f" sourceRef="g" targetRef="end"><bpmn:conditionExpression '
        'language="python">x</bpmn:conditionExpression></bpmn:sequenceFlow>',
        '"f": a condition in python is not supported yet',
    ),
    "id twice": (ONE_STEP + activity("work"), 'the id "work" is used twice'),
    "bad id": (start("a b") + WORK + end() + path("a b", "work", "end"), "needs an id of letters"),
    "empty subprocess": (between(sub("x", "")), '"x": the subprocess is empty; draw its content'),
    "transaction": (between('<bpmn:transaction id="x"/>'), '"x": transaction is not supported yet; draw'),
    "ad-hoc": (between('<bpmn:adHocSubProcess id="x"/>'), '"x": adHocSubProcess is not supported yet; draw'),
    "complex gateway": (between('<bpmn:complexGateway id="x"/>'), '"x": complexGateway is not supported yet'),
    "unknown element": (between('<bpmn:teleport id="x"/>'), '"x": teleport is not supported yet'),
    "boundary on nothing": (
        ONE_STEP + boundary("late", "nothing", timer("PT1M")) + flow("late", "end"),
        'attachedToRef "nothing" names no task',
    ),
    "error that does not interrupt": (
        ONE_STEP + boundary("oops", "work", ERROR, interrupting=False) + flow("oops", "end"),
        "an error boundary event interrupts",
    ),
    "same error twice": (
        ONE_STEP
        + boundary("oops", "work", ERROR)
        + boundary("again", "work", ERROR)
        + flow("oops", "end")
        + flow("again", "end"),
        '"again": "oops" catches the same error',
    ),
    "parallel gateway that waits for itself": (
        start()
        + gateway("g", "parallel")
        + WORK
        + end()
        + path("start", "g", "work", "g")
        + flow("g", "end"),
        'its flow "work_g" comes only after the gateway itself',
    ),
    "event gateway before a task": (
        start() + gateway("g", "eventBased") + WORK + path("start", "g", "work"),
        '"g": its flow leads to "work"; behind an eventBasedGateway stand catching',
    ),
    "link to nowhere": (
        start() + throw("x", link("A")) + path("start", "x"),
        '"x": no catching link event is called "A" in this scope',
    ),
    "two link targets": (
        start()
        + throw("x", link("A"))
        + path("start", "x")
        + catch("a", link("A"))
        + catch("b", link("A"))
        + end()
        + path("a", "end")
        + path("b", "end"),
        '"b": another catching link event is called "A" already',
    ),
    "event subprocess without start": (
        ONE_STEP + sub("s", WORK.replace("work", "w"), 'triggeredByEvent="true"'),
        '"s": an event subprocess has one start event, this one has 0',
    ),
    "event subprocess that waits for nothing": (
        ONE_STEP + sub("s", start("s1"), 'triggeredByEvent="true"'),
        '"s1": a startEvent with no event definition is not supported',
    ),
    "event subprocess with flows": (
        start()
        + sub(
            "x",
            f'<bpmn:startEvent id="s">{timer("PT1M")}</bpmn:startEvent>',
            'triggeredByEvent="true"',
        )
        + end()
        + path("start", "x", "end"),
        '"x": no sequence flow may lead to or leave an event subprocess',
    ),
    "triggered start in a subprocess": (
        between(sub("x", f'<bpmn:startEvent id="s">{timer("PT1M")}</bpmn:startEvent>')),
        '"s": the start event of a subprocess has no event definition',
    ),
    "compensation without handler": (
        ONE_STEP + boundary("undo", "work", "<bpmn:compensateEventDefinition/>"),
        '"undo": the compensation boundary event has no handler',
    ),
    "compensation of nothing": (
        between(throw("x", '<bpmn:compensateEventDefinition activityRef="none"/>')),
        '"x": activityRef "none" names no activity',
    ),
    "too many nodes": (
        start() + "".join(activity(f"a{n}") for n in range(MAX_NODES)) + path("start", "a0"),
        f'"p": a process has at most {MAX_NODES} nodes',
    ),
    "too many flows": (
        start()
        + end()
        + "".join(
            f'<bpmn:sequenceFlow id="f{nth}" sourceRef="start" targetRef="end"/>'
            for nth in range(MAX_FLOWS + 1)
        ),
        f'"p": a process has at most {MAX_FLOWS} sequence flows',
    ),
}


@pytest.mark.parametrize("wrong", WRONG, ids=str)
def test_a_wrong_model_has_one_fault_with_element_line_and_rule(wrong: str) -> None:
    body, reason = WRONG[wrong]
    found = faults(body)
    assert len(found) == 1, found
    assert reason in found[0]
    assert found[0].startswith("line 1, ")


NOTICED = {
    "node without a way in": (ONE_STEP + activity("lonely") + flow("lonely", "end"), '"lonely": no sequence'),
    "unreachable ring": (ONE_STEP + activity("a") + activity("b") + path("a", "b", "a"), '"a": it cannot be'),
    "path without an end event": (
        start() + gateway("g", "parallel") + WORK + end() + path("start", "g", "work") + flow("g", "end"),
        '"work": no sequence flow leaves it',
    ),
    "condition behind a parallel gateway": (
        start() + gateway("g", "parallel") + end() + flow("start", "g") + flow("g", "end", "x > 1"),
        '"g_end": the condition has no effect behind the parallelGateway',
    ),
    "condition of a default flow": (
        start()
        + gateway("g", default="g_end")
        + end()
        + end("o")
        + flow("start", "g")
        + flow("g", "end", "x")
        + flow("g", "o", "y"),
        '"g_end": the condition has no effect, since this is the default flow',
    ),
}


@pytest.mark.parametrize("case", NOTICED, ids=str)
def test_an_odd_model_is_read_with_a_warning(case: str) -> None:
    body, reason = NOTICED[case]
    found = warnings(body)
    assert any(reason in each for each in found), found


RUNS = {
    "implicit split": ONE_STEP + end("other") + flow("work", "other"),
    "implicit split with conditions": start()
    + WORK
    + end()
    + flow("start", "work")
    + flow("work", "end", "x"),
    "no events at all": activity("a") + activity("b") + path("a", "b"),
    "no end event": start() + WORK + path("start", "work"),
    "subprocess without events": between(sub("x", activity("a") + activity("b") + path("a", "b"))),
    "loop through a parallel gateway": (
        start()
        + gateway("merge")
        + gateway("split", "parallel")
        + activity("a")
        + activity("b")
        + gateway("join", "parallel")
        + gateway("again", default="again_end")
        + end()
        + path("start", "merge", "split", "a", "join", "again", "end")
        + path("split", "b", "join")
        + flow("again", "merge", "x")
    ),
    "links": start()
    + throw("x", link("A"))
    + path("start", "x")
    + catch("a", link("A"))
    + path("a", "end")
    + end(),
    "compensation": (
        ONE_STEP
        + boundary("undo", "work", "<bpmn:compensateEventDefinition/>")
        + '<bpmn:task id="take_back" isForCompensation="true"/>'
        + '<bpmn:association id="as" sourceRef="undo" targetRef="take_back"/>'
    ),
    "flow without id": start() + WORK + '<bpmn:sequenceFlow sourceRef="start" targetRef="work"/>',
}


@pytest.mark.parametrize("case", RUNS, ids=str)
def test_a_legal_model_is_read_without_warnings(case: str) -> None:
    assert warnings(RUNS[case]) == []


def test_the_handler_of_a_compensation_is_found_by_its_association() -> None:
    scope = read(RUNS["compensation"]).scope
    assert scope.handlers == {"undo": "take_back"}
    assert scope.nodes["take_back"].is_for_compensation


@pytest.mark.parametrize("place", ["subprocess", "outer subprocess", "process", "collaboration"])
def test_the_association_of_a_compensation_may_stand_in_any_container_around(place: str) -> None:
    association = '<bpmn:association id="as" sourceRef="undo" targetRef="take_back"/>'
    inner = (
        start("in")
        + WORK
        + path("in", "work")
        + boundary("undo", "work", "<bpmn:compensateEventDefinition/>")
        + '<bpmn:task id="take_back" isForCompensation="true"/>'
    )
    deep = sub("deep", inner + (association if place == "subprocess" else ""))
    outer = start("out") + deep + path("out", "deep")
    body = between(sub("x", outer + (association if place == "outer subprocess" else "")))
    pool = f'<bpmn:participant id="pool" processRef="p"/>{association}'
    beside = f'<bpmn:collaboration id="c">{pool}</bpmn:collaboration>' if place == "collaboration" else ""
    scope = read(body + (association if place == "process" else ""), beside=beside).scope
    handlers = {name: each for inner in scope.walk() for name, each in inner.handlers.items()}
    assert handlers == {"undo": "take_back"}


@pytest.mark.parametrize("kind", ["parallel", "inclusive", "exclusive"])
def test_a_join_without_outgoing_flow_is_an_end(kind: str) -> None:
    split = start() + gateway("split", "parallel") + activity("a") + activity("b") + gateway("join", kind)
    body = split + path("start", "split", "a", "join") + path("split", "b", "join")
    assert warnings(body) == []
    beside_an_end = warnings(body + end() + path("a", "end"))
    assert any('"join": no sequence flow leaves it' in each for each in beside_an_end)
    plan = Plan(read(body))
    run = Run.start(plan, {}, NOW, OneDefinition(plan))
    for token in list(run.open_visits()):
        assert not run.completed
        run.complete(token, {}, NOW)
    assert run.completed


def test_one_fault_has_no_follow_ups() -> None:
    body = start() + '<bpmn:complexGateway id="c" name="Any of them"/>' + WORK + activity("b") + end()
    body += path("start", "c", "work", "end") + flow("c", "b", "a +") + path("b", "end")
    found = faults(body)
    assert [each.partition(": ")[0] for each in found] == [
        'line 1, "c" ("Any of them")',
        'line 1, "c_b"',
    ]


def test_all_faults_are_reported_at_once_with_name_and_line() -> None:
    body = (
        "\n" + start() + "\n" + '<bpmn:userTask id="a" name="Pick&#10; the part"><bpmn:extensionElements>'
        '<handover:task definition="a b"/></bpmn:extensionElements></bpmn:userTask>'
        "\n<bpmn:transaction id='c'/>\n" + path("start", "a", "c") + '\n<bpmn:teleport id="t"/>'
    )
    found = faults(body)
    assert len(found) == 3
    assert found[0].startswith('line 3, "a" ("Pick the part"): definition="a b" is not a name')
    assert found[1].startswith('line 4, "c": transaction is not supported')
    assert found[2].startswith('line 6, "t": teleport')


def test_faults_within_subprocesses_are_found_too() -> None:
    inner = sub("deep", start("s") + '<bpmn:complexGateway id="c"/>' + path("s", "c"))
    found = faults(between(sub("x", start("s0") + inner + path("s0", "deep"))))
    assert [each.partition(": ")[0] for each in found] == ['line 1, "c"']


def test_subprocesses_are_nested_only_so_deep() -> None:
    body = ""
    for nth in range(25):
        body = sub(f"s{nth}", body)
    assert any("nested at most 20 deep" in each for each in faults(body))


def test_the_content_of_a_subprocess_is_a_scope_of_its_own() -> None:
    definition = read(between(sub("x", start("in") + WORK + path("in", "work"))))
    inner = definition.scope.nodes["x"].scope
    assert inner is not None
    assert (inner.id, set(inner.nodes)) == ("x", {"in", "work"})
    assert definition.scope.nodes["x"].kind is Kind.SUB_PROCESS
    assert "work" in definition.activities()


def test_a_name_of_an_extension_does_not_hide_the_element() -> None:
    element = extended("task", '<handover:task definition="a b"/>', attributes='name="Pick"')
    assert faults(between(element))[0].startswith('line 1, "x" ("Pick")')
