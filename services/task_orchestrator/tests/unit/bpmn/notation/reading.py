"""Helpers of the tests: reading small files, and what the reader found in them."""

import pytest

from handover_bpmn.model import Definition, Node
from handover_bpmn.notation.faults import BadBpmn
from handover_bpmn.notation.file import BpmnFile, read_bpmn
from services.task_orchestrator.tests.unit.drawing import end, path, start

NAMESPACES = (
    'xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:handover="urn:handover:bpmn" '
    'xmlns:camunda="http://camunda.org/schema/1.0/bpmn" xmlns:zeebe="http://camunda.org/schema/zeebe/1.0" '
    'xmlns:other="urn:other" targetNamespace="urn:test"'
)


def file(body: str, *, beside: str = "", name: str = "p", attributes: str = 'isExecutable="true"') -> bytes:
    """Return a file with one process that holds `body`; `beside` stands next to the process."""
    process = f'<bpmn:process id="{name}" {attributes}>{body}</bpmn:process>'
    return f"<bpmn:definitions {NAMESPACES}>{beside}{process}</bpmn:definitions>".encode()


def read(body: str, *, beside: str = "", attributes: str = 'isExecutable="true"') -> Definition:
    """Return the one process of a file."""
    found = read_bpmn(file(body, beside=beside, attributes=attributes))
    assert len(found.definitions) == 1
    return found.definitions[0]


def between(element: str, name: str = "x") -> str:
    """Return the element with the id `name` between a start and an end event."""
    return start() + element + end() + path("start", name, "end")


def node(element: str, name: str = "x", *, beside: str = "") -> Node:
    """Return the node of `element`, which is read between a start and an end event."""
    return read(between(element, name), beside=beside).scope.nodes[name]


def faults(body: str, *, beside: str = "") -> list[str]:
    """Return the faults of a process with `body`; each has all members of the JSON."""
    with pytest.raises(BadBpmn) as bad:
        read_bpmn(file(body, beside=beside))
    assert bad.value.status == 422
    assert bad.value.type == "urn:handover:bad-bpmn"
    for listed in bad.value.body()["faults"]:
        assert {"element", "name", "line", "message"} <= set(listed)
    return [str(fault) for fault in bad.value.faults]


def warnings(body: str, *, beside: str = "") -> list[str]:
    """Return the warnings of a process that can be read."""
    return [str(warning) for warning in read_bpmn(file(body, beside=beside)).warnings]


def extended(kind: str, extensions: str, *, name: str = "x", attributes: str = "", inner: str = "") -> str:
    """Return an element with extension elements."""
    groups = f"<bpmn:extensionElements>{extensions}</bpmn:extensionElements>"
    return f'<bpmn:{kind} id="{name}" {attributes}>{groups}{inner}</bpmn:{kind}>'


def processes(xml: bytes) -> BpmnFile:
    """Return a file that may have several processes."""
    return read_bpmn(xml)
