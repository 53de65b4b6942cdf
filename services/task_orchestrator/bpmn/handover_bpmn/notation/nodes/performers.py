"""Performers: the resource roles of BPMN 2.0 (clause 10.3.1), as hints for the allocation.

`humanPerformer` and `performer` name the one who does the work, `potentialOwner` those who may claim it: by a
declared resource, or by an expression, in which `user(…)` and `group(…)` distinguish persons from groups.
"""

import re
from collections.abc import Mapping

from lxml import etree

from handover_bpmn.notation.context import Context
from handover_bpmn.notation.document import child, child_text, children, local, text
from handover_bpmn.notation.elements import referenced, warn_without_effect

RESOURCE_ROLES = frozenset({"resourceRole", "performer", "humanPerformer", "potentialOwner"})

_PERFORMERS = frozenset({"performer", "humanPerformer"})
_QUALIFIED = re.compile(r"(user|group)\s*\(([^()]*)\)\s*", re.IGNORECASE)


def performer_hints(element: etree._Element, context: Context) -> Mapping[str, str]:
    """Return assignee, candidate users and groups that the resource roles of an activity name."""
    names: dict[str, list[str]] = {}
    for role in children(element, *sorted(RESOURCE_ROLES)):
        resource = _resource(role, context)
        if not resource:
            warn_without_effect(role, context.findings)
            continue
        plain = "assignee" if local(role) in _PERFORMERS else context.dialects.main.potential_owner
        for hint, name in _split(resource, plain):
            names.setdefault(hint, []).append(name)
    return {hint: ",".join(hinted) for hint, hinted in names.items()}


def _resource(role: etree._Element, context: Context) -> str:
    """Return the expression of a resource role, or the name of the resource that it refers to."""
    assignment = child(role, "resourceAssignmentExpression")
    if assignment is not None:
        for name in ("formalExpression", "expression"):
            expression = child_text(assignment, name)
            if expression:
                return expression
        return text(assignment)
    reference = referenced(child_text(role, "resourceRef"))
    return context.declared.resources.get(reference) or reference


def _split(resource: str, plain: str) -> list[tuple[str, str]]:
    """Return hint and name of each part of `user(kermit), group(accounting), management`."""
    if "${" in resource or "#{" in resource or resource.startswith("="):
        return [(plain, resource)]
    hints = []
    for part in (name.strip() for name in re.split(r",(?![^()]*\))", resource)):
        qualified = _QUALIFIED.fullmatch(part)
        if qualified is not None:
            hint = "candidateUsers" if qualified[1].lower() == "user" else "candidateGroups"
            hints += [(hint, name.strip()) for name in qualified[2].split(",") if name.strip()]
        elif part:
            hints.append((plain, part))
    return hints
