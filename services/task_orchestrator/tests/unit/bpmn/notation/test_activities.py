"""Activities: every kind of task, loops, subprocesses, calls and data."""

import pytest

from handover_bpmn.model import (
    DataAssociation,
    Kind,
    MessageEvent,
    MultiInstance,
    StandardLoop,
)
from services.task_orchestrator.tests.unit.bpmn.notation.reading import between, faults, node, read, warnings
from services.task_orchestrator.tests.unit.drawing import activity, path, start

MESSAGE = '<bpmn:message id="m" name="order"/>'


@pytest.mark.parametrize(
    "kind", ["task", "userTask", "manualTask", "serviceTask", "businessRuleTask", "sendTask"]
)
def test_a_task_of_each_kind_is_work_for_a_performer(kind: str) -> None:
    found = node(f'<bpmn:{kind} id="x" name="Do it"/>')
    assert found.kind is Kind(kind)
    assert found.activity is not None
    assert (found.activity.definition, found.activity.involves) == ("x", ())


def test_a_receive_task_waits_and_a_send_task_throws() -> None:
    for kind in ("receiveTask", "sendTask"):
        found = node(f'<bpmn:{kind} id="x" messageRef="m"/>', beside=MESSAGE)
        assert found.activity is None
        assert isinstance(found.event, MessageEvent)
        assert found.event.name.value({}) == "order"


def test_a_send_task_with_a_task_of_ours_is_work() -> None:
    element = activity("x", kind="sendTask").replace("<bpmn:sendTask", '<bpmn:sendTask messageRef="m"')
    found = node(element, beside=MESSAGE)
    assert found.activity is not None
    assert found.event is None


def test_a_receive_task_that_starts_the_process_is_refused_by_name() -> None:
    found = faults(between('<bpmn:receiveTask id="x" instantiate="true"/>'))
    assert "a receiveTask that starts the process is not supported yet" in found[0]


def test_a_script_in_a_foreign_language_becomes_a_task_with_its_text() -> None:
    element = (
        '<bpmn:scriptTask id="x" scriptFormat="groovy"><bpmn:script>println 1</bpmn:script></bpmn:scriptTask>'
    )
    found = node(element)
    assert found.script is None
    assert found.activity is not None
    parameters = {name: value.literal for name, value in found.activity.parameters.items()}
    assert parameters == {"script": "println 1", "scriptFormat": "groovy"}
    assert "a groovy script is not run here: it becomes a Task" in warnings(between(element))[0]


def test_a_call_activity_names_a_process_and_passes_all_variables() -> None:
    call = node('<bpmn:callActivity id="x" calledElement="other"/>').call
    assert call is not None
    assert call.process.value({}) == "other"
    assert call.all_inputs
    assert call.all_outputs
    assert "the call activity names no process" in faults(between('<bpmn:callActivity id="x"/>'))[0]


def test_a_call_activity_may_call_a_global_task() -> None:
    beside = '<bpmn:globalUserTask id="check" name="Check"/>'
    found = node('<bpmn:callActivity id="x" calledElement="check"/>', beside=beside)
    assert found.call is None
    assert found.activity is not None
    assert warnings(between('<bpmn:callActivity id="x" calledElement="check"/>'), beside=beside) == []


def looped(loop: str) -> str:
    return f'<bpmn:task id="x">{loop}</bpmn:task>'


def test_a_standard_loop_has_a_condition_and_a_maximum() -> None:
    loop = node(
        looped(
            '<bpmn:standardLoopCharacteristics testBefore="true" loopMaximum="5">'
            "<bpmn:loopCondition>n &lt; 3</bpmn:loopCondition></bpmn:standardLoopCharacteristics>"
        )
    ).loop
    assert isinstance(loop, StandardLoop)
    assert (loop.test_before, loop.maximum) == (True, 5)
    assert loop.condition is not None
    assert loop.condition.value({"n": 2}) is True


def multiple(inner: str, attributes: str = "") -> str:
    return looped(
        f"<bpmn:multiInstanceLoopCharacteristics {attributes}>{inner}</bpmn:multiInstanceLoopCharacteristics>"
    )


def test_a_multi_instance_activity_has_a_cardinality() -> None:
    loop = node(
        multiple(
            "<bpmn:loopCardinality>3</bpmn:loopCardinality>"
            "<bpmn:completionCondition>nrOfCompletedInstances > 1</bpmn:completionCondition>",
            'isSequential="true"',
        )
    ).loop
    assert isinstance(loop, MultiInstance)
    assert loop.sequential
    assert loop.cardinality is not None
    assert loop.cardinality.value({}) == 3
    assert loop.completion is not None
    assert loop.completion.value({"nrOfCompletedInstances": 2}) is True


def test_a_multi_instance_activity_runs_over_a_collection() -> None:
    loop = node(
        multiple(
            "<bpmn:loopDataInputRef>parts</bpmn:loopDataInputRef>"
            "<bpmn:loopDataOutputRef>results</bpmn:loopDataOutputRef>"
            '<bpmn:inputDataItem id="i" name="part"/><bpmn:outputDataItem id="o" name="result"/>'
        )
    ).loop
    assert isinstance(loop, MultiInstance)
    assert not loop.sequential
    assert loop.collection is not None
    assert loop.collection.value({"parts": [1]}) == [1]
    assert loop.item_variable == "part"
    assert loop.output_collection == "results"
    assert loop.output_item is not None
    assert loop.output_item.value({"result": 4}) == 4


@pytest.mark.parametrize(
    ("element", "reason"),
    [
        (looped("<bpmn:standardLoopCharacteristics/>"), "a loop needs a loopCondition or loopMaximum"),
        (looped('<bpmn:standardLoopCharacteristics loopMaximum="x"/>'), 'loopMaximum="x" is no number'),
        (multiple(""), "a multi-instance activity needs a loopCardinality"),
        (multiple("<bpmn:loopCardinality>1 +</bpmn:loopCardinality>"), "is not an expression"),
        (multiple("<bpmn:loopDataInputRef>a b</bpmn:loopDataInputRef>"), '"a b" cannot be the name'),
        ('<bpmn:task id="x" startQuantity="2"/>', 'startQuantity="2" is not supported yet'),
        ('<bpmn:task id="x"><bpmn:teleport/></bpmn:task>', "teleport in a task is not supported yet"),
    ],
)
def test_a_wrong_activity_is_one_fault(element: str, reason: str) -> None:
    found = faults(between(element))
    assert len(found) == 1, found
    assert reason in found[0]


DATA = (
    '<bpmn:dataObject id="d" isCollection="true"/><bpmn:dataObjectReference id="r" dataObjectRef="d" '
    'name="Parts to pick"/><bpmn:dataStoreReference id="store" name="Archive"/>'
)


def test_data_objects_are_copied_to_and_from_activities() -> None:
    element = (
        '<bpmn:task id="x"><bpmn:ioSpecification><bpmn:dataInput id="in" name="parts"/>'
        '<bpmn:dataOutput id="out" name="picked"/></bpmn:ioSpecification>'
        "<bpmn:dataInputAssociation><bpmn:sourceRef>r</bpmn:sourceRef><bpmn:targetRef>in</bpmn:targetRef>"
        "</bpmn:dataInputAssociation><bpmn:dataOutputAssociation><bpmn:sourceRef>out</bpmn:sourceRef>"
        "<bpmn:targetRef>r</bpmn:targetRef></bpmn:dataOutputAssociation></bpmn:task>"
    )
    definition = read(DATA + between(element))
    assert definition.scope.data_objects == {"d": "Parts to pick"}
    found = definition.scope.nodes["x"]
    assert found.data_inputs == (DataAssociation("d", "parts"),)
    assert found.data_outputs == (DataAssociation("d", "picked"),)


def test_a_drawn_association_needs_no_specification() -> None:
    element = (
        "<bpmn:dataInputAssociation><bpmn:sourceRef>r</bpmn:sourceRef><bpmn:targetRef>p</bpmn:targetRef>"
        "</bpmn:dataInputAssociation><bpmn:dataOutputAssociation><bpmn:targetRef>r</bpmn:targetRef>"
        "</bpmn:dataOutputAssociation>"
    )
    sub = f'<bpmn:subProcess id="x">{start("s")}<bpmn:task id="t">{element}</bpmn:task>{path("s", "t")}'
    definition = read(DATA + between(sub + "</bpmn:subProcess>"))
    inner = definition.scope.nodes["x"].scope
    assert inner is not None
    assert inner.nodes["t"].data_inputs == (DataAssociation("d", "Parts to pick"),)
    assert inner.nodes["t"].data_outputs == (DataAssociation("d", None),)


def test_a_data_object_belongs_to_the_scope_that_declares_it() -> None:
    reference = '<bpmn:dataObjectReference id="inner" dataObjectRef="d"/><bpmn:dataObjectReference id="own"/>'
    sub = f'<bpmn:subProcess id="x">{reference}<bpmn:task id="t"/></bpmn:subProcess>'
    scope = read(DATA + between(sub)).scope
    inner = scope.nodes["x"].scope
    assert inner is not None
    assert set(scope.data_objects) == {"d"}
    assert set(inner.data_objects) == {"own"}


def test_a_data_store_has_no_effect() -> None:
    element = (
        '<bpmn:task id="x"><bpmn:dataOutputAssociation><bpmn:targetRef>store</bpmn:targetRef>'
        "</bpmn:dataOutputAssociation></bpmn:task>"
    )
    found = warnings(DATA + between(element))
    assert found == [
        'line 1, "store" ("Archive"): dataStoreReference has no effect on the execution',
        'line 1, "x": dataOutputAssociation has no effect on the execution',
    ]


def test_a_loop_over_a_data_object_reads_it_by_its_name() -> None:
    data = DATA.replace("Parts to pick", "parts")
    loop = (
        read(data + between(multiple("<bpmn:loopDataInputRef>r</bpmn:loopDataInputRef>")))
        .scope.nodes["x"]
        .loop
    )
    assert isinstance(loop, MultiInstance)
    assert loop.collection is not None
    assert loop.collection.value({"parts": [1, 2]}) == [1, 2]


@pytest.mark.parametrize(
    "beside",
    [
        '<bpmn:itemDefinition id="i"/>',
        '<bpmn:dataStore id="d"/>',
        '<bpmn:category id="c"/>',
        '<bpmn:interface id="f"/>',
        '<bpmn:correlationProperty id="k"/>',
        '<bpmn:choreography id="ch"/>',
        '<bpmn:globalScriptTask id="g"/>',
        '<other:vendor id="v"/>',
    ],
)
def test_what_has_no_effect_on_the_execution_is_a_warning(beside: str) -> None:
    found = warnings(between(activity("x")), beside=beside)
    assert len(found) == 1
    assert "no effect" in found[0]


def test_extensions_of_unknown_vendors_and_resource_roles_are_warnings() -> None:
    element = (
        '<bpmn:userTask id="x" name="Check"><bpmn:extensionElements><other:a/>\n<other:b/>'
        "</bpmn:extensionElements>"
        '<bpmn:potentialOwner id="o"/></bpmn:userTask>'
    )
    assert warnings(between(element)) == [
        'line 1, "x" ("Check"): extensions of "urn:other" are unknown here and have no effect',
        'line 2, "x" ("Check"): potentialOwner has no effect on the execution',
    ]


def _role(kind: str, expression: str) -> str:
    return (
        f"<bpmn:{kind}><bpmn:resourceAssignmentExpression><bpmn:formalExpression>{expression}"
        f"</bpmn:formalExpression></bpmn:resourceAssignmentExpression></bpmn:{kind}>"
    )


@pytest.mark.parametrize(
    ("roles", "hints"),
    [
        (_role("potentialOwner", "management"), {"candidateGroups": "management"}),
        (
            _role("potentialOwner", "user(ann), group(night, day), cell"),
            {"candidateUsers": "ann", "candidateGroups": "night,day,cell"},
        ),
        (_role("humanPerformer", "bob"), {"assignee": "bob"}),
        (_role("performer", "${who}"), {"assignee": "${who}"}),
        (
            "<bpmn:potentialOwner><bpmn:resourceRef>r1</bpmn:resourceRef></bpmn:potentialOwner>",
            {"candidateGroups": "Fitters"},
        ),
    ],
)
def test_resource_roles_are_hints_for_the_allocation(roles: str, hints: dict[str, str]) -> None:
    found = node(
        f'<bpmn:userTask id="x">{roles}</bpmn:userTask>', beside='<bpmn:resource id="r1" name="Fitters"/>'
    )
    assert found.activity is not None
    assert found.activity.hints == hints


def test_data_of_an_activity_comes_from_properties_and_goes_to_them() -> None:
    declared = '<bpmn:property id="p1" name="part"/><bpmn:property id="p2" name="is whole"/>'
    task = (
        '<bpmn:userTask id="x"><bpmn:ioSpecification><bpmn:dataInput id="i" name="item"/>'
        '<bpmn:dataInput id="j" name="speed"/><bpmn:dataOutput id="o" name="answer"/></bpmn:ioSpecification>'
        "<bpmn:dataInputAssociation><bpmn:sourceRef>p1</bpmn:sourceRef><bpmn:targetRef>i</bpmn:targetRef>"
        "</bpmn:dataInputAssociation><bpmn:dataInputAssociation><bpmn:targetRef>j</bpmn:targetRef>"
        "<bpmn:assignment><bpmn:from>slow</bpmn:from><bpmn:to>j</bpmn:to></bpmn:assignment>"
        "</bpmn:dataInputAssociation><bpmn:dataOutputAssociation><bpmn:sourceRef>o</bpmn:sourceRef>"
        "<bpmn:targetRef>p2</bpmn:targetRef></bpmn:dataOutputAssociation></bpmn:userTask>"
    )
    definition = read(declared + between(task))
    work = definition.scope.nodes["x"].activity
    assert work is not None
    given = {name: value.value({"part": "p-7"}) for name, value in work.parameters.items()}
    assert given == {"item": "p-7", "speed": "slow"}
    assert work.outputs == {"answer": "p2"}
    assert definition.warnings == ()


def test_drawings_need_no_warning() -> None:
    body = (
        "<bpmn:documentation>All of it</bpmn:documentation>"
        '<bpmn:textAnnotation id="t"><bpmn:text>Mind the robot</bpmn:text></bpmn:textAnnotation>'
        '<bpmn:group id="g"/><bpmn:association id="a" sourceRef="x" targetRef="t"/>'
    )
    assert warnings(body + between(activity("x"))) == []


def test_an_unknown_element_in_the_file_is_refused() -> None:
    assert (
        "teleport in a definitions is not supported"
        in faults(between(activity("x")), beside="<bpmn:teleport/>")[0]
    )
