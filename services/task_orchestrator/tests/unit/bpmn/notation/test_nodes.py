"""Each kind of flow node is a line of one table, and so is each event definition."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import handover_bpmn
from handover_bpmn.model import EVENTS, REFUSED, Kind
from handover_bpmn.notation.faults import BadBpmn
from handover_bpmn.notation.file import read_bpmn
from handover_bpmn.notation.nodes.event_definitions import EVENT_TYPES
from handover_bpmn.notation.nodes.table import NODE_TYPES
from services.task_orchestrator.tests.unit.drawing import activity, drawing, end, path, start


def test_every_kind_has_a_type() -> None:
    assert set(NODE_TYPES) == set(Kind)
    assert all(node_type.kind is kind for kind, node_type in NODE_TYPES.items())
    assert not REFUSED.keys() & {kind.value for kind in Kind}


NEW_GATEWAY = {
    "model/nodes.py": (
        ('    EVENT_BASED = "eventBasedGateway"\n', '    COMPLEX = "complexGateway"\n'),
        ("Kind.PARALLEL, Kind.EVENT_BASED", ", Kind.COMPLEX"),
        ("", '    "complexGateway": "draw it with exclusive, inclusive and parallel gateways instead",\n'),
    ),
    "notation/nodes/gateways.py": (
        (
            "NODE_TYPES = (\n",
            "    NodeType(Kind.COMPLEX, _read_gateway, _GATEWAY_PARTS, has_conditions=True),\n",
        ),
    ),
}
"""The two files of a new element: after which text something is added; without such a text it is removed."""
SPLIT = """
from datetime import UTC, datetime
from handover_bpmn.definitions import Definitions
from handover_bpmn.execution.run import Run
from handover_bpmn.notation.file import read_bpmn
file = read_bpmn(b'''<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL">
<process id="p" isExecutable="true"><startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="c"/>
<complexGateway id="c" default="other"/>
<sequenceFlow id="any" sourceRef="c" targetRef="a">
<conditionExpression>n > 1</conditionExpression></sequenceFlow>
<sequenceFlow id="all" sourceRef="c" targetRef="b">
<conditionExpression>n > 2</conditionExpression></sequenceFlow>
<sequenceFlow id="other" sourceRef="c" targetRef="d"/>
<userTask id="a"/><userTask id="b"/><userTask id="d"/></process></definitions>''')
assert not [warning for warning in file.warnings if warning.element in {"c", "any", "all"}], file.warnings
library, now = Definitions(file.definitions), datetime(2026, 5, 4, tzinfo=UTC)
for number in (1, 2, 3):
    run = Run.start(library.plans["p"], {"n": number}, now, library)
    print(*sorted(work.element for work in run.open()))
"""


def test_a_new_element_is_a_kind_and_a_row_of_the_table(tmp_path: Path) -> None:
    package = tmp_path / "handover_bpmn"
    shutil.copytree(
        Path(handover_bpmn.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__")
    )
    for name, edits in NEW_GATEWAY.items():
        source = (package / name).read_text(encoding="utf-8")
        for after, text in edits:
            place = after or text
            assert source.count(place) == 1, place
            source = source.replace(place, after + text if after else "")
        (package / name).write_text(source, encoding="utf-8")
    (tmp_path / "split.py").write_text(SPLIT, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, str(tmp_path / "split.py")],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split("\n") == ["d", "a", "a b", ""], done.stderr


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
