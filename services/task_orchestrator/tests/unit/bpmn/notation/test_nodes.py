"""Each kind of flow node is a line of one table, and so is each event definition."""

import pytest

from handover_bpmn.model import EVENTS, Kind
from handover_bpmn.notation.faults import BadBpmn
from handover_bpmn.notation.file import read_bpmn
from handover_bpmn.notation.nodes.event_definitions import EVENT_TYPES
from handover_bpmn.notation.nodes.table import NODE_TYPES
from services.task_orchestrator.tests.unit.drawing import activity, drawing, end, path, start


def test_every_kind_has_a_type() -> None:
    assert set(NODE_TYPES) == set(Kind)
    assert all(node_type.kind is kind for kind, node_type in NODE_TYPES.items())


@pytest.mark.parametrize("kind", sorted(kind for kind in Kind if not NODE_TYPES[kind].has_incoming))
def test_only_events_may_forbid_incoming_flows(kind: Kind) -> None:
    assert kind in EVENTS


@pytest.mark.parametrize("name", EVENT_TYPES)
def test_an_event_definition_is_refused_where_it_may_not_stand(name: str) -> None:
    caught = (
        f'<bpmn:intermediateCatchEvent id="c"><bpmn:{name}EventDefinition/></bpmn:intermediateCatchEvent>'
    )
    body = start() + caught + end() + path("start", "c", "end")
    supported = ["message", "timer", "signal", "conditional", "link"]
    try:
        read_bpmn(drawing(body))
        texts = ""
    except BadBpmn as bad:
        texts = " ".join(fault.message for fault in bad.faults)
    assert (f"with {name}EventDefinition is not supported" in texts) == (name not in supported)


def test_parts_that_a_node_does_not_have_are_reported() -> None:
    body = start() + activity("work", "").replace(
        "</bpmn:userTask>", "<bpmn:script>x</bpmn:script></bpmn:userTask>"
    )
    with pytest.raises(BadBpmn) as bad:
        read_bpmn(drawing(body + end() + path("start", "work", "end")))
    assert "script in a userTask is not supported yet" in str(bad.value.faults[0])
