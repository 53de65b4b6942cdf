"""Allocator: decides who performs an activity when its Task is posted.

The file decides if it names a resource. Otherwise an entry of the mapping decides. Without one the activity
goes to people: its Task involves nobody, and its `candidates` say who may claim it.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from handover.messages import Message, message, with_code
from services.task_orchestrator.allocation.mapping import MappingEntry, MappingTable, NameKind
from services.task_orchestrator.languages.base import ExpressionError, Variables
from services.task_orchestrator.languages.feel import read_feel
from services.task_orchestrator.languages.juel import read_template
from services.task_orchestrator.model import Activity, Definition, Value
from services.task_orchestrator.references import is_reference

_HINT_KINDS: Mapping[NameKind, tuple[str, ...]] = {
    NameKind.CLASS: ("class", "delegateExpression", "expression", "connector"),
    NameKind.TOPIC: ("topic",),
    NameKind.JOB_TYPE: ("jobType",),
    NameKind.ASSIGNEE: ("assignee",),
    NameKind.CANDIDATE_GROUP: ("candidateGroups",),
}
_CODE_HINTS = frozenset(_HINT_KINDS[NameKind.CLASS])
"""Hints whose text is the name of code, even if it is written as an expression."""


@dataclass(frozen=True, slots=True)
class Assignment:
    """Who gets an activity: `activity` is changed as the mapping says."""

    activity: Activity
    reason: Message
    performer: str | None = None
    """The resource, role or skills, as text; None if people of the tasklist claim it."""
    candidates: Mapping[str, Any] | None = None
    """Who may claim its Task, if the Task involves nobody."""
    warning: Message | None = None


class Allocator:
    """The decisions of one orchestrator; `mapping` is the present version of the table."""

    def __init__(self) -> None:
        self.mapping = MappingTable()

    def assign(self, activity: Activity, variables: Variables | None) -> Assignment:
        """Return who gets an activity with the present `variables`; None: before it runs."""
        if activity.involves:
            named = ", ".join(_described(value) for value in activity.involves)
            reason = message("allocation.by_file", "the file names {resource}", resource=named)
            return Assignment(activity, reason, named)
        names = list(_names(activity, variables))
        entry = self.mapping.find(names)
        if entry is None:
            reason = message("allocation.no_entry", "people, because the mapping has no entry for it")
            return Assignment(activity, reason, candidates=_candidates(activity, variables, None))
        if not self._is_allowed(entry):
            warning = message(
                "allocation.unconfirmed",
                'people, because nobody has confirmed the mapping of {kind} "{name}" to {performer}',
                kind=entry.kind.value,
                name=entry.name,
                performer=performer_of(entry),
            )
            candidates = _candidates(activity, variables, None)
            return Assignment(activity, warning, candidates=candidates, warning=warning)
        changed = replace(
            activity,
            definition=entry.definition or activity.definition,
            parameters={
                **activity.parameters,
                **{name: Value(value) for name, value in entry.parameters.items()},
            },
            involves=() if entry.resource is None else (Value(entry.resource),),
        )
        return Assignment(
            changed,
            message(
                "allocation.by_entry",
                '{performer}, by the mapping of {kind} "{name}" (version {version})',
                performer=performer_of(entry),
                kind=entry.kind.value,
                name=entry.name,
                version=self.mapping.version,
            ),
            performer_of(entry),
            candidates=_candidates(activity, variables, entry) if entry.resource is None else None,
        )

    def report(self, definition: Definition) -> list[dict[str, Any]]:
        """Return for each activity of a definition who gets it and why, as JSON."""
        found = []
        for element, activity in definition.activities().items():
            assignment = self.assign(activity, None)
            view = {
                "process": definition.name,
                "element": element,
                "name": activity.name,
                "definition": assignment.activity.definition,
                "performer": assignment.performer,
                **with_code("reason", assignment.reason),
                "warning": None,
            }
            if assignment.warning is not None:
                view |= with_code("warning", assignment.warning)
            found.append(view)
        return found

    def _is_allowed(self, entry: MappingEntry) -> bool:
        """Return whether work may be given to the performer: people always, others if confirmed."""
        if self.mapping.by is not None:
            return True
        return entry.resource is None or entry.resource.startswith(("Person:", "urn:ngsi-ld:Person:"))


def performer_of(entry: MappingEntry) -> str:
    """Return the performer of an entry as text: `Device:ur10-1`, `role:operator`, `skill:grip`."""
    if entry.resource is not None:
        return entry.resource
    if entry.role is not None:
        return f"role:{entry.role}"
    return " ".join(f"skill:{skill}" for skill in entry.skills or ())


def _names(activity: Activity, variables: Variables | None) -> Iterator[tuple[NameKind, str]]:
    """Yield the names of an activity that an entry can map, the most specific first."""
    yield NameKind.DEFINITION, activity.definition
    for kind, hints in _HINT_KINDS.items():
        for hint in hints:
            for name in _hint(activity, hint, variables):
                yield kind, name
                if hint in _CODE_HINTS and name.startswith(("${", "#{")) and name.endswith("}"):
                    yield kind, name[2:-1].strip()
    if activity.lane:
        yield NameKind.LANE, activity.lane


def _candidates(
    activity: Activity, variables: Variables | None, entry: MappingEntry | None
) -> dict[str, Any]:
    found: dict[str, Any] = {
        "groups": _hint(activity, "candidateGroups", variables),
        "users": _hint(activity, "candidateUsers", variables),
        "assignee": next(iter(_hint(activity, "assignee", variables)), None),
        "lane": activity.lane,
        "role": entry.role if entry is not None else None,
        "skills": list(entry.skills or ()) if entry is not None else [],
    }
    return {name: value for name, value in found.items() if value}


def _hint(activity: Activity, name: str, variables: Variables | None) -> list[str]:
    """Return the names in a hint; an expression that cannot be evaluated stands for itself."""
    text = activity.hints.get(name, "").strip()
    if not text:
        return []
    value: Any = text
    if variables is not None and name not in _CODE_HINTS:
        with suppress(ExpressionError):
            if text.startswith("="):
                value = read_feel(text).value(variables)
            elif "${" in text or "#{" in text:
                value = read_template(text).value(variables)
    if isinstance(value, list):
        return [str(each).strip() for each in value if each is not None]
    if value is text and (text.startswith("=") or "${" in text or "#{" in text):
        return [text]
    is_list = name in {"candidateGroups", "candidateUsers"}
    names = str(value).split(",") if is_list else [str(value)]
    return [each.strip() for each in names if each.strip() and value is not None]


def _described(value: Value) -> str:
    if value.expression is not None:
        return value.expression.text
    return str(value.literal) if is_reference(value.literal) else repr(value.literal)
