"""Camunda 7: attributes, extension elements, listeners, scripts, calls and JUEL."""

import pytest

from handover_bpmn.model import (
    ErrorEvent,
    EscalationEvent,
    FormBinding,
    FormReference,
    Kind,
    MultiInstance,
    Node,
    TimerEvent,
)
from handover_bpmn.notation.dialects import camunda7_elements
from handover_bpmn.notation.file import read_bpmn
from services.task_orchestrator.tests.unit.bpmn.notation.reading import (
    between,
    extended,
    faults,
    file,
    node,
    read,
    warnings,
)
from services.task_orchestrator.tests.unit.drawing import (
    ONE_STEP,
    activity,
    end,
    flow,
    gateway,
    path,
    start,
    timer,
)

CAMUNDA = 'camunda:versionTag="7"'


def test_a_user_task_has_assignee_candidates_dates_and_form() -> None:
    attributes = (
        'camunda:assignee="${initiator}" camunda:candidateUsers="ann, bob" camunda:candidateGroups="cell" '
        'camunda:dueDate="2026-05-01T08:00:00" camunda:followUpDate="P1D" camunda:priority="50" '
        'camunda:formKey="embedded:app:forms/check.html"'
    )
    work = node(f'<bpmn:userTask id="x" {attributes}/>').activity
    assert work is not None
    assert work.hints == {
        "assignee": "${initiator}",
        "candidateUsers": "ann, bob",
        "candidateGroups": "cell",
        "dueDate": "2026-05-01T08:00:00",
        "followUpDate": "P1D",
        "priority": "50",
        "formKey": "embedded:app:forms/check.html",
    }
    assert not work.parameters
    assert work.results({"approved": True}) == {"approved": True}


@pytest.mark.parametrize(
    ("attribute", "hints", "operation"),
    [
        ('camunda:type="external" camunda:topic="pick"', {"type": "external", "topic": "pick"}, "pick"),
        ('camunda:class="org.cell.PickPart"', {"class": "org.cell.PickPart"}, "PickPart"),
        (
            'camunda:delegateExpression="${pickPart}"',
            {"delegateExpression": "${pickPart}"},
            "pickPart",
        ),
        (
            'camunda:expression="#{robot.pick(part)}"',
            {"expression": "#{robot.pick(part)}"},
            "robot.pick(part)",
        ),
    ],
)
def test_an_implementation_is_the_name_of_an_operation(
    attribute: str, hints: dict[str, str], operation: str
) -> None:
    for kind in ("serviceTask", "sendTask", "businessRuleTask"):
        work = node(f'<bpmn:{kind} id="x" {attribute}/>').activity
        assert work is not None
        assert work.hints == hints
        assert work.parameters["operation"].value({}) == operation


def test_the_result_of_a_task_goes_to_the_result_variable() -> None:
    work = node('<bpmn:serviceTask id="x" camunda:class="A" camunda:resultVariable="weight"/>').activity
    assert work is not None
    assert work.results({"value": 3}) == {"weight": {"value": 3}}


def test_input_and_output_parameters_are_texts_expressions_lists_and_maps() -> None:
    found = node(
        extended(
            "serviceTask",
            "<camunda:inputOutput>"
            '<camunda:inputParameter name="a">text</camunda:inputParameter>'
            '<camunda:inputParameter name="b">${n + 1}</camunda:inputParameter>'
            '<camunda:inputParameter name="c">part ${n}</camunda:inputParameter>'
            '<camunda:inputParameter name="d"><camunda:list><camunda:value>1</camunda:value>'
            "<camunda:value>${n}</camunda:value></camunda:list></camunda:inputParameter>"
            '<camunda:inputParameter name="e"><camunda:map><camunda:entry key="k">${n}</camunda:entry>'
            '<camunda:entry key="l">x</camunda:entry></camunda:map></camunda:inputParameter>'
            '<camunda:inputParameter name="f"/>'
            '<camunda:outputParameter name="out">${result.weight}</camunda:outputParameter>'
            "</camunda:inputOutput>",
            attributes='camunda:topic="pick"',
        )
    )
    values = {each.target: each.value.value({"n": 2}) for each in found.inputs}
    assert values == {
        "a": "text",
        "b": 3,
        "c": "part 2",
        "d": ["1", 2],
        "e": {"k": 2, "l": "x"},
        "f": None,
    }
    assert found.activity is not None
    parameters = {name: value.value({"n": 2}) for name, value in found.activity.parameters.items()}
    assert parameters == {**values, "operation": "pick"}
    assert [(each.target, each.value.value({"result": {"weight": 4}})) for each in found.outputs] == [
        ("out", 4)
    ]


def test_a_script_as_a_value_is_a_warning() -> None:
    element = extended(
        "userTask",
        '<camunda:inputOutput><camunda:inputParameter name="a"><camunda:script scriptFormat="groovy">1'
        "</camunda:script></camunda:inputParameter></camunda:inputOutput>",
    )
    assert "the groovy script of inputParameter a is not run here" in warnings(between(element))[0]


def test_a_generated_form_is_a_json_schema() -> None:
    form = (
        '<camunda:formData><camunda:formField id="approved" label="Approved?" type="boolean" '
        'defaultValue="true"/><camunda:formField id="amount" type="long" defaultValue="7">'
        '<camunda:validation><camunda:constraint name="required"/>'
        '<camunda:constraint name="max" config="10"/>'
        '</camunda:validation></camunda:formField><camunda:formField id="size" type="enum">'
        '<camunda:value id="s" name="Small"/><camunda:value id="l"/></camunda:formField>'
        '<camunda:formField id="due" type="date"/></camunda:formData>'
    )
    work = node(extended("userTask", form)).activity
    assert work is not None
    assert work.parameters["form"].literal == {
        "type": "object",
        "properties": {
            "approved": {"type": "boolean", "title": "Approved?", "default": True},
            "amount": {"type": "integer", "default": 7, "maximum": 10},
            "size": {
                "type": "string",
                "oneOf": [{"const": "s", "title": "Small"}, {"const": "l", "title": "l"}],
            },
            "due": {"type": "string", "format": "date"},
        },
        "required": ["amount"],
    }


def test_a_call_activity_maps_variables_and_binds_a_version() -> None:
    parts = (
        '<camunda:in source="part" target="item"/><camunda:in sourceExpression="${n + 1}" target="m"/>'
        '<camunda:in businessKey="#{orderId}"/><camunda:out source="box" target="packed"/>'
    )
    attributes = (
        'calledElement="${name}" camunda:calledElementBinding="version" camunda:calledElementVersion="3"'
    )
    call = node(extended("callActivity", parts, attributes=attributes)).call
    assert call is not None
    variables = {"name": "pack", "part": 1, "n": 1, "orderId": "o", "box": 5}
    assert call.process.value(variables) == "pack"
    assert call.version is not None
    assert call.version.value({}) == 3
    assert call.key is not None
    assert call.key.value(variables) == "o"
    assert [(each.target, each.value.value(variables)) for each in call.inputs] == [("item", 1), ("m", 2)]
    assert [(each.target, each.value.value(variables)) for each in call.outputs] == [("packed", 5)]
    assert not call.all_inputs


def test_a_call_activity_passes_all_variables_and_binds_a_tag() -> None:
    parts = '<camunda:in variables="all"/><camunda:out variables="all"/>'
    attributes = (
        'calledElement="pack" camunda:calledElementBinding="versionTag" camunda:calledElementVersionTag="v2"'
    )
    call = node(extended("callActivity", parts, attributes=attributes)).call
    assert call is not None
    assert call.all_inputs
    assert call.all_outputs
    assert call.tag is not None
    assert call.tag.value({}) == "v2"


def test_caught_errors_and_escalations_set_variables() -> None:
    declared = '<bpmn:error id="e" errorCode="E1"/>'
    for kind, attributes in (
        ("error", 'errorRef="e" camunda:errorCodeVariable="code" camunda:errorMessageVariable="text"'),
        ("escalation", 'camunda:escalationCodeVariable="code"'),
    ):
        event = f"<bpmn:{kind}EventDefinition {attributes}/>"
        body = ONE_STEP + f'<bpmn:boundaryEvent id="x" attachedToRef="work">{event}</bpmn:boundaryEvent>'
        found = read(body + flow("x", "end"), beside=declared).scope.nodes["x"].event
        assert found in {ErrorEvent("E1", "code", "text"), EscalationEvent(None, "code")}


def test_a_loop_runs_over_a_variable_or_an_expression() -> None:
    for collection in ("parts", "${parts}"):
        inner = (
            f'<bpmn:multiInstanceLoopCharacteristics camunda:collection="{collection}" '
            'camunda:elementVariable="part"/>'
        )
        loop = node(f'<bpmn:task id="x">{inner}</bpmn:task>').loop
        assert isinstance(loop, MultiInstance)
        assert loop.collection is not None
        assert loop.collection.value({"parts": [1]}) == [1]
        assert loop.item_variable == "part"


def choice(condition: str) -> str:
    body = start() + '<bpmn:task id="x"/>' + gateway("g") + end() + end("o")
    return body + path("start", "x", "g") + flow("g", "o", condition) + path("g", "end")


def test_conditions_are_juel_and_the_flow_without_one_is_the_default() -> None:
    definition = read(choice("${!approved and amount &gt; 3}"), attributes=f'isExecutable="true" {CAMUNDA}')
    assert definition.label == "7"
    condition = definition.scope.flows["g_o"].condition
    assert condition is not None
    assert condition.value({"approved": False, "amount": 4}) is True
    assert definition.scope.nodes["g"].default == "g_end"


def test_a_file_of_no_dialect_may_use_juel_too() -> None:
    body = choice("${approved}").replace('id="g"', 'id="g" default="g_end"')
    condition = read(body).scope.flows["g_o"].condition
    assert condition is not None
    assert condition.value({"approved": True}) is True


def test_an_activity_that_a_condition_asks_for_its_outcome_handles_it() -> None:
    definition = read(choice("${outcome == 'bad'}"), attributes=f'isExecutable="true" {CAMUNDA}')
    assert definition.activities()["x"].handles_outcomes
    definition = read(choice("${approved}"), attributes=f'isExecutable="true" {CAMUNDA}')
    assert not definition.activities()["x"].handles_outcomes


def test_our_task_in_a_file_of_camunda_keeps_its_meaning() -> None:
    body = (
        start() + activity("a") + '<bpmn:userTask id="b" camunda:assignee="ann"/>' + path("start", "a", "b")
    )
    activities = read(body).activities()
    assert activities["a"].results({"x": 1}) == {"a": {"x": 1}}
    assert activities["b"].results({"x": 1}) == {"x": 1}


def listener(event: str, name: str = "n", tag: str = "executionListener") -> str:
    expression = f"${{execution.setVariable('{name}', {name} + 1)}}"
    return f'<camunda:{tag} event="{event}" expression="{expression}"/>'


def names(body: str) -> tuple[list[tuple[str, str]], dict[str, Node]]:
    scope = read(body).scope
    return [(each.source, each.target) for each in scope.flows.values()], dict(scope.nodes)


def test_listeners_that_set_variables_are_scripts_before_and_after() -> None:
    flows, nodes = names(between(extended("task", listener("start") + listener("end", "m"))))
    assert set(flows) == {
        ("start", "x.before"),
        ("x.before", "x"),
        ("x", "x.after"),
        ("x.after", "end"),
    }
    script = nodes["x.before"].script
    assert nodes["x.before"].kind is Kind.SCRIPT_TASK
    assert script is not None
    assert [(each.target, each.value.value({"n": 1})) for each in script] == [("n", 2)]
    assert warnings(between(extended("task", listener("start")))) == []


def test_a_listener_of_a_sequence_flow_sets_variables_when_it_is_taken() -> None:
    group = f"<bpmn:extensionElements>{listener('take')}</bpmn:extensionElements>"
    body = start() + '<bpmn:task id="x"/>'
    body += f'<bpmn:sequenceFlow id="f" sourceRef="start" targetRef="x">{group}</bpmn:sequenceFlow>'
    flows, _ = names(body)
    assert set(flows) == {("start", "f.set"), ("f.set", "x")}


def test_a_listener_of_the_process_or_a_start_event_sets_variables_at_the_start() -> None:
    group = f"<bpmn:extensionElements>{listener('start')}</bpmn:extensionElements>"
    flows, _ = names(group + between('<bpmn:task id="x"/>'))
    assert set(flows) == {("start", "start.after"), ("start.after", "x"), ("x", "end")}


def test_other_listeners_are_warnings() -> None:
    for attributes in ('class="org.A"', 'delegateExpression="${a}"', 'expression="${log.print()}"'):
        element = extended("userTask", f'<camunda:taskListener event="create" {attributes}/>')
        assert warnings(between(element)) == [
            'line 1, "x": camunda:taskListener has no effect on the execution'
        ]


def test_a_script_of_juel_runs_and_any_other_is_a_task() -> None:
    element = (
        '<bpmn:scriptTask id="x" scriptFormat="{}" camunda:resultVariable="y"><bpmn:script>${{n + 1}}'
        "</bpmn:script></bpmn:scriptTask>"
    )
    script = node(element.format("juel")).script
    assert script is not None
    assert [(each.target, each.value.value({"n": 1})) for each in script] == [("y", 2)]
    work = node(element.format("javascript")).activity
    assert work is not None
    assert work.variable == "y"
    assert work.parameters["scriptFormat"].literal == "javascript"


def test_a_script_that_only_sets_variables_runs() -> None:
    source = "// count\nexecution.setVariable('a', n + 1);\nexecution.setVariable(\"b\", 'x');"
    element = (
        f'<bpmn:scriptTask id="x" scriptFormat="JavaScript" {CAMUNDA}><bpmn:script>{source}</bpmn:script>'
        "</bpmn:scriptTask>"
    )
    script = node(element).script
    assert script is not None
    assert [(each.target, each.value.value({"n": 1})) for each in script] == [("a", 2), ("b", "x")]
    assert "only sets variables and is read as JUEL" in warnings(between(element))[0]


def test_a_script_of_a_listener_that_only_sets_variables_runs() -> None:
    source = (
        '<camunda:executionListener event="end"><camunda:script scriptFormat="groovy">'
        "execution.setVariable('a', 1)</camunda:script></camunda:executionListener>"
    )
    flows, _ = names(between(extended("task", source)))
    assert ("x", "x.after") in flows
    assert warnings(between(extended("task", source))) == []
    other = source.replace("execution.set", "println(1); execution.set")
    assert len(warnings(between(extended("task", other)))) == 1


def test_a_message_event_with_an_implementation_is_a_task() -> None:
    definition = '<bpmn:messageEventDefinition camunda:type="external" camunda:topic="mail"/>'
    body = between(f'<bpmn:intermediateThrowEvent id="x">{definition}</bpmn:intermediateThrowEvent>')
    found = read(body).scope.nodes["x"]
    assert found.kind is Kind.SEND_TASK
    assert found.activity is not None
    assert found.activity.hints == {"type": "external", "topic": "mail"}
    assert found.activity.parameters["operation"].literal == "mail"


def test_a_connector_is_an_operation_with_its_inputs_and_outputs() -> None:
    found = node(
        extended(
            "serviceTask",
            "<camunda:connector><camunda:inputOutput>"
            '<camunda:inputParameter name="url">http://host</camunda:inputParameter>'
            '<camunda:outputParameter name="body">${response}</camunda:outputParameter>'
            "</camunda:inputOutput><camunda:connectorId>http-connector</camunda:connectorId>"
            "</camunda:connector>",
        )
    )
    work = found.activity
    assert work is not None
    assert work.hints == {"connector": "http-connector"}
    assert {name: value.literal for name, value in work.parameters.items()} == {
        "operation": "http-connector",
        "url": "http://host",
    }
    assert [each.target for each in found.outputs] == ["body"]


def test_fields_and_properties_are_parameters() -> None:
    parts = (
        '<camunda:field name="a" stringValue="text"/><camunda:field name="b" expression="${n}"/>'
        "<camunda:field name='c'><camunda:string>long</camunda:string></camunda:field>"
        '<camunda:properties><camunda:property name="speed" value="slow"/></camunda:properties>'
    )
    work = node(extended("serviceTask", parts, attributes='camunda:class="A"')).activity
    assert work is not None
    assert {name: value.value({"n": 2}) for name, value in work.parameters.items()} == {
        "a": "text",
        "b": 2,
        "c": "long",
        "properties": {"speed": "slow"},
        "operation": "A",
    }


def test_a_signal_takes_variables_along() -> None:
    definition = extended("signalEventDefinition", '<camunda:in source="part" target="item"/>', name="d")
    found = node(f'<bpmn:intermediateThrowEvent id="x">{definition}</bpmn:intermediateThrowEvent>')
    assert [(each.target, each.value.value({"part": 1})) for each in found.inputs] == [("item", 1)]


def test_a_time_without_zone_is_utc() -> None:
    event = f'<bpmn:intermediateCatchEvent id="x" {CAMUNDA}>{timer("2026-05-01T08:00:00")}'
    found = node(event + "</bpmn:intermediateCatchEvent>").event
    assert isinstance(found, TimerEvent)
    assert found.value.literal == "2026-05-01T08:00:00Z"
    assert "is read as UTC" in warnings(between(event + "</bpmn:intermediateCatchEvent>"))[0]


@pytest.mark.parametrize("namespace", camunda7_elements.NAMESPACES)
def test_the_relatives_of_camunda_have_the_same_attributes(namespace: str) -> None:
    xml = file(between('<bpmn:userTask id="x" camunda:assignee="ann"/>'))
    xml = xml.replace(camunda7_elements.NAMESPACES[0].encode(), namespace.encode())
    assert read_bpmn(xml).definitions[0].activities()["x"].hints == {"assignee": "ann"}


@pytest.mark.parametrize("attribute", ["asyncBefore", "asyncAfter", "exclusive", "jobPriority", "unknown"])
def test_attributes_without_effect_are_warnings(attribute: str) -> None:
    element = f'<bpmn:task id="x" camunda:{attribute}="true"/>'
    assert warnings(between(element)) == [f'line 1, "x": camunda:{attribute} has no effect on the execution']


@pytest.mark.parametrize(
    ("element", "reason"),
    [
        (
            '<bpmn:businessRuleTask id="x" camunda:decisionRef="d"/>',
            "businessRuleTask with decisionRef (a DMN decision) is not supported yet; let a Task decide",
        ),
        ('<bpmn:callActivity id="x" camunda:caseRef="c"/>', "callActivity with caseRef (CMMN)"),
        (
            extended("callActivity", '<camunda:in source="a b" target="c"/>', attributes='calledElement="p"'),
            '"a b" cannot be the name of a variable',
        ),
        (
            '<bpmn:callActivity id="x" calledElement="p" camunda:calledElementBinding="version"/>',
            'calledElementBinding="version" needs calledElementVersion',
        ),
        (
            extended(
                "task",
                '<camunda:inputOutput><camunda:inputParameter name="a">${1 +}</camunda:inputParameter>'
                "</camunda:inputOutput>",
            ),
            "${1 +}",
        ),
        (
            '<bpmn:task id="x"><bpmn:multiInstanceLoopCharacteristics camunda:collection="${"/></bpmn:task>',
            "${",
        ),
        (
            f'<bpmn:intermediateCatchEvent id="x" {CAMUNDA}>{timer("soon")}</bpmn:intermediateCatchEvent>',
            '"soon" is no timeDuration; write it like PT5M',
        ),
    ],
)
def test_a_wrong_extension_is_one_fault(element: str, reason: str) -> None:
    found = faults(between(element))
    assert len(found) == 1, found
    assert reason in found[0]


def test_a_condition_of_our_language_in_a_file_of_camunda_is_a_fault() -> None:
    body = choice("amount > 3").replace('id="x"', f'id="x" {CAMUNDA}')
    assert faults(body)[0].startswith('line 1, "g_o"')


def test_a_generated_form_has_types_constraints_and_defaults() -> None:
    fields = """
      <camunda:formField id="count" type="long" defaultValue="3"/>
      <camunda:formField id="good" type="boolean" defaultValue="true"/>
      <camunda:formField id="when" type="date" defaultValue="24/12/2026"/>
      <camunda:formField id="who" type="string" defaultValue="${initiator}" label="Who">
        <camunda:validation>
          <camunda:constraint name="required"/><camunda:constraint name="maxlength" config="9"/>
          <camunda:constraint name="validator" config="org.cell.Check"/>
        </camunda:validation>
      </camunda:formField>
      <camunda:formField id="serial" type="string">
        <camunda:validation><camunda:constraint name="readonly"/></camunda:validation>
      </camunda:formField>
      <camunda:formField id="colour" type="enum"><camunda:value id="r" name="Red"/></camunda:formField>
      <camunda:formField id="odd" type="money"/>
    """
    text = extended("userTask", f"<camunda:formData>{fields}</camunda:formData>")
    work = node(text).activity
    assert work is not None
    form = work.parameters["form"].value({"initiator": "Anna"})
    properties = form["properties"]
    assert properties["count"] == {"type": "integer", "default": 3}
    assert properties["good"]["default"] is True
    assert properties["when"] == {"type": "string", "format": "date", "default": "2026-12-24"}
    assert properties["who"] == {
        "type": "string",
        "title": "Who",
        "minLength": 1,
        "maxLength": 9,
        "default": "Anna",
    }
    assert properties["serial"]["readOnly"] is True
    assert properties["colour"]["oneOf"] == [{"const": "r", "title": "Red"}]
    assert form["required"] == ["who"]
    said = " ".join(warnings(between(text)))
    assert "validator" in said
    assert "money" in said


@pytest.mark.parametrize(
    ("attributes", "reference"),
    [
        (
            'camunda:formKey="camunda-forms:deployment:check.form"',
            FormReference("check.form", FormBinding.DEPLOYMENT, is_file=True),
        ),
        ('camunda:formRef="check"', FormReference("check")),
        (
            'camunda:formRef="check" camunda:formRefBinding="deployment"',
            FormReference("check", FormBinding.DEPLOYMENT),
        ),
        (
            'camunda:formRef="check" camunda:formRefBinding="version" camunda:formRefVersion="2"',
            FormReference("check", FormBinding.VERSION, 2),
        ),
        ('camunda:formKey="embedded:app:forms/check.html"', None),
    ],
)
def test_a_user_task_names_a_deployed_form(attributes: str, reference: FormReference | None) -> None:
    work = node(f'<bpmn:userTask id="x" {attributes}/>').activity
    assert work is not None
    assert work.form == reference


@pytest.mark.parametrize(
    ("attributes", "script"),
    [
        ("camunda:expression=\"${execution.setVariable('a', n + 1)}\"", ("a", 3)),
        ('camunda:expression="#{n + 1}" camunda:resultVariable="a"', ("a", 3)),
        ('camunda:expression="${n}" camunda:resultVariableName="a"', ("a", 2)),
        ('camunda:expression="${bean.total}" camunda:resultVariable="a"', None),
        ('camunda:expression="${bean.total(n)}" camunda:resultVariable="a"', None),
        ('camunda:expression="${n}"', None),
    ],
)
def test_an_expression_of_a_service_task_is_evaluated_unless_it_may_call_a_bean(
    attributes: str, script: tuple[str, int] | None
) -> None:
    found = node(f'<bpmn:serviceTask id="x" {attributes}/>')
    if script is None:
        assert found.activity is not None
        return
    assert found.script is not None
    (assignment,) = found.script
    assert (assignment.target, assignment.value.value({"n": 2})) == script


@pytest.mark.parametrize(
    ("source", "assigned"),
    [
        ("${execution.setVariable('a', 1)}", ["a"]),
        ("a = 1", ["a"]),
        ("${now()}", []),
        ("println(1)", None),
    ],
)
def test_a_script_without_a_language_is_juel_or_ours_or_work(source: str, assigned: list[str] | None) -> None:
    found = node(f'<bpmn:scriptTask id="x" {CAMUNDA}><bpmn:script>{source}</bpmn:script></bpmn:scriptTask>')
    if assigned is None:
        assert found.activity is not None
        assert found.activity.parameters["script"].literal == source
    else:
        assert found.script is not None
        assert [each.target for each in found.script] == assigned


def test_the_values_of_data_objects_are_defaults_of_variables() -> None:
    data = (
        '<bpmn:dataObject id="d1" name="count" itemSubjectRef="xsd:int"><bpmn:extensionElements>'
        "<camunda:value>5</camunda:value></bpmn:extensionElements></bpmn:dataObject>"
        '<bpmn:dataObject id="word"><bpmn:extensionElements><camunda:value>a"b</camunda:value>'
        '</bpmn:extensionElements></bpmn:dataObject><bpmn:dataObject id="plain"/>'
    )
    script = read(data + between('<bpmn:task id="x"/>')).scope.nodes["start.after"].script
    assert script is not None
    assert {each.target: each.value.value({}) for each in script} == {"count": 5, "word": 'a"b'}
    assert {each.target: each.value.value({"count": 7, "word": "w"}) for each in script} == {
        "count": 7,
        "word": "w",
    }


def test_a_called_process_may_inherit_all_variables() -> None:
    call = '<bpmn:callActivity id="x" calledElement="q" camunda:inheritVariables="{}"/>'
    for given, inherits in (("true", True), ("false", False)):
        found = node(call.format(given)).call
        assert found is not None
        assert found.all_inputs is inherits


def test_a_decision_of_flowable_is_refused_by_name() -> None:
    (fault,) = faults(between('<bpmn:serviceTask id="x" name="Rate" camunda:type="dmn"/>'))
    assert fault.startswith(
        'line 1, "x" ("Rate"): serviceTask of the type dmn (a DMN decision) is not supported'
    )


@pytest.mark.parametrize("name", ["from", "class", "content-type", "größe", "max"])
def test_a_variable_may_have_a_name_that_our_language_reserves(name: str) -> None:
    io = (
        f'<camunda:inputOutput><camunda:inputParameter name="{name}">1</camunda:inputParameter>'
        f'<camunda:outputParameter name="{name}">2</camunda:outputParameter></camunda:inputOutput>'
    )
    found = node(extended("serviceTask", io, attributes='camunda:topic="t"'))
    assert [each.target for each in (*found.inputs, *found.outputs)] == [name, name]
    passed = extended(
        "callActivity", f'<camunda:in source="{name}" target="{name}"/>', attributes='calledElement="q"'
    )
    call = node(passed).call
    assert call is not None
    assert call.inputs[0].value.value({name: 3}) == 3


@pytest.mark.parametrize("reference", ["assignees", "${assignees}"])
def test_a_loop_may_name_its_collection_as_bpmn_does(reference: str) -> None:
    loop = (
        f"<bpmn:multiInstanceLoopCharacteristics><bpmn:loopDataInputRef>{reference}</bpmn:loopDataInputRef>"
        '<bpmn:inputDataItem name="assignee"/></bpmn:multiInstanceLoopCharacteristics>'
    )
    found = node(f'<bpmn:userTask id="x" {CAMUNDA}>{loop}</bpmn:userTask>').loop
    assert isinstance(found, MultiInstance)
    assert found.collection is not None
    assert found.collection.value({"assignees": ["a"]}) == ["a"]
    assert (found.item_variable, found.output_collection) == ("assignee", None)


def test_a_date_without_a_time_is_midnight_in_utc() -> None:
    event = timer("2026-05-01")
    body = between(f'<bpmn:intermediateCatchEvent id="x" {CAMUNDA}>{event}</bpmn:intermediateCatchEvent>')
    found = read(body).scope.nodes["x"].event
    assert isinstance(found, TimerEvent)
    assert found.value.literal == "2026-05-01T00:00:00Z"
    assert "is read as UTC" in warnings(body)[0]


def _flowable_loop(extension: str) -> MultiInstance:
    loop = (
        '<bpmn:multiInstanceLoopCharacteristics camunda:elementVariable="item">'
        f"<bpmn:extensionElements>{extension}</bpmn:extensionElements></bpmn:multiInstanceLoopCharacteristics>"
    )
    found = node(f'<bpmn:userTask id="x">{loop}</bpmn:userTask>').loop
    assert isinstance(found, MultiInstance)
    return found


@pytest.mark.parametrize(
    ("collection", "items"),
    [
        ('<camunda:string>[{"n": 1}, {"n": 2}]</camunda:string>', [{"n": 1}, {"n": 2}]),
        ("<camunda:expression>${people}</camunda:expression>", ["a"]),
        ("people", ["a"]),
    ],
)
def test_the_collection_of_a_loop_may_be_an_element(collection: str, items: list[object]) -> None:
    found = _flowable_loop(f"<camunda:collection>{collection}</camunda:collection>")
    assert found.collection is not None
    assert found.collection.value({"people": ["a"]}) == items


def test_a_collection_that_is_no_json_is_one_fault() -> None:
    loop = (
        "<bpmn:multiInstanceLoopCharacteristics><bpmn:extensionElements><camunda:collection>[1,"
        "</camunda:collection></bpmn:extensionElements></bpmn:multiInstanceLoopCharacteristics>"
    )
    (fault,) = faults(between(f'<bpmn:userTask id="x">{loop}</bpmn:userTask>'))
    assert "the collection is no JSON list" in fault


def test_variables_of_a_loop_may_be_aggregated() -> None:
    found = _flowable_loop(
        "<camunda:collection>[1]</camunda:collection>"
        '<camunda:variableAggregation target="reviews"><variable source="good"/>'
        '<variable source="note" target="n"/><variable sourceExpression="${good ? 1 : 0}" target="score"/>'
        '<variable sourceExpression="${bean.call(x)}" target="other"/></camunda:variableAggregation>'
    )
    assert found.output_collection == "reviews"
    assert found.output_item is not None
    assert found.output_item.value({"good": True}) == {"good": True, "n": None, "score": 1}


def test_a_moment_without_a_zone_in_a_cycle_or_of_an_expression_is_in_utc() -> None:
    def value(kind: str, text: str) -> object:
        event = f"<bpmn:timerEventDefinition><bpmn:{kind}>{text}</bpmn:{kind}></bpmn:timerEventDefinition>"
        catch = f'<bpmn:intermediateCatchEvent id="x" {CAMUNDA}>{event}</bpmn:intermediateCatchEvent>'
        found = node(catch).event
        assert isinstance(found, TimerEvent)
        return found.value.value({"due": "2036-11-15T11:00:00", "every": 5})

    assert value("timeCycle", "R2/2036-11-15T11:00/PT10S") == "R2/2036-11-15T11:00Z/PT10S"
    assert value("timeCycle", "R2/PT10S/2036-11-15") == "R2/PT10S/2036-11-15T00:00:00Z"
    assert value("timeCycle", "R2/2036-11-15T11:00+01:00/PT10S") == "R2/2036-11-15T11:00+01:00/PT10S"
    assert value("timeDate", "${due}") == "2036-11-15T11:00:00Z"
    assert value("timeDuration", "PT${every}S") == "PT5S"


def test_a_start_timer_that_reads_variables_is_a_warning() -> None:
    start_timer = f'<bpmn:startEvent id="s" {CAMUNDA}>{timer("${due}")}</bpmn:startEvent>'
    (warning,) = warnings(start_timer + '<bpmn:task id="x"/>' + end() + path("s", "x", "end"))
    assert "it starts no process: its time reads due" in warning


def test_an_older_namespace_of_camunda_is_known() -> None:
    xml = file(between('<bpmn:userTask id="x" camunda:assignee="ann"/>')).replace(
        b"http://camunda.org/schema/1.0/bpmn", b"http://camunda.org/bpmn"
    )
    work = read_bpmn(xml).definitions[0].scope.nodes["x"].activity
    assert work is not None
    assert work.hints == {"assignee": "ann"}
