"""Exporters: the history of a process as a file; `handover process export` chooses one by name.

An exporter is a function that takes the process as `GET /processes/{process}` of the orchestrator returns it,
and returns the content of the file. Other packages register theirs in the group `handover.exporters`.
"""

import csv
import io
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import orjson
from lxml import etree

from handover.extensions import ExtensionPoint
from handover.task_life import performers_of

Exporter = Callable[[Mapping[str, Any]], bytes]

EXPORTERS = ExtensionPoint(
    "exporter",
    "handover.exporters",
    {
        "csv": "handover.cli.exporters:csv_of",
        "json": "handover.cli.exporters:json_of",
        "xes": "handover.cli.exporters:xes_of",
    },
)
COLUMNS = (
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
LIFECYCLE = {
    "assigned": "assign",
    "inProgress": "start",
    "paused": "suspend",
    "completed": "complete",
    "failed": "ate_abort",
}
"""Status of a Task -> transition of the standard lifecycle of XES."""
XES_EXTENSIONS = {"concept": "Concept", "lifecycle": "Lifecycle", "org": "Organizational", "time": "Time"}
FORMULA = ("=", "+", "-", "@", "\t", "\r")


def json_of(process: Mapping[str, Any]) -> bytes:
    """Return everything about the process as JSON."""
    return orjson.dumps(process, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)


def csv_of(process: Mapping[str, Any]) -> bytes:
    """Return one line for each Task (RFC 4180, UTF-8 with a byte order mark for spreadsheets)."""
    text = io.StringIO()
    lines = csv.writer(text)
    lines.writerow(COLUMNS)
    for task in process["tasks"]:
        values = {
            **task,
            "process": process["id"],
            "task": task["id"],
            "performer": " ".join(performers_of(task["involves"])),
        }
        lines.writerow([_cell(values.get(column)) for column in COLUMNS])
    return f"\ufeff{text.getvalue()}".encode()


def _cell(value: Any) -> Any:
    """Return a text that a spreadsheet would run as a formula with a quote before it."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value


def xes_of(process: Mapping[str, Any]) -> bytes:
    """Return the process as a log of one trace for process mining (XES, IEEE 1849-2016).

    Each change of a Task or a reservation is an event with its transition in the standard lifecycle.
    """
    log = etree.Element(f"{{{XES}}}log", {"xes.version": "1849-2016"}, nsmap={None: XES})
    for prefix, name in XES_EXTENSIONS.items():
        uri = f"{XES}{prefix}.xesext"
        etree.SubElement(log, f"{{{XES}}}extension", {"name": name, "prefix": prefix, "uri": uri})
    etree.SubElement(log, f"{{{XES}}}classifier", {"name": "Activity", "keys": "concept:name"})
    _add_xes(log, "string", "concept:name", f"{process['definition']} version {process['version']}")
    trace = etree.SubElement(log, f"{{{XES}}}trace")
    _add_xes(trace, "string", "concept:name", process["id"])
    for at, transition, task in sorted(
        (*_transitions(process), *_reserved(process)), key=lambda each: each[0]
    ):
        event = etree.SubElement(trace, f"{{{XES}}}event")
        _add_xes(event, "string", "concept:name", task["name"])
        _add_xes(event, "string", "concept:instance", task["id"])
        _add_xes(event, "string", "lifecycle:transition", transition)
        _add_xes(event, "date", "time:timestamp", at)
        performers = performers_of(task["involves"])
        if performers:
            _add_xes(event, "string", "org:resource", " ".join(performers))
    return bytes(etree.tostring(log, xml_declaration=True, encoding="UTF-8", pretty_print=True))


def _transitions(process: Mapping[str, Any]) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Yield time, lifecycle transition and Task of each change."""
    for task in process["tasks"]:
        yield task["createdAt"], "schedule", task
        was_paused = False
        for change in task["history"]:
            transition = LIFECYCLE.get(change["status"], "unknown")
            if change["status"] == "inProgress" and was_paused:
                transition = "resume"
            elif change["status"] == "failed" and task["cancelled"]:
                transition = "pi_abort"
            was_paused = change["status"] == "paused"
            yield change["at"], transition, task


def _reserved(process: Mapping[str, Any]) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Yield time, lifecycle transition and content of each change of a reservation."""
    for each in process.get("reservations", ()):
        event = {"name": f"reserve {each['name']}", "id": each["key"], "involves": each["agents"]}
        yield each["askedAt"], "schedule", event
        if each["heldAt"] is not None:
            yield each["heldAt"], "start", event
        if each["state"] in {"ended", "released"}:
            transition = "complete" if each["heldAt"] is not None else "withdraw"
            yield each["since"], transition, event


def _add_xes(parent: etree._Element, kind: str, key: str, value: str) -> None:
    etree.SubElement(parent, f"{{{XES}}}{kind}", {"key": key, "value": value})
