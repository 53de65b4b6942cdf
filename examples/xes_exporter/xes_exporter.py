"""Exports the history of a process as an XES event log (IEEE 1849), for process mining."""

from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree as ET

TRANSITIONS = {
    "assigned": "assign",
    "inProgress": "start",
    "paused": "suspend",
    "completed": "complete",
    "failed": "ate_abort",
}
"""The life cycle transitions of XES, by the status of a Task."""


def export(process: Mapping[str, Any]) -> bytes:
    """Return the log: one trace with an event for each change of status of each Task."""
    log = ET.Element("log", {"xes.version": "1849-2016", "xmlns": "http://www.xes-standard.org/"})
    for name in ("Concept", "Time", "Lifecycle", "Organizational"):
        prefix = "org" if name == "Organizational" else name.lower()
        uri = f"http://www.xes-standard.org/{prefix}.xesext"
        ET.SubElement(log, "extension", {"name": name, "prefix": prefix, "uri": uri})
    trace = ET.SubElement(log, "trace")
    _add(trace, "string", "concept:name", process["id"])
    changes = [(change, task) for task in process["tasks"] for change in _changes(task)]
    for change, task in sorted(changes, key=lambda pair: pair[0]["at"]):
        event = ET.SubElement(trace, "event")
        _add(event, "string", "concept:name", task["name"] or task["element"])
        _add(event, "string", "concept:instance", task["id"])
        _add(event, "string", "lifecycle:transition", TRANSITIONS.get(change["status"], "schedule"))
        _add(event, "string", "org:resource", " ".join(task["involves"]))
        _add(event, "date", "time:timestamp", change["at"])
    ET.indent(log)
    content: bytes = ET.tostring(log, encoding="utf-8", xml_declaration=True)
    return content


def _changes(task: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the creation of a Task, then its changes of status."""
    return [{"status": "pending", "at": task["createdAt"]}, *task["history"]]


def _add(parent: ET.Element, kind: str, key: str, value: str) -> None:
    ET.SubElement(parent, kind, {"key": key, "value": value})
