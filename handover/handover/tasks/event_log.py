"""Event logs of processes: a table of Tasks, or XES (IEEE 1849-2016) for process mining.

In XES a process is a trace. Each change of a Task or a reservation is an event with its transition in the
standard lifecycle.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from lxml import etree

from handover.tasks.task_life import performers_of

TASK_COLUMNS = (
    "process",
    "task",
    "element",
    "name",
    "visit",
    "performer",
    "status",
    "createdAt",
    "endedAt",
    "reason",
)
XES = "http://www.xes-standard.org/"
_LIFECYCLE = {
    "assigned": "assign",
    "inProgress": "start",
    "paused": "suspend",
    "completed": "complete",
    "failed": "ate_abort",
}
"""Status of a Task -> transition."""
_EXTENSIONS = {"concept": "Concept", "lifecycle": "Lifecycle", "org": "Organizational", "time": "Time"}
_NOT_XML = dict.fromkeys([*range(9), 11, 12, *range(14, 32), 0xFFFE, 0xFFFF])
"""Characters that XML 1.0 does not allow."""


def task_rows(process: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the Tasks of a process, as `GET /processes/{process}` returns it."""
    for task in process["tasks"]:
        performer = " ".join(performers_of(task["involves"]))
        yield {**task, "process": process["id"], "task": task["id"], "performer": performer}


def xes_log(name: str, processes: Iterable[Mapping[str, Any]]) -> bytes:
    """Return processes, as `GET /processes/{process}` returns them, as a log."""
    log = etree.Element(f"{{{XES}}}log", {"xes.version": "1849-2016"}, nsmap={None: XES})
    for prefix, extension in _EXTENSIONS.items():
        uri = f"{XES}{prefix}.xesext"
        etree.SubElement(log, f"{{{XES}}}extension", {"name": extension, "prefix": prefix, "uri": uri})
    etree.SubElement(log, f"{{{XES}}}classifier", {"name": "Activity", "keys": "concept:name"})
    _add(log, "string", "concept:name", name)
    for process in processes:
        _add_trace(log, process)
    return bytes(etree.tostring(log, xml_declaration=True, encoding="UTF-8", pretty_print=True))


def _add_trace(log: etree._Element, process: Mapping[str, Any]) -> None:
    trace = etree.SubElement(log, f"{{{XES}}}trace")
    _add(trace, "string", "concept:name", process["id"])
    changes = (*_transitions(process), *_reserved(process))
    for at, transition, task in sorted(changes, key=lambda change: change[0]):
        event = etree.SubElement(trace, f"{{{XES}}}event")
        _add(event, "string", "concept:name", task["name"])
        _add(event, "string", "concept:instance", task["id"])
        _add(event, "string", "lifecycle:transition", transition)
        _add(event, "date", "time:timestamp", at)
        if performers := performers_of(task["involves"]):
            _add(event, "string", "org:resource", " ".join(performers))


def _transitions(process: Mapping[str, Any]) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Yield time, lifecycle transition and Task of each change."""
    for task in process["tasks"]:
        yield task["createdAt"], "schedule", task
        was_paused = False
        for change in task["history"]:
            transition = _LIFECYCLE.get(change["status"], "unknown")
            if change["status"] == "inProgress" and was_paused:
                transition = "resume"
            elif change["status"] == "failed" and task["cancelled"]:
                transition = "pi_abort"
            was_paused = change["status"] == "paused"
            yield change["at"], transition, task


def _reserved(process: Mapping[str, Any]) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Yield time, lifecycle transition and content of each change of a reservation."""
    for reservation in process.get("reservations", ()):
        event = {
            "name": f"reserve {reservation['name']}",
            "id": reservation["key"],
            "involves": reservation["agents"],
        }
        yield reservation["askedAt"], "schedule", event
        if reservation["heldAt"] is not None:
            yield reservation["heldAt"], "start", event
        if reservation["state"] in {"ended", "released"}:
            transition = "complete" if reservation["heldAt"] is not None else "withdraw"
            yield reservation["since"], transition, event


def _add(parent: etree._Element, kind: str, key: str, value: str) -> None:
    written = value.translate(_NOT_XML)
    etree.SubElement(parent, f"{{{XES}}}{kind}", {"key": key, "value": written})
