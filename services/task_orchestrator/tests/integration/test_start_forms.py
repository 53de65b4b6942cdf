"""The start variables of a process are checked against the form of its start event."""

from typing import Any

import httpx
import pytest

from services.task_orchestrator.tests.unit.drawing import drawing, end, path

CAMUNDA = 'xmlns:camunda="http://camunda.org/schema/1.0/bpmn"'
ZEEBE = 'xmlns:zeebe="http://camunda.org/schema/zeebe/1.0"'
GENERATED = (
    '<camunda:formData><camunda:formField id="amount" label="Amount" type="long">'
    '<camunda:validation><camunda:constraint name="required"/><camunda:constraint name="max" config="9"/>'
    '</camunda:validation></camunda:formField><camunda:formField id="note" type="string"/></camunda:formData>'
)
SCHEMA = (
    '{"type": "object", "properties": {"amount": {"type": "integer", "title": "Amount", "maximum": 9}}, '
    '"required": ["amount"]}'
)
FORM_JS = {
    "type": "default",
    "id": "order",
    "schemaVersion": 16,
    "components": [
        {
            "type": "number",
            "key": "amount",
            "label": "Amount",
            "validate": {"required": True, "max": 9},
        }
    ],
}
STARTS = {
    "camunda7": f"<bpmn:extensionElements>{GENERATED}</bpmn:extensionElements>",
    "camunda7-file": "",
    "zeebe": '<bpmn:extensionElements><zeebe:formDefinition formId="order"/></bpmn:extensionElements>',
    "handover": f"<bpmn:extensionElements><handover:form>{SCHEMA}</handover:form></bpmn:extensionElements>",
    "handover-deployed": '<bpmn:extensionElements><handover:form ref="order"/></bpmn:extensionElements>',
}


def a_file(dialect: str) -> bytes:
    attributes = (
        'camunda:formRef="order" camunda:formRefBinding="latest"' if dialect == "camunda7-file" else ""
    )
    body = (
        f'<bpmn:startEvent id="start" {attributes}>{STARTS[dialect]}</bpmn:startEvent>'
        + '<bpmn:userTask id="work"/>'
        + end()
        + path("start", "work", "end")
    )
    xml = drawing(body, name="order").decode()
    vendor = ZEEBE if dialect == "zeebe" else CAMUNDA
    is_ours = dialect.startswith("handover")
    return (xml if is_ours else xml.replace("<bpmn:definitions ", f"<bpmn:definitions {vendor} ", 1)).encode()


async def start(api: httpx.AsyncClient, **parameters: Any) -> httpx.Response:
    return await api.post("/processes", json={"definition": "order", "parameters": parameters})


@pytest.mark.nightly
@pytest.mark.parametrize("dialect", STARTS)
async def test_start_variables_are_checked_against_the_form_of_the_start_event(
    api: httpx.AsyncClient, dialect: str
) -> None:
    (await api.post("/forms", json=FORM_JS)).raise_for_status()
    deployed = await api.post(
        "/definitions", content=a_file(dialect), headers={"Content-Type": "application/xml"}
    )
    assert deployed.status_code == 201, deployed.text
    assert deployed.json()["warnings"] == []
    form = (await api.post("/definitions/order/start-form", json={})).json()
    amount = form["fields"][0]
    assert (amount["path"], amount["label"], amount["isRequired"], amount["maximum"]) == (
        *("amount", "Amount"),
        *(True, 9.0),
    )
    for wrong in ({}, {"amount": 10}, {"amount": "many"}):
        refused = await start(api, **wrong)
        assert refused.status_code == 422, refused.text
        assert [fault["field"] for fault in refused.json()["faults"]] == ["amount"]
        assert "the start form of order refuses the variables; see amount" in refused.json()["detail"]
    started = await start(api, amount=3, source="MES")
    assert started.status_code == 201, started.text
    assert started.json()["variables"] == {"amount": 3, "source": "MES"}


@pytest.mark.nightly
async def test_a_definition_without_a_form_has_none(api: httpx.AsyncClient) -> None:
    xml = drawing('<bpmn:startEvent id="start"/>' + end() + path("start", "end"), name="order")
    await api.post("/definitions", content=xml, headers={"Content-Type": "application/xml"})
    assert (await api.post("/definitions/order/start-form", json={})).json() is None
    assert (await start(api, anything=1)).status_code == 201
