"""Faults and warnings of a BPMN file, each with element, drawn name, line and way out."""

from collections.abc import Iterable
from typing import Any

from lxml import etree

from handover.errors import Problem
from handover.messages import with_code
from handover_bpmn.model import Fault

MAX_FAULTS_LISTED = 100

_CONTAINERS = frozenset(
    {"definitions", "process", "subProcess", "transaction", "adHocSubProcess", "collaboration", "laneSet"}
)


class BadBpmn(Problem):
    """A BPMN file cannot be deployed; `faults` are all its faults, `warnings` what has no effect."""

    def __init__(self, faults: list[Fault], warnings: Iterable[Fault] = ()) -> None:
        self.faults = faults
        self.warnings = tuple(warnings)
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        listed = {"faults": as_json(faults), "warnings": as_json(self.warnings)}
        super().__init__(
            422, "BPMN cannot be deployed", f"{faults[0]}{more}", "urn:handover:bad-bpmn", listed
        )


def as_json(faults: Iterable[Fault]) -> list[dict[str, Any]]:
    """Return the first `MAX_FAULTS_LISTED` faults or warnings as JSON."""
    return [
        {"element": f.element, "name": f.name, "line": f.line, **with_code("message", f.message)}
        for f in list(faults)[:MAX_FAULTS_LISTED]
    ]


class Findings:
    """The faults and warnings of a file; `broken` are the ids of elements with faults.

    A fault of one line, and a warning of one element, is listed once. `is_deployed` files were accepted by
    this release or an earlier one.
    """

    def __init__(self, *, is_deployed: bool = False) -> None:
        self.is_deployed = is_deployed
        self._faults: dict[Fault, None] = {}
        self._warnings: dict[tuple[str | None, str], Fault] = {}
        self.broken: set[str] = set()

    def fault(self, element: etree._Element, text: str) -> None:
        """Add a fault of `element`; it is reported at the flow element that contains it."""
        new_fault = _fault_of(element, text)
        self._faults.setdefault(new_fault)
        if new_fault.element is not None:
            self.broken.add(new_fault.element)

    def fault_of_deployment(self, element: etree._Element, text: str) -> None:
        """Add a fault by a rule that earlier releases did not have: a deployed file has a warning instead."""
        (self.warn if self.is_deployed else self.fault)(element, text)

    def warn(self, element: etree._Element, text: str) -> None:
        """Add a warning about `element`."""
        self.add((), [_fault_of(element, text)])

    def add(self, faults: Iterable[Fault], warnings: Iterable[Fault] = ()) -> None:
        """Add faults and warnings of rules."""
        self._faults.update(dict.fromkeys(faults))
        for warning in warnings:
            self._warnings.setdefault((warning.element, warning.message), warning)

    @property
    def faults(self) -> list[Fault]:
        """Return the faults in the order of the lines."""
        return sorted(self._faults, key=_line)

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """Return the warnings in the order of the lines."""
        return tuple(sorted(self._warnings.values(), key=_line))


def _line(fault: Fault) -> int:
    return fault.line or 0


def _fault_of(element: etree._Element, text: str) -> Fault:
    owner = _drawn(element)
    name = " ".join((owner.get("name") or "").split())
    return Fault(owner.get("id"), element.sourceline, text, name or None)


def _drawn(element: etree._Element) -> etree._Element:
    """Return the element of the drawing that `element` is part of: a child of a container, or one itself."""
    owner = element
    while True:
        parent = owner.getparent()
        if parent is None or etree.QName(owner).localname == "process":
            return owner
        is_named = owner.get("id") is not None or owner.get("name") is not None
        if etree.QName(parent).localname in _CONTAINERS and is_named:
            return owner
        owner = parent
