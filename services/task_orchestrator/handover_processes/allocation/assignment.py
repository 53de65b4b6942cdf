"""Assignment: who gets an activity, by the file, an accepted TaskDefinition or the mapping.

The file decides if it names a resource, role or skills. Otherwise an entry of the mapping decides. Without
one the activity goes to people: its Task involves nobody, and its `candidates` say who may claim it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

from handover.messages import Message, message
from handover.tasks.task_life import performers_of
from handover_bpmn.languages.base import ExpressionError, Variables
from handover_bpmn.model import Activity, Value
from handover_bpmn.references import is_reference
from handover_processes.allocation.agents import Agents, Position
from handover_processes.allocation.choice import DEFAULT_PRIORITY, Request
from handover_processes.allocation.hints import (
    CODE_HINTS,
    HINT_KINDS,
    candidates_of,
    due_of,
    hint_values,
    priority_of,
)
from handover_processes.allocation.mapping import MappingEntry, MappingTable, NameKind
from handover_processes.allocation.task_kinds import TaskKind
from handover_processes.references import resource_id
from handover_processes.settings import OrchestratorSettings


@dataclass(frozen=True, slots=True)
class PerformerAssignment:
    """Who gets an activity: `activity` is changed as the mapping says."""

    activity: Activity
    reason: Message
    performer: str | None = None
    """The resource, role or skills, as text; None if people of the tasklist claim it."""
    candidates: Mapping[str, Any] | None = None
    """The groups and persons that a Task of people is offered to."""
    warning: Message | None = None
    request: Request | None = None
    """What a performer needs, if one has to be chosen."""
    kind: TaskKind | None = None
    """The accepted TaskDefinition of another system that the activity names."""
    performers: tuple[str, ...] = ()
    """The URNs of the named ones, once the activity runs."""
    priority: int = DEFAULT_PRIORITY
    due: datetime | None = None

    @property
    def waiting_request(self) -> Request | None:
        """Return what the activity waits for if it has to wait."""
        return self.request or (named_request(self, self.performers[0]) if self.performers else None)

    @property
    def has_no_performer(self) -> bool:
        """Return whether the file says nothing of the performer but the lane."""
        return self.candidates is not None and not set(self.candidates) - {"lane"}


class AssignmentRules:
    """The rules of one orchestrator; `mapping` is the present version of the table."""

    def __init__(self, settings: OrchestratorSettings) -> None:
        self._settings = settings
        self.mapping = MappingTable()
        self.task_kinds: Mapping[str, TaskKind] = {}
        """The accepted TaskDefinitions of other systems, by id."""
        self.agents = Agents()

    def request(
        self, activity: Activity, variables: Variables, declined: frozenset[str] = frozenset()
    ) -> PerformerAssignment:
        """Return who gets an activity, with everything that the choice of an agent depends on.

        Raises `ExpressionError` if a variable is missing that says who performs it.
        """
        assignment = self.assign(activity, variables, declined)
        priority, due = priority_of(activity, variables), due_of(activity, variables)
        performers = tuple(self.named(assignment.activity, variables))
        request = assignment.request
        if request is not None:
            place = self._place(activity, variables)
            request = replace(request, declined=declined, place=place, priority=priority, due=due)
        return replace(
            assignment,
            request=request,
            performers=performers,
            priority=priority,
            due=due,
        )

    def named(self, activity: Activity, variables: Variables) -> list[str]:
        """Return the URNs of those that an activity names as performers."""
        references = [resource.value(variables) for resource in activity.involves]
        return performers_of(
            resource_id(self._settings, str(reference)) for reference in references if is_reference(reference)
        )

    def assign(
        self, activity: Activity, variables: Variables | None, declined: frozenset[str] = frozenset()
    ) -> PerformerAssignment:
        """Return who gets an activity with the present `variables`; None: before it runs.

        An assignee who has `declined` it gets it no more if users or groups are named beside the assignee.
        """
        assignment = self._assign(activity, variables, declined)
        kind = self._kind(assignment.activity)
        return (
            assignment
            if kind is None
            else replace(assignment, activity=kind.completed(assignment.activity), kind=kind)
        )

    def _kind(self, activity: Activity) -> TaskKind | None:
        if not self.task_kinds:
            return None
        return self.task_kinds.get(self._settings.entity_id("TaskDefinition", activity.definition))

    def _assign(
        self, activity: Activity, variables: Variables | None, declined: frozenset[str]
    ) -> PerformerAssignment:
        if activity.involves:
            named = ", ".join(_described(value) for value in activity.involves)
            reason = message("allocation.by_file", "named in the process file: {resource}", resource=named)
            return PerformerAssignment(activity, reason, named)
        if activity.role is not None or activity.skills:
            request = Request(activity.role, activity.skills)
            reason = message("allocation.needs", "the file asks for {needed}", needed=request.described)
            return PerformerAssignment(
                activity,
                reason,
                request.described,
                candidates=None if activity.role is None else {"groups": [activity.role]},
                request=request,
                warning=self.nobody_has(request),
            )
        return self._by_mapping(activity, variables, declined)

    def _by_mapping(
        self, activity: Activity, variables: Variables | None, declined: frozenset[str]
    ) -> PerformerAssignment:
        entry = self.mapping.find(names_of(activity, variables))
        others = self._others(entry, activity, variables)
        if others and entry is not None and self._have_all_declined(entry, declined):
            names = names_of(activity, variables)
            entry = self.mapping.find(name for name in names if name[0] is not NameKind.ASSIGNEE)
            if entry is None:
                reason = message(
                    "allocation.assignee_declined", "people, because the assignee has declined it"
                )
                return PerformerAssignment(activity, reason, candidates=others)
            others = None
        if entry is None and (kind := self._kind(activity)) is not None and kind.skills:
            request = Request(skills=kind.skills)
            reason = message(
                "allocation.by_definition",
                "{definition} requires {needed}",
                definition=kind.id,
                needed=request.described,
            )
            return PerformerAssignment(
                activity, reason, request.described, request=request, warning=self.nobody_has(request)
            )
        if entry is None:
            reason = message("allocation.no_entry", "people, because the mapping has no entry for it")
            return PerformerAssignment(activity, reason, candidates=candidates_of(activity, variables))
        if not self._is_allowed(entry):
            warning = message(
                "allocation.unconfirmed",
                'people, because nobody has confirmed the mapping of {kind} "{name}" to {performer}',
                kind=entry.kind.value,
                name=entry.name,
                performer=performer_of(entry),
            )
            return PerformerAssignment(
                activity, warning, candidates=candidates_of(activity, variables), warning=warning
            )
        return self._by_entry(activity, entry, others)

    def _others(
        self, entry: MappingEntry | None, activity: Activity, variables: Variables | None
    ) -> dict[str, Any] | None:
        """Return the users and groups that an activity names beside the assignee whom `entry` maps."""
        if entry is None or entry.kind is not NameKind.ASSIGNEE:
            return None
        hints = {name: text for name, text in activity.hints.items() if name != "assignee"}
        candidates = candidates_of(replace(activity, hints=hints), variables)
        return candidates if candidates.keys() & {"users", "groups"} else None

    def _have_all_declined(self, entry: MappingEntry, declined: frozenset[str]) -> bool:
        """Return whether everybody whom an entry means has declined: its resource, or all who fulfil it."""
        if not declined:
            return False
        if entry.resource is not None:
            return resource_id(self._settings, entry.resource) in declined
        request = self._request_of(entry)
        suitable = {agent.id for agent in self.agents.by_id.values() if request.suits(agent)}
        return bool(suitable) and suitable <= declined

    def _request_of(self, entry: MappingEntry) -> Request:
        return Request(entry.role, entry.skills or (), people_only=self.mapping.by is None)

    def _by_entry(
        self, activity: Activity, entry: MappingEntry, others: Mapping[str, Any] | None
    ) -> PerformerAssignment:
        changed = replace(
            activity,
            definition=entry.definition or activity.definition,
            parameters={
                **activity.parameters,
                **{name: Value(value) for name, value in entry.parameters.items()},
            },
            involves=() if entry.resource is None else (Value(entry.resource),),
        )
        request = None if entry.resource is not None else self._request_of(entry)
        candidates = others if request is None else None
        if entry.role is not None:
            candidates = {"groups": [entry.role]}
        return PerformerAssignment(
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
            candidates=candidates,
            request=request,
            warning=None if request is None else self.nobody_has(request),
        )

    def nobody_has(self, request: Request) -> Message | None:
        """Return that no agent fulfils a request; None if one does."""
        if any(request.suits(agent) for agent in self.agents.by_id.values()):
            return None
        return message("allocation.nobody", "nobody has {needed}", needed=request.described)

    def _is_allowed(self, entry: MappingEntry) -> bool:
        """Return whether work may be given to the performer: people always, others if confirmed."""
        if self.mapping.by is not None:
            return True
        return entry.resource is None or entry.resource.startswith(("Person:", "urn:ngsi-ld:Person:"))

    def _place(self, activity: Activity, variables: Variables) -> Position | None:
        """Return the position of the first place of an activity that has one."""
        for place in activity.happens_at:
            reference = place.location.value(variables)
            if is_reference(reference):
                position = self.agents.places.get(resource_id(self._settings, str(reference)))
                if position is not None:
                    return position
        return None


def named_request(assignment: PerformerAssignment, agent: str) -> Request:
    """Return the request of an activity that names its performer."""
    return Request(priority=assignment.priority, due=assignment.due, resource=agent)


def performer_of(entry: MappingEntry) -> str:
    """Return the performer of an entry as text: `Device:ur10-1`, `role:operator`, `skill:grip`."""
    if entry.resource is not None:
        return entry.resource
    if entry.role is not None:
        return f"role:{entry.role}"
    return " ".join(f"skill:{skill}" for skill in entry.skills or ())


def names_of(activity: Activity, variables: Variables | None) -> Iterator[tuple[NameKind, str]]:
    """Yield the names of an activity that an entry can map, the most specific first.

    An expression that cannot be evaluated is a name too. Raises its `ExpressionError` if a reader wants the
    name after it: an entry for a less specific name must not hide the error.
    """
    yield NameKind.DEFINITION, activity.definition
    for kind, hints in HINT_KINDS.items():
        for hint in hints:
            try:
                names = hint_values(activity, hint, variables)
            except ExpressionError:
                yield kind, activity.hints[hint].strip()
                raise
            for name in names:
                yield kind, name
                if hint in CODE_HINTS and name.startswith(("${", "#{")) and name.endswith("}"):
                    yield kind, name[2:-1].strip()
    if activity.lane:
        yield NameKind.LANE, activity.lane


def _described(value: Value) -> str:
    if value.expression is not None:
        return value.expression.text
    return str(value.literal) if is_reference(value.literal) else repr(value.literal)
