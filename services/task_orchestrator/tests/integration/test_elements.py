"""Every element of BPMN that is executed: deployed over REST, and done by a performer to its end."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import orjson
import pytest

from services.task_orchestrator.tests.integration.cell import Cell, cell, eventually
from services.task_orchestrator.tests.unit.drawing import (
    activity,
    boundary,
    drawing,
    end,
    flow,
    gateway,
    path,
    start,
    timer,
)
from tests.kit.ports import next_free_port

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("bpmn-elements")]


@dataclass(frozen=True)
class Case:
    """A process: its content, what its performer answers, and the Tasks that are done."""

    body: str
    done: list[str]
    """`element-visit` of the Tasks that are completed, sorted."""
    beside: str = ""
    script: dict[str, Any] = field(default_factory=dict)
    variables: dict[str, Any] = field(default_factory=dict)
    send: tuple[str, dict[str, Any]] | None = None
    """A message or signal to send once the process waits: path and body."""
    result: dict[str, Any] = field(default_factory=dict)
    """Variables at the end."""
    status: str = "completed"


def task(name: str, *inner: str, kind: str = "userTask", attributes: str = "") -> str:
    """Return an activity with further elements, such as loop characteristics."""
    plain = activity(name, kind=kind)
    return plain.replace(f'<bpmn:{kind} id="{name}"', f'<bpmn:{kind} id="{name}" {attributes}').replace(
        f"</bpmn:{kind}>", "".join(inner) + f"</bpmn:{kind}>"
    )


def event(kind: str, name: str, definition: str = "", attributes: str = "") -> str:
    return f'<bpmn:{kind} id="{name}" {attributes}>{definition}</bpmn:{kind}>'


def catch(name: str, definition: str) -> str:
    return event("intermediateCatchEvent", name, definition)


def throw(name: str, definition: str = "") -> str:
    return event("intermediateThrowEvent", name, definition)


def sub(name: str, body: str, attributes: str = "", inner: str = "") -> str:
    return f'<bpmn:subProcess id="{name}" {attributes}>{inner}{body}</bpmn:subProcess>'


def event_sub(name: str, definition: str, body: str, *, interrupting: bool = True) -> str:
    first = event("startEvent", f"{name}_start", definition, f'isInterrupting="{str(interrupting).lower()}"')
    return sub(name, first + body, 'triggeredByEvent="true"')


def script(name: str, text: str) -> str:
    return f'<bpmn:scriptTask id="{name}"><bpmn:script>{text}</bpmn:script></bpmn:scriptTask>'


def refer(kind: str, reference: str) -> str:
    return f'<bpmn:{kind}EventDefinition {kind}Ref="{reference}"/>'


def chain(*parts: str) -> str:
    """Return the flows from `start` through `parts` to `end`."""
    return path("start", *parts, "end")


FRAME = start() + end()
ERROR = '<bpmn:error id="jam" name="jam" errorCode="JAM"/>'
ESCALATION = '<bpmn:escalation id="late" name="late" escalationCode="LATE"/>'
GO = '<bpmn:message id="go" name="go-{name}"/>'
SIREN = '<bpmn:signal id="siren" name="siren-{name}"/>'
COMPENSATE = "<bpmn:compensateEventDefinition/>"
LINK = '<bpmn:linkEventDefinition name="over"/>'
TERMINATE = "<bpmn:terminateEventDefinition/>"
CONDITION = (
    "<bpmn:conditionalEventDefinition><bpmn:condition>{}</bpmn:condition></bpmn:conditionalEventDefinition>"
)
FOR_EACH = (
    '<bpmn:multiInstanceLoopCharacteristics isSequential="{}">'
    "<bpmn:loopCardinality>3</bpmn:loopCardinality></bpmn:multiInstanceLoopCharacteristics>"
)


def undo(name: str) -> str:
    handler = activity(f"undo_{name}").replace("<bpmn:userTask ", '<bpmn:userTask isForCompensation="true" ')
    undone = event("boundaryEvent", f"undone_{name}", COMPENSATE, f'attachedToRef="{name}"')
    ends = f'sourceRef="undone_{name}" targetRef="undo_{name}"'
    return f'{handler}{undone}<bpmn:association id="to_undo_{name}" {ends} associationDirection="One"/>'


CASES: dict[str, Case] = {
    "unicode-ids": Case(
        FRAME + activity("check").replace('userTask id="check"', 'userTask id="Prüfen"') + chain("Prüfen"),
        ["prufen-a1ca1357598782f7-1"],
    ),
    **{
        kind: Case(FRAME + activity("work", kind=kind) + chain("work"), ["work-1"])
        for kind in ("task", "userTask", "manualTask", "serviceTask", "sendTask", "businessRuleTask")
    },
    "scriptTask": Case(
        FRAME + script("set", "n = n + 1") + chain("set"), [], variables={"n": 1}, result={"n": 2}
    ),
    "receiveTask": Case(
        FRAME + '<bpmn:receiveTask id="wait" messageRef="go"/>' + activity("then") + chain("wait", "then"),
        ["then-1"],
        GO,
        send=("/messages", {"name": "go-receiveTask", "variables": {"n": 3}}),
        result={"n": 3},
    ),
    "standardLoop": Case(
        FRAME + task("again", '<bpmn:standardLoopCharacteristics loopMaximum="3"/>') + chain("again"),
        ["again-1", "again-2", "again-3"],
    ),
    "sequentialInstances": Case(
        FRAME + task("each", FOR_EACH.format("true")) + chain("each"), ["each-1", "each-2", "each-3"]
    ),
    "parallelInstances": Case(
        FRAME + task("each", FOR_EACH.format("false")) + chain("each"), ["each-1", "each-2", "each-3"]
    ),
    "instancesOfSubProcess": Case(
        FRAME
        + sub(
            "each",
            FRAME.replace('"start"', '"s"').replace('"end"', '"e"')
            + activity("inner")
            + path("s", "inner", "e"),
            inner=FOR_EACH.format("false"),
        )
        + chain("each"),
        ["inner-1", "inner-2", "inner-3"],
    ),
    "exclusiveGateway": Case(
        FRAME
        + gateway("which", default="which_a")
        + activity("a")
        + activity("b")
        + path("start", "which", "a", "end")
        + flow("which", "b", "n == 2")
        + path("b", "end"),
        ["b-1"],
        variables={"n": 2},
    ),
    "parallelGateway": Case(
        FRAME
        + gateway("fork", "parallel")
        + activity("a")
        + activity("b")
        + gateway("join", "parallel")
        + activity("c")
        + path("start", "fork", "a", "join", "c", "end")
        + path("fork", "b", "join"),
        ["a-1", "b-1", "c-1"],
    ),
    "inclusiveGateway": Case(
        FRAME
        + gateway("some", "inclusive", default="some_d")
        + activity("a")
        + activity("b")
        + activity("d")
        + gateway("join", "inclusive")
        + activity("c")
        + path("start", "some")
        + flow("some", "a", "n &gt; 1")
        + flow("some", "b", "n &gt; 2")
        + path("some", "d", "join", "c", "end")
        + path("a", "join")
        + path("b", "join"),
        ["a-1", "b-1", "c-1"],
        variables={"n": 3},
    ),
    "eventBasedGateway": Case(
        FRAME
        + '<bpmn:eventBasedGateway id="first"/>'
        + catch("reported", refer("message", "go"))
        + catch("late", timer("PT1H"))
        + activity("a")
        + activity("b")
        + path("start", "first", "reported", "a", "end")
        + path("first", "late", "b", "end"),
        ["a-1"],
        GO,
        send=("/messages", {"name": "go-eventBasedGateway"}),
    ),
    "implicitSplitAndMerge": Case(
        FRAME
        + activity("a")
        + activity("b")
        + activity("c")
        + path("start", "a", "c", "end")
        + path("start", "b", "c"),
        ["a-1", "b-1", "c-1", "c-2"],
    ),
    "noneEvents": Case(FRAME + throw("passed") + activity("a") + chain("passed", "a"), ["a-1"]),
    "timerDuration": Case(
        FRAME + catch("wait", timer("PT0.2S")) + activity("a") + chain("wait", "a"), ["a-1"]
    ),
    "timerCycleAtBoundary": Case(
        FRAME
        + activity("slow")
        + activity("remind")
        + end("reminded")
        + boundary(
            "often",
            "slow",
            "<bpmn:timerEventDefinition><bpmn:timeCycle>R2/PT0.3S</bpmn:timeCycle>"
            "</bpmn:timerEventDefinition>",
            interrupting=False,
        )
        + chain("slow")
        + path("often", "remind", "reminded"),
        ["remind-1", "remind-2", "slow-1"],
        script={"slow-1": {"after_s": 3}},
    ),
    "interruptingTimerAtBoundary": Case(
        FRAME
        + activity("endless")
        + activity("other")
        + boundary("late", "endless", timer("PT0.5S"))
        + chain("endless")
        + path("late", "other", "end"),
        ["other-1"],
        script={"endless-1": {"after_s": 600}},
    ),
    "messageCatch": Case(
        FRAME + catch("wait", refer("message", "go")) + activity("a") + chain("wait", "a"),
        ["a-1"],
        GO,
        send=("/messages", {"name": "go-messageCatch", "variables": {"n": 7}}),
        result={"n": 7},
    ),
    "messageThrowIsStoredUntilItIsAwaited": Case(
        FRAME
        + throw("say", refer("message", "go"))
        + catch("receive", refer("message", "go"))
        + activity("a")
        + chain("say", "receive", "a"),
        ["a-1"],
        GO,
    ),
    "messageAtBoundary": Case(
        FRAME
        + activity("busy")
        + activity("stopped")
        + boundary("stop", "busy", refer("message", "go"))
        + chain("busy")
        + path("stop", "stopped", "end"),
        ["stopped-1"],
        GO,
        script={"busy-1": {"after_s": 600}},
        send=("/messages", {"name": "go-messageAtBoundary"}),
    ),
    "signalCatch": Case(
        FRAME + catch("wait", refer("signal", "siren")) + activity("a") + chain("wait", "a"),
        ["a-1"],
        SIREN,
        send=("/signals", {"name": "siren-signalCatch"}),
    ),
    "signalThrow": Case(
        FRAME
        + gateway("fork", "parallel")
        + catch("wait", refer("signal", "siren"))
        + activity("a")
        + activity("b")
        + throw("cry", refer("signal", "siren"))
        + path("start", "fork", "wait", "a", "end")
        + path("fork", "b", "cry", "end"),
        ["a-1", "b-1"],
        SIREN,
    ),
    "signalStartsEventSubProcess": Case(
        FRAME
        + activity("patient")
        + chain("patient")
        + event_sub(
            "alarm",
            refer("signal", "siren"),
            activity("help") + end("helped") + path("alarm_start", "help", "helped"),
            interrupting=False,
        ),
        ["help-1", "patient-1"],
        SIREN,
        script={"patient-1": {"after_s": 8}},
        send=("/signals", {"name": "siren-signalStartsEventSubProcess"}),
    ),
    "errorAtBoundary": Case(
        FRAME
        + activity("jams")
        + activity("clear")
        + boundary("caught", "jams", refer("error", "jam"))
        + chain("jams")
        + path("caught", "clear", "end"),
        ["clear-1", "jams-1"],
        ERROR,
        script={"jams-1": {"fails": "it jams", "errorCode": "JAM"}},
    ),
    "errorEndOfSubProcess": Case(
        FRAME
        + sub("inside", start("s") + activity("a") + end("e", refer("error", "jam")) + path("s", "a", "e"))
        + activity("clear")
        + boundary("caught", "inside", refer("error", "jam"))
        + chain("inside")
        + path("caught", "clear", "end"),
        ["a-1", "clear-1"],
        ERROR,
    ),
    "errorStartsEventSubProcess": Case(
        FRAME
        + activity("breaks")
        + chain("breaks")
        + event_sub(
            "rescue",
            refer("error", "jam"),
            activity("help") + end("helped") + path("rescue_start", "help", "helped"),
        ),
        ["breaks-1", "help-1"],
        ERROR,
        script={"breaks-1": {"fails": "broken", "errorCode": "JAM"}},
    ),
    "errorEnd": Case(
        FRAME + activity("a") + end("bad", refer("error", "jam")) + path("start", "a", "bad"),
        ["a-1"],
        ERROR,
        status="failed",
    ),
    "escalationAtBoundary": Case(
        FRAME
        + sub(
            "inside",
            start("s")
            + throw("call", refer("escalation", "late"))
            + activity("a")
            + end("e")
            + path("s", "call", "a", "e"),
        )
        + activity("look")
        + end("looked")
        + boundary("caught", "inside", refer("escalation", "late"), interrupting=False)
        + chain("inside")
        + path("caught", "look", "looked"),
        ["a-1", "look-1"],
        ESCALATION,
    ),
    "conditionalCatch": Case(
        FRAME
        + gateway("fork", "parallel")
        + catch("until", CONDITION.format("defined(ready) and ready == 1"))
        + activity("a")
        + activity("b")
        + script("set", "ready = 1")
        + path("start", "fork", "until", "a", "end")
        + path("fork", "b", "set", "end"),
        ["a-1", "b-1"],
    ),
    "compensation": Case(
        FRAME
        + activity("book")
        + undo("book")
        + activity("pay")
        + undo("pay")
        + throw("back", COMPENSATE)
        + chain("book", "pay", "back"),
        ["book-1", "pay-1", "undo_book-1", "undo_pay-1"],
    ),
    "link": Case(
        FRAME
        + throw("away", LINK)
        + catch("here", LINK)
        + activity("a")
        + path("start", "away")
        + path("here", "a", "end"),
        ["a-1"],
    ),
    "terminate": Case(
        FRAME
        + gateway("fork", "parallel")
        + activity("forever")
        + activity("b").replace("glove-1", "ur10-1")
        + end("stop", TERMINATE)
        + path("start", "fork", "forever", "end")
        + path("fork", "b", "stop"),
        ["b-1"],
        script={"forever-1": {"after_s": 600}},
    ),
    "subProcess": Case(
        FRAME
        + sub("inside", start("s") + activity("a") + end("e") + path("s", "a", "e"))
        + activity("b")
        + chain("inside", "b"),
        ["a-1", "b-1"],
    ),
    "callActivity": Case(
        FRAME + '<bpmn:callActivity id="call" calledElement="task"/>' + activity("b") + chain("call", "b"),
        ["b-1", "call.work-1"],
    ),
}


@pytest.fixture(scope="module")
def deployed(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Cell]:
    """A cell in which every case is deployed."""
    with cell(tmp_path_factory.mktemp("elements"), next_free_port) as running:
        answers: dict[str, Any] = {}
        for case in CASES.values():
            answers |= case.script
        running.script_file.write_bytes(orjson.dumps(answers))
        for name, case in CASES.items():
            xml = drawing(case.body, beside=case.beside.format(name=name), name=name)
            answer = running.api.post(
                "/definitions", content=xml, headers={"Content-Type": "application/xml"}
            )
            assert answer.status_code == 201, (name, answer.text)
        yield running


@pytest.mark.nightly
@pytest.mark.parametrize("name", CASES)
def test_an_element_is_executed(deployed: Cell, name: str) -> None:
    running, case = deployed, CASES[name]
    process = running.start(name, **case.variables)
    if case.send is not None:
        eventually(lambda: running.look(process)["waiting"], f"{name} waiting")
        answer = running.api.post(case.send[0], json=case.send[1])
        assert answer.status_code == 200, answer.text
    seen = running.ended(process)
    assert seen["incidents"] == []
    assert seen["status"] == case.status
    prefix = f"urn:ngsi-ld:Task:demo:{process}-"
    assert (
        sorted(each.removeprefix(prefix) for each in running.done() if each.startswith(prefix)) == case.done
    )
    assert case.result.items() <= seen["variables"].items()


def test_two_pools_of_a_file_exchange_messages(deployed: Cell) -> None:
    running = deployed
    pools = (
        '<bpmn:collaboration id="both"><bpmn:participant id="a" processRef="customer"/>'
        '<bpmn:participant id="b" processRef="shop"/>'
        '<bpmn:messageFlow id="order" sourceRef="ask" targetRef="asked"/>'
        '<bpmn:messageFlow id="goods" sourceRef="give" targetRef="got"/></bpmn:collaboration>'
    )
    message = "<bpmn:messageEventDefinition/>"
    customer = start() + throw("ask", message) + catch("got", message) + end() + chain("ask", "got")
    shop = (
        event("startEvent", "asked", message)
        + activity("pack")
        + throw("give", message)
        + end("e")
        + path("asked", "pack", "give", "e")
    )
    other = f'<bpmn:process id="shop" isExecutable="true">{shop}</bpmn:process>'
    xml = drawing(customer, beside=pools + other, name="customer")
    answer = running.api.post("/definitions", content=xml, headers={"Content-Type": "application/xml"})
    assert [each["name"] for each in answer.json()["definitions"]] == ["shop", "customer"]
    customers = [running.start("customer") for _ in range(3)]
    for process in customers:
        assert running.ended(process)["status"] == "completed"
    shops = running.api.get("/processes", params={"definition": "shop"}).json()
    assert [each["status"] for each in shops] == ["completed"] * 3


@pytest.mark.parametrize(
    ("name", "definition", "beside"),
    [
        (
            "startedByTimer",
            "<bpmn:timerEventDefinition><bpmn:timeCycle>R2/PT0.2S</bpmn:timeCycle></bpmn:timerEventDefinition>",
            "",
        ),
        ("startedByMessage", refer("message", "go"), GO),
        ("startedBySignal", refer("signal", "siren"), SIREN),
    ],
)
def test_an_event_starts_a_process(deployed: Cell, name: str, definition: str, beside: str) -> None:
    running = deployed
    body = event("startEvent", "s", definition) + activity("work") + end() + path("s", "work", "end")
    xml = drawing(body, beside=beside.format(name=name), name=name)
    answer = running.api.post("/definitions", content=xml, headers={"Content-Type": "application/xml"})
    assert answer.status_code == 201, answer.text
    assert running.api.post("/processes", json={"definition": name}).status_code == 422
    if "Message" in name:
        sent = running.api.post("/messages", json={"name": f"go-{name}", "variables": {"n": 3}}).json()
        assert sent["outcome"] == "started"
        assert running.ended(sent["process"])["variables"]["n"] == 3
    elif "Signal" in name:
        (process,) = running.api.post("/signals", json={"name": f"siren-{name}"}).json()["processes"]
        assert running.ended(process)["status"] == "completed"
    else:

        def both() -> bool:
            rows = running.api.get("/processes", params={"definition": name, "status": "completed"}).json()
            return len(rows) == 2

        eventually(both, "two processes started by the timer")


def test_a_message_needs_the_right_key_and_one_receiver(deployed: Cell) -> None:
    running = deployed
    wait = catch("wait", refer("message", "go"))
    xml = drawing(FRAME + wait + chain("wait"), beside=GO.format(name="keyed"), name="keyed")
    running.api.post(
        "/definitions", content=xml, headers={"Content-Type": "application/xml"}
    ).raise_for_status()
    first, second = (
        running.api.post("/processes", json={"definition": "keyed", "key": f"order {n}"}).json()["id"]
        for n in (1, 2)
    )
    ambiguous = running.api.post("/messages", json={"name": "go-keyed"})
    assert (ambiguous.status_code, "2 processes wait" in ambiguous.json()["detail"]) == (409, True)
    nobody = running.api.post("/messages", json={"name": "go-keyed", "key": "order 3", "ttl": "PT0S"}).json()
    assert nobody == {"outcome": "discarded", "process": None}
    keyed = running.api.post("/messages", json={"name": "go-keyed", "key": "order 2"}).json()
    assert keyed == {"outcome": "delivered", "process": second}
    rest = running.api.post("/messages", json={"name": "go-keyed", "process": first}).json()
    assert rest["outcome"] == "delivered"
    assert running.ended(first)["status"] == running.ended(second)["status"] == "completed"
    ended = running.api.post("/messages", json={"name": "go-keyed", "process": first})
    unknown = running.api.post("/messages", json={"name": "go-keyed", "process": "keyed-none"})
    assert [ended.status_code, unknown.status_code] == [409, 404]


@pytest.mark.nightly
def test_a_stored_message_survives_a_kill_and_reaches_only_the_process_it_names(deployed: Cell) -> None:
    running = deployed
    wait = catch("wait", refer("message", "go"))
    xml = drawing(FRAME + wait + chain("wait"), beside=GO.format(name="stored"), name="stored")
    running.api.post(
        "/definitions", content=xml, headers={"Content-Type": "application/xml"}
    ).raise_for_status()
    sent = running.api.post("/messages", json={"name": "go-stored", "variables": {"n": 5}}).json()
    assert sent == {"outcome": "stored", "process": None}
    names = '<bpmn:message id="go" name="go-early"/><bpmn:message id="late" name="go-late"/>'
    waits = catch("early", refer("message", "go")) + catch("wait", refer("message", "late"))
    both = drawing(FRAME + waits + chain("early", "wait"), beside=names, name="addressed")
    starter = event("startEvent", "start", refer("message", "late")) + end() + flow("start", "end")
    for file in (both, drawing(starter, beside=names, name="started-by-late")):
        running.api.post(
            "/definitions", content=file, headers={"Content-Type": "application/xml"}
        ).raise_for_status()
    addressee, other = running.start("addressed"), running.start("addressed")
    early = {"name": "go-early", "process": other}
    assert running.api.post("/messages", json=early).json() == {"outcome": "delivered", "process": other}
    late = {"name": "go-late", "process": addressee, "variables": {"n": 7}}
    assert running.api.post("/messages", json=late).json() == {"outcome": "stored", "process": None}
    running.orchestrator.kill()
    running.orchestrator.start()
    process = running.start("stored")
    assert running.ended(process)["variables"] == {"n": 5}
    assert running.api.post("/messages", json={**early, "process": addressee}).status_code == 200
    assert running.ended(addressee)["variables"] == {"n": 7}
    assert running.look(other)["waiting"] == ["wait"]
    assert not running.api.get("/processes", params={"definition": "started-by-late"}).json()
