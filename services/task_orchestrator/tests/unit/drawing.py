"""Drawings for tests: small BPMN files, written as short as they can be."""

from datetime import UTC, datetime
from itertools import pairwise

NOW = datetime(2026, 5, 4, 8, 0, tzinfo=UTC)

HEAD = (
    '<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL" '
    'xmlns:handover="urn:handover:bpmn" targetNamespace="urn:test">'
)


def drawing(body: str, *, beside: str = "", name: str = "p") -> bytes:
    """Return a file with one process that holds `body`; `beside` stands next to the process."""
    process = f'<bpmn:process id="{name}" isExecutable="true">{body}</bpmn:process>'
    return f"{HEAD}{beside}{process}</bpmn:definitions>".encode()


def flow(source: str, target: str, condition: str | None = None) -> str:
    """Return a sequence flow, called `source_target`."""
    asked = f"<bpmn:conditionExpression>{condition}</bpmn:conditionExpression>" if condition else ""
    ends = f'sourceRef="{source}" targetRef="{target}"'
    return f'<bpmn:sequenceFlow id="{source}_{target}" {ends}>{asked}</bpmn:sequenceFlow>'


def path(*names: str) -> str:
    """Return the flows that lead through `names` one after the other."""
    return "".join(flow(source, target) for source, target in pairwise(names))


def activity(name: str, inner: str = "", *, kind: str = "userTask", attributes: str = "") -> str:
    """Return an activity of glove-1 that hands over the TaskDefinition of its own name."""
    task = (
        f'<handover:task definition="{name}" {attributes}>'
        f'<handover:involves resource="Device:glove-1"/>{inner}</handover:task>'
    )
    extensions = f"<bpmn:extensionElements>{task}</bpmn:extensionElements>"
    return f'<bpmn:{kind} id="{name}">{extensions}</bpmn:{kind}>'


def gateway(name: str, kind: str = "exclusive", default: str | None = None) -> str:
    """Return a gateway."""
    chosen = f' default="{default}"' if default else ""
    return f'<bpmn:{kind}Gateway id="{name}"{chosen}/>'


def timer(text: str) -> str:
    """Return a timer definition of an ISO 8601 duration or moment, or an expression."""
    tag = "timeDate" if text[:1].isdigit() else "timeDuration"
    return f"<bpmn:timerEventDefinition><bpmn:{tag}>{text}</bpmn:{tag}></bpmn:timerEventDefinition>"


def boundary(name: str, host: str, event: str, *, interrupting: bool = True) -> str:
    """Return a boundary event of the activity `host`."""
    cancels = str(interrupting).lower()
    attributes = f'attachedToRef="{host}" cancelActivity="{cancels}"'
    return f'<bpmn:boundaryEvent id="{name}" {attributes}>{event}</bpmn:boundaryEvent>'


def start(name: str = "start") -> str:
    """Return a start event."""
    return f'<bpmn:startEvent id="{name}"/>'


def end(name: str = "end", event: str = "") -> str:
    """Return an end event."""
    return f'<bpmn:endEvent id="{name}">{event}</bpmn:endEvent>'


def parameters(**values: str) -> str:
    """Return the process extension with parameters and their defaults."""
    listed = "".join(f'<handover:parameter name="{name}" value="{value}"/>' for name, value in values.items())
    process = f'<handover:process version="7">{listed}</handover:process>'
    return f"<bpmn:extensionElements>{process}</bpmn:extensionElements>"


ONE_STEP = start() + activity("work") + end() + path("start", "work", "end")
