"""Comparison: which elements of a process two BPMN files have in different form."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from lxml import etree

from handover_bpmn.notation.document import BPMN, is_bpmn, local, parse

_CONTAINERS = frozenset({"process", "subProcess"})
_IGNORED = frozenset({"incoming", "outgoing"})
"""Children that say what the sequence flows say."""


@dataclass(frozen=True, slots=True)
class ElementChange:
    """An element that was added, removed or changed."""

    process: str
    element: str
    name: str | None
    change: Literal["added", "removed", "changed"]


def changed_elements(before: bytes, after: bytes, process: str) -> list[ElementChange]:
    """Return the elements of a process in which two files differ, without sequence flows and drawings."""
    old, new = dict(_elements(before, process)), dict(_elements(after, process))
    changes = []
    for element, (name, written) in new.items():
        if element not in old:
            changes.append(ElementChange(process, element, name, "added"))
        elif old[element][1] != written:
            changes.append(ElementChange(process, element, name, "changed"))
    gone = ((element, name) for element, (name, _) in old.items() if element not in new)
    return [*changes, *(ElementChange(process, element, name, "removed") for element, name in gone)]


def _elements(xml: bytes, process: str) -> Iterator[tuple[str, tuple[str | None, bytes]]]:
    for root in parse(xml).iterchildren(f"{{{BPMN}}}process"):
        if root.get("id") == process:
            yield from _within(root)


def _within(container: etree._Element) -> Iterator[tuple[str, tuple[str | None, bytes]]]:
    for element in container.iterchildren("{*}*"):
        element_id = element.get("id")
        if not is_bpmn(element) or element_id is None or local(element) in {"sequenceFlow", "laneSet"}:
            continue
        name = " ".join((element.get("name") or "").split()) or None
        if local(element) in _CONTAINERS:
            yield element_id, (name, repr(sorted(element.attrib.items())).encode())
            yield from _within(element)
        else:
            yield element_id, (name, _written(element))


def _written(element: etree._Element) -> bytes:
    """Return an element without layout; the order of its attributes does not count."""
    parts = [repr((element.tag, sorted(element.attrib.items()), (element.text or "").strip())).encode()]
    parts += [_written(part) for part in element.iterchildren("{*}*") if local(part) not in _IGNORED]
    return b"(" + b" ".join(parts) + b")"
