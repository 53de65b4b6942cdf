"""Allocation report: who would get the activities of definitions, and which names an entry can map."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from handover.messages import Message, message, with_code
from handover_bpmn.model import Activity, Definition, Kind
from handover_processes.allocation.assignment import AssignmentRules, PerformerAssignment, names_of
from handover_processes.allocation.choice import Request
from handover_processes.allocation.mapping import MappingEntry, NameKind
from handover_processes.deployed_forms import FormRegistry


@dataclass(frozen=True, slots=True)
class UsedName:
    """A name in definitions that an entry can map."""

    kind: NameKind
    name: str
    entry: MappingEntry | None
    activities: tuple[tuple[str, str, str], ...]
    """Definition, element and drawn name of the activities that have it."""


def allocation_report(
    rules: AssignmentRules, forms: FormRegistry, definition: Definition
) -> list[dict[str, Any]]:
    """Return for each activity of a definition who gets it and why, as JSON."""
    allocations = []
    machines = {node.id for node in definition.nodes() if node.kind is Kind.SERVICE_TASK}
    for element, activity in definition.activities().items():
        assignment = rules.assign(activity, None)
        view = {
            "process": definition.name,
            "element": element,
            "name": activity.name,
            "definition": assignment.activity.definition,
            "performer": assignment.performer,
            **with_code("reason", assignment.reason),
            "warning": None,
        }
        warning = assignment.warning or _form_warning(forms, activity)
        if warning is None and element in machines and not is_performed(assignment):
            warning = message(
                "allocation.no_performer",
                "no performer is named for this service task, so people get it; map its name to a performer "
                "on the page Statistics, or name a resource in the file",
            )
        if warning is not None:
            view |= with_code("warning", warning)
        allocations.append(view)
    return allocations


def is_performed(assignment: PerformerAssignment) -> bool:
    """Return whether a device or person is named, or can be chosen."""
    return bool(assignment.performer or assignment.request or assignment.candidates)


def mapped_names(rules: AssignmentRules, definitions: Iterable[Definition]) -> list[UsedName]:
    """Return the names in definitions that an entry can map, with the activities that have them.

    Activities whose performer the file names have none. The name of the TaskDefinition is listed only if
    it has an entry, or if the activity has no other name.
    """
    elements: dict[tuple[NameKind, str], list[tuple[str, str, str]]] = {}
    for definition in definitions:
        for element, activity in definition.activities().items():
            if activity.involves or activity.role is not None or activity.skills:
                continue
            names = list(dict.fromkeys(names_of(activity, None)))
            others = [name for name in names if name[0] is not NameKind.DEFINITION]
            for name in names:
                if name in others or not others or rules.mapping.find([name]) is not None:
                    place = definition.name, element, activity.name
                    elements.setdefault(name, []).append(place)
    return [UsedName(*name, rules.mapping.find([name]), tuple(places)) for name, places in elements.items()]


def nobody_has(rules: AssignmentRules, entry: MappingEntry) -> Message | None:
    """Return that no agent has the role or skills of an entry; None if one has them."""
    if entry.resource is not None:
        return None
    return rules.nobody_has(Request(entry.role, entry.skills or ()))


def _form_warning(forms: FormRegistry, activity: Activity) -> Message | None:
    reference = activity.form
    if reference is None:
        return None
    name, version = reference.name, reference.version
    if forms.find_file(name) if reference.is_file else forms.find(name, version):
        return None
    return message(
        "form.not_deployed",
        'the form "{form}" is not deployed; people complete the Task without it',
        form=name,
    )
